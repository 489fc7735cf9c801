"""The command line `frasa-sysid`: logs in, a calibrated model out."""

import argparse
import sys

import frasa_sysid
from frasa_sysid.calibration import run_command
from frasa_sysid.commands import compare, excite, export_bam, fit, importing, inspect, lag, publish, servos, simulate


def build_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = argparse.ArgumentParser(
        prog="frasa-sysid",
        description="Fit servo logs and write the numbers into a MuJoCo model.",
        epilog="exit status: 0 done, 1 failed, 2 usage, 3 bad log or model, 4 quality gate failed, 130 interrupted",
    )
    parser.add_argument("--version", action="version", version=f"frasa {frasa_sysid.__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (importing, servos, inspect, lag, excite, simulate, fit, publish, compare, export_bam):
        command.add_parser(subparsers)
    return parser


def main() -> int:
    """Entry point."""
    return run_command(build_parser())


if __name__ == "__main__":
    sys.exit(main())

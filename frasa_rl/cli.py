"""The command line of training: `frasa-rl init | train | sweep | evaluate | play | rank | keyframe | export`."""

import argparse
import sys
from collections.abc import Sequence

from frasa_rl import __version__
from frasa_sysid.calibration import run_command, say


def build_parser() -> argparse.ArgumentParser:
    """The whole command line.

    Raises:
        ModuleNotFoundError: a package that training needs is not installed.
    """
    from frasa_rl.commands import evaluate, export, init, keyframe, play, rank, sweep, train

    parser = argparse.ArgumentParser(prog="frasa-rl", description=__doc__)
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="command")
    for one in (init, train, sweep, evaluate, play, rank, keyframe, export):
        one.add_command(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 failed, 2 usage, 3 bad model, 130 interrupted."""
    try:
        parser = build_parser()
    except ModuleNotFoundError as error:
        say(f"frasa-rl: {error.name} is not installed: pip install 'frasa[train]'")
        return 1
    except KeyboardInterrupt:
        say("frasa-rl: interrupted")
        return 130
    return run_command(parser, arguments)


if __name__ == "__main__":
    sys.exit(main())

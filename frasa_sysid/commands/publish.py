"""`frasa-sysid publish`: fit files into the MuJoCo model and the randomization ranges."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco

from frasa_sysid import fit_file
from frasa_sysid.calibration import add_json_flag, say
from frasa_sysid.commands.bench import NOMINAL_MODEL
from frasa_sysid.fit_file import StoredFit
from frasa_sysid.publish import publish, write

SCHEMA = "frasa.publish/1"


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `publish` to the command line."""
    parser = subparsers.add_parser(
        "publish",
        help="fit files into the model and the randomization ranges",
        description="Write calibrated.xml and randomization.yaml from a nominal model and fit files; the same input "
        "gives the same bytes.",
    )
    parser.add_argument("fits", nargs="+", type=Path, metavar="FIT", help="fit files")
    parser.add_argument("--model", type=Path, default=NOMINAL_MODEL, help="nominal model [%(default)s]")
    parser.add_argument("--out", type=Path, help="calibrated model [calibrated.xml beside --model]")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Publish fits.

    Raises:
        InputError: a bad fit file or model, or two fits that claim one parameter.
    """
    stored = [fit_file.load(path) for path in args.fits]
    out = args.out or args.model.with_name("calibrated.xml")
    ranges = publish_files(stored, args.model, out)
    return {"schema": SCHEMA, "fits": args.fits, "outputs": {"model": out, "ranges": ranges}}


def publish_files(
    fits: Sequence[StoredFit], nominal: Path, out: Path, check: Callable[[mujoco.MjModel], None] | None = None
) -> Path:
    """Publish and write, when the compiled model passes `check`; returns the ranges file."""
    published = publish(fits, nominal, out)
    ranges = write(published, fits, nominal, out, check)
    servos = ", ".join(sorted(one.servo for one in fits))
    say(f"calibration {published.calibration.id} of {servos}: {out}, {ranges}")
    return ranges

"""`frasa-sysid publish`: fit files into the MuJoCo model and the randomization ranges."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco

from frasa_sysid import stored_fit
from frasa_sysid.calibration import add_json_flag, say
from frasa_sysid.commands.bench import NOMINAL_MODEL
from frasa_sysid.publish import publish, write
from frasa_sysid.published_as import as_m1, price
from frasa_sysid.stored_fit import StoredFit

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
    add_as_flag(parser)
    add_json_flag(parser)
    parser.set_defaults(run=run)


def add_as_flag(parser: argparse.ArgumentParser) -> None:
    """Give a command that publishes `--as`."""
    parser.add_argument(
        "--as",
        dest="as_law",
        choices=("m1",),
        help="publish the Coulomb-viscous stand-in of every fit, for programs that do not know the friction law",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Publish fits.

    Raises:
        InputError: a bad fit file or model, or two fits that claim one parameter.
    """
    stored = [stored_fit.load(path) for path in args.fits]
    out = args.out or args.model.with_name("calibrated.xml")
    ranges = publish_files(stored, args.model, out, as_law=args.as_law)
    return {"schema": SCHEMA, "fits": args.fits, "outputs": {"model": out, "ranges": ranges}}


def publish_files(
    fits: Sequence[StoredFit],
    nominal: Path,
    out: Path,
    check: Callable[[mujoco.MjModel], None] | None = None,
    as_law: str | None = None,
) -> Path:
    """Publish and write, when the compiled model passes `check`.

    Args:
        fits: one or more.
        nominal: the model they started from.
        out: the model file; the ranges go beside it.
        check: a last look at the compiled model, which raises when it is not good.
        as_law: `m1` publishes the Coulomb-viscous stand-ins.

    Returns:
        The ranges file.

    Raises:
        InputError: two fits that claim one parameter, a model that does not suit them, or no stand-in.
        QualityError: the compiled model is not what was fitted.
    """
    if as_law == "m1":
        fits = [as_m1(one) for one in fits]
    published = publish(fits, nominal, out)
    ranges = write(published, fits, nominal, out, check)
    servos = ", ".join(sorted(one.servo for one in fits))
    say(f"calibration {published.calibration.id} of {servos}: {out}, {ranges}")
    for one in fits:
        if one.stands_for:
            say(f"  {one.servo} {price(one)}")
        for effect in one.not_in_model:
            say(f"  {one.servo}, not in this model: {effect}")
    return ranges

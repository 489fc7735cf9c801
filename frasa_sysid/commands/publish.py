"""`frasa-sysid publish`: fit files into the MuJoCo model and the randomization ranges."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.bench import NOMINAL_MODEL
from frasa_sysid.calibration import add_json_flag, alone, input_hashes, say
from frasa_sysid.errors import InputError
from frasa_sysid.fit_json import ROBOT, read_json
from frasa_sysid.publish import PATIENCE_S, publish, write
from frasa_sysid.published_as import as_m1, price
from frasa_sysid.published_evidence import evidence_words
from frasa_sysid.stored_fit import StoredFit
from frasa_sysid.stored_robot_fit import StoredRobotFit

SCHEMA = "frasa.publish/1"


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `publish` to the command line."""
    parser = subparsers.add_parser(
        "publish",
        help="fit files into the model and the randomization ranges",
        description="Write calibrated.xml and randomization.yaml from a nominal model and fit files; the same input "
        "gives the same bytes. Of fits of the whole robot there can be one, with the bench fits that it stood on.",
    )
    parser.add_argument("fits", nargs="+", type=Path, metavar="FIT", help="fit files of servos and of the robot")
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
        UsageError: another model in that folder would lose its ranges.
    """
    out: Path = args.out or args.model.with_name("calibrated.xml")
    with alone(out, patience_s=PATIENCE_S):
        stored, robot = load_fits(args.fits)
        ranges = publish_files(stored, args.model, out, as_law=args.as_law, robot=robot)
    return {"schema": SCHEMA, "fits": args.fits, "inputs": input_hashes((args.model, *args.fits)),
            "outputs": {"model": out, "ranges": ranges}}  # fmt: skip


def load_fits(paths: Sequence[Path]) -> tuple[list[StoredFit], StoredRobotFit | None]:
    """Fits of servos, and that of the robot where there is one.

    Raises:
        InputError: a bad fit file, or two fits of robots.
    """
    kinds = [read_json(path)[0].get("kind") for path in paths]
    robots = [path for path, kind in zip(paths, kinds, strict=True) if kind == ROBOT]
    if len(robots) > 1:
        raise InputError(f"two fits of a robot, {robots[0]} and {robots[1]}: publish one of them")
    servos = [stored_fit.load(path) for path in paths if path not in robots]
    return servos, stored_robot_fit.load(robots[0]) if robots else None


def publish_files(
    fits: Sequence[StoredFit],
    nominal: Path,
    out: Path,
    check: Callable[[mujoco.MjModel, Path], None] | None = None,
    as_law: str | None = None,
    robot: StoredRobotFit | None = None,
) -> Path:
    """Publish and write, when the compiled model passes `check`.

    Args:
        fits: of servos.
        nominal: the model they started from.
        out: the model file; the ranges go beside it.
        check: a last look at the compiled model and its file, which raises when it is not good.
        as_law: `m1` publishes the Coulomb-viscous stand-ins.
        robot: a fit of the whole robot.

    Returns:
        The ranges file.

    Raises:
        InputError: two fits that claim one parameter, a model that does not suit them, or no stand-in.
        QualityError: the compiled model is not what was fitted, or the logs told nothing of a servo.
    """
    if as_law == "m1":
        fits = [as_m1(one) for one in fits]
    published = publish(fits, nominal, out, robot)
    ranges = write(published, nominal, out, check)
    whose = ", ".join([*sorted(one.servo for one in fits), *(["the robot"] if robot else [])])
    say(f"calibration {published.calibration.id} of {whose}: {out}, {ranges}")
    for name, bench in published.claims.instead.items():
        say(f"  {name}: the robot's fit in place of {bench.value:.6g} {bench.unit} of bench fit {bench.sha256[:12]}")
    for one in fits:
        if one.stands_for:
            say(f"  {one.servo} {price(one)}")
        for effect in one.not_in_model:
            say(f"  {one.servo}, not in this model: {effect}")
    for words in evidence_words(fits, robot):
        say(f"  {words}")
    for effect in robot.not_in_model if robot else ():
        say(f"  robot, not in this model: {effect}")
    return ranges

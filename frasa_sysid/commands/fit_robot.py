"""`frasa-sysid fit` on logs of the whole robot: delays, zeros, scales, with bench fits frozen."""

import argparse
import hashlib
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.calibration import (
    alone,
    load_model,
    read_limited,
    say,
    servo_classes,
    write_atomic,
)
from frasa_sysid.commands.bench import people_console
from frasa_sysid.commands.fit_robot_record import record_of
from frasa_sysid.commands.fit_robot_show import show_robot
from frasa_sysid.commands.log_kinds import KindGroup
from frasa_sysid.commands.publish import publish_files
from frasa_sysid.commands.reading import share_of_memory
from frasa_sysid.errors import InputError, InterruptedRunError, LogError, UsageError
from frasa_sysid.excerpt import liveliest
from frasa_sysid.excerpt import words as said_of
from frasa_sysid.fit import versions
from frasa_sysid.fit_json import read_json
from frasa_sysid.joint_checks import checks
from frasa_sysid.model_mark import mark_of
from frasa_sysid.publish import PATIENCE_S
from frasa_sysid.published_as import as_m1
from frasa_sysid.published_place import check_ranges_free
from frasa_sysid.recording import Recording
from frasa_sysid.report_robot import RobotPage, write_robot_report
from frasa_sysid.robot_check import check_published_robot
from frasa_sysid.robot_compare import compare_runs, held_from, last_share, of_found
from frasa_sysid.robot_fit import RobotFit, fit_robot, frozen_model
from frasa_sysid.robot_fit_record import RobotFitRecord
from frasa_sysid.robot_problem import DEFAULT_GROUPS, GROUPS, default_groups
from frasa_sysid.robot_residuals import residual_count
from frasa_sysid.robot_rig import is_robot
from frasa_sysid.robot_trail import Place, Trail, place_from
from frasa_sysid.stored_fit import StoredFit

RESIDUALS = 2**19  # compared with the usual memory: the derivatives by 28 numbers take 60 times as many
CHOOSE = "--between FROM TO chooses another, --memory GB makes room for more"


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """What only logs of the whole robot need."""
    robot = KindGroup(parser, "robot")
    add_base_argument(robot)
    robot.add(
        "--free",
        metavar="LIST",
        help=f"of {', '.join(GROUPS)} [{','.join(DEFAULT_GROUPS)}; trunk on the ground]",
        instead="takes --effects LIST and --friction LAW",
    )
    robot.add(
        "--position-delay",
        type=float,
        default=0.0,
        metavar="S",
        help="age of a joint position [0]",
        instead="takes --duty-age S",
    )
    robot.add(
        "--frozen",
        type=Path,
        action="append",
        metavar="FIT",
        help="bench fit that applies [those beside --model]",
        instead="stands on no other fit",
    )
    add_share_argument(robot, "end of each log to compare only", "takes --hold-out RULE")


def add_base_argument(robot: KindGroup) -> None:
    """How the robot was held, where the log does not say."""
    robot.add(
        "--base",
        choices=("fixed", "floating"),
        help="trunk held, or robot on the ground [as logged]",
        instead="has no trunk",
    )


def add_share_argument(robot: KindGroup, meaning: str, instead: str) -> None:
    """How much of the end of each log is held out, and what a bench does in its place."""
    robot.add("--hold-out-share", type=float, default=0.0, metavar="S", help=meaning, instead=instead)


def fit_robot_logs(args: argparse.Namespace, recordings: Sequence[Recording]) -> dict[str, Any]:
    """Fit, save, show, and publish when asked.

    Raises:
        LogError, UsageError, ModelError: bad input.
        InterruptedRunError: Ctrl-C; the same command goes on from the last step.
    """
    recordings = _within_memory(args, recordings)
    _check(args, recordings)
    out: Path = args.out or args.model.parent / "fits" / "robot.json"
    with alone(out):
        return _fit_alone(args, recordings, out)


def _fit_alone(args: argparse.Namespace, recordings: Sequence[Recording], out: Path) -> dict[str, Any]:
    """The fit, with nobody else writing the same file."""
    fits = _frozen(args)
    bases = [args.base or one.rig.base for one in recordings]
    groups = default_groups(bases) if args.free is None else tuple(args.free.split(","))
    identity = _identity(args, recordings, fits, groups)
    partial = out.with_suffix(".partial.json")
    found = _fit(args, recordings, fits, groups, partial, identity)
    record = record_of(args, recordings, fits, found)
    data = {**record.to_json(), "seconds": found.seconds}
    record.save(out)
    partial.unlink(missing_ok=True)
    show_robot(found, record)
    outputs: dict[str, Any] = {"fit": out, "model": None, "ranges": None, "report": None}
    if not args.no_report:
        outputs["report"] = _report(args, fits, found, record, out.with_suffix(".html"), said_of(recordings))
    if args.publish:
        outputs["model"] = args.model.with_name("calibrated.xml")
        outputs["ranges"] = _publish(args, fits, found, out, outputs["model"])
    for name, path in outputs.items():
        if path is not None:
            say(f"{name}: {path}")
    return {**data, "outputs": outputs}


def _within_memory(args: argparse.Namespace, recordings: Sequence[Recording]) -> list[Recording]:
    """The logs, or of longer ones the parts in which the robot moves most; which, is said."""
    single = [one.name for one in recordings if not is_robot(one)]
    if single:
        raise LogError(f"{single[0]} is of one joint and the others are of a whole robot; fit them apart")
    kept = liveliest(recordings, lambda one: residual_count(one, args.base), round(RESIDUALS * share_of_memory(args)))
    if told := said_of(kept):
        say(f"fitted is a part, that in which the joints move most: {told}; {CHOOSE}")
    return kept


def _check(args: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    found = [one for recording in recordings for one in checks(recording)]
    for one in found:
        say(f"{one.recording}: {one.message}")
    refused = [one for one in found if one.level == "refuse"]
    if refused:
        # Its message names the recording itself where it needs to.
        raise LogError(f"{refused[0].recording} would mislead a fit: {refused[0].message}")
    if not 0.0 <= args.hold_out_share <= 0.9:
        raise UsageError(f"--hold-out-share {args.hold_out_share:g}: expected 0 to 0.9")
    if not 0.0 <= args.position_delay <= 0.1:
        raise UsageError(f"--position-delay {args.position_delay:g}: expected seconds, 0 to 0.1")
    if args.out is not None and args.out.suffix != ".json":
        raise UsageError(f"--out {args.out}: expected a name that ends in .json")
    if args.publish:
        check_ranges_free(args.model.with_name("calibrated.xml"))  # now, not after minutes


def _frozen(args: argparse.Namespace) -> list[StoredFit]:
    """Bench fits of servos that the model has: those given, else those beside it."""
    known = servo_classes(load_model(args.model))
    if args.frozen is not None:
        return [stored_fit.load(path) for path in args.frozen]
    folder = args.model.parent / "fits"
    paths = [path for path in sorted(folder.glob("*.json")) if not path.name.endswith(".partial.json")]
    servos = [path for path in paths if read_json(path)[0].get("kind") is None]
    return [one for one in map(stored_fit.load, servos) if one.servo in known]


def _fit(
    args: argparse.Namespace,
    recordings: Sequence[Recording],
    fits: Sequence[StoredFit],
    groups: Sequence[str],
    partial: Path,
    identity: str,
) -> RobotFit:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())

    def save(place: dict[str, Any]) -> None:
        write_atomic(partial, json.dumps({"identity": identity, "place": place}, allow_nan=False) + "\n")

    with Progress(*columns, console=people_console()) as progress:
        task = progress.add_task("robot", total=None, best="")

        def tell(stage: str, count: int, best: float) -> None:
            text = f"{count} robots simulated" + (f", cost {best:.0f}" if np.isfinite(best) else "")
            progress.update(task, description=f"robot: {len(recordings)} logs, {stage}", best=text)

        try:
            return fit_robot(
                args.model,
                fits,
                recordings,
                args.base,
                groups,
                args.position_delay,
                args.hold_out_share,
                args.threads,
                args.seed,
                tell,
                Trail(_resumed(partial, identity), save),
            )
        except KeyboardInterrupt:
            begun = _resumed(partial, identity) is not None
            kept = f"its last step is in {partial}, the same command goes on" if begun else "nothing was done yet"
            raise InterruptedRunError(f"interrupted; {kept}") from None


def _identity(
    args: argparse.Namespace, recordings: Sequence[Recording], fits: Sequence[StoredFit], groups: Sequence[str]
) -> str:
    facts = [
        sorted(f"{one.sha256}{one.name}{one.duration:.6f}" for one in recordings),
        [one.sha256 for one in fits],
        [*groups, str(args.base), args.position_delay, args.hold_out_share],
        mark_of(load_model(args.model)).fingerprint,
        versions(),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def _resumed(partial: Path, identity: str) -> Place | None:
    """The place an interrupted fit of the very same had reached."""
    if not partial.exists():
        return None
    try:
        data = json.loads(read_limited(partial, 2**26, InputError))
        return place_from(data["place"]) if data["identity"] == identity else None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, InputError):
        # It is only a shortcut: a broken one costs time, never the result.
        return None


def _report(
    args: argparse.Namespace,
    fits: Sequence[StoredFit],
    found: RobotFit,
    record: RobotFitRecord,
    path: Path,
    parts: str,
) -> Path | None:
    runs, share = found.problem.runs, args.hold_out_share
    with tempfile.TemporaryDirectory() as folder:
        frozen = frozen_model(args.model, fits, Path(folder))
        compared = {one.name: compare_runs(one, runs, last_share(0.0), args.threads) for one in of_found(found, frozen)}
    held = held_from(runs, found.timestep, share) if share else {}
    return write_robot_report(path, RobotPage(found, record, compared, [one.servo for one in fits], held, parts))


def _publish(args: argparse.Namespace, fits: Sequence[StoredFit], found: RobotFit, out: Path, model_path: Path) -> Path:
    robot = stored_robot_fit.load(out)
    benches = [as_m1(one) for one in fits] if args.as_law == "m1" else fits

    def check(model: mujoco.MjModel, path: Path) -> None:
        mean, count = check_published_robot(path, found, robot, benches, args.model, args.threads)
        say(f"{model_path} replays {count} pieces of the logs within {mean * 1e3:.2g} mrad (mean) of the fit")

    with alone(model_path, patience_s=PATIENCE_S):
        return publish_files(fits, args.model, model_path, check, args.as_law, robot)

"""`frasa-sysid simulate --robot`: a log of a whole robot with known truth."""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import say, sha256_of_file
from frasa_sysid.commands.progress import shown_share
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_file import read_excitation
from frasa_sysid.excitation_hung import SHORTEST, design
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.recording import Recording
from frasa_sysid.robot_body import Joints, joints_of
from frasa_sysid.robot_truth import Base, draw
from frasa_sysid.simulate_robot import simulate_robot
from frasa_sysid.writer import write_mcap

MODEL = Path("robot_model/nominal.xml")
SECONDS = 30.0
TILT = ("roll", "pitch")
LONGEST = 600.0  # [s]


def add_robot_arguments(group: "argparse._ArgumentGroup") -> None:
    """Give `simulate` the options of a robot; each is None when not given."""
    group.add_argument(
        "--base", choices=("fixed", "floating", "both"), help="held by the trunk [fixed], on its feet, or a run of each"
    )
    group.add_argument("--seconds", type=float, metavar="S", help=f"length [that of the excitation, {SECONDS:g}]")
    group.add_argument("--roll", type=float, metavar="DEG", help="of a held trunk; by default a few degrees at random")
    group.add_argument("--pitch", type=float, metavar="DEG", help="likewise, positive forward")
    group.add_argument("--excitation", type=Path, metavar="TRAJ", help="goals from `frasa-sysid excite`")
    group.add_argument("--model", type=Path, metavar="XML", help=f"body of the robot [{MODEL}]")


def run_robot(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate a robot and write its log.

    Raises:
        UsageError: a length that makes no sense, or an excitation of other joints.
    """
    seconds: float | None = args.seconds
    if seconds is not None and not 0.5 <= seconds <= LONGEST:
        raise UsageError(f"--seconds {seconds}: expected 0.5 to {LONGEST:g}")
    bases: tuple[Base, ...] = ("fixed", "floating") if args.base == "both" else (args.base or "fixed",)
    if args.excitation is not None and len(bases) > 1:
        raise UsageError("--excitation is for one base, not for --base both")
    for name in TILT:
        angle = getattr(args, name)
        if angle is not None and (bases == ("floating",) or not abs(angle) <= 180.0):
            raise UsageError(f"--{name} {angle}: expected degrees, -180 to 180, of a held trunk (--base fixed)")
    path = args.model or MODEL
    joints = joints_of(path)
    recordings = [_run(args, path, joints, base, f"{args.out.name}#{i:02d}") for i, base in enumerate(bases)]
    write_mcap(args.out, recordings)
    length = sum(one.duration for one in recordings)
    say(f"{args.out}: {length:.0f} s of a simulated robot (base {' and '.join(bases)}), seed {args.seed or 0}")
    return {
        "base": list(bases),
        "seconds": length,
        "truth": dict(recordings[0].truth),
        "seed": args.seed or 0,
        "outputs": {"log": args.out, "sha256": sha256_of_file(args.out)},
    }


def _run(args: argparse.Namespace, path: Path, joints: Joints, base: Base, name: str) -> Recording:
    excitation = _excitation(args.excitation, path, joints, base, args.seconds)
    truth = draw(base, args.seed or 0, joints.classes, joints.names)
    roll = truth.roll if args.roll is None else math.radians(args.roll)
    pitch = truth.pitch if args.pitch is None else math.radians(args.pitch)
    truth = replace(truth, roll=roll, pitch=pitch)
    length = excitation.seconds if args.seconds is None else args.seconds
    with shown_share(f"robot, base {base}, {length:g} s") as progress:
        return simulate_robot(path, joints, truth, excitation, length, name, progress=progress)


def _excitation(path: Path | None, model: Path, joints: Joints, base: Base, seconds: float | None) -> Excitation:
    if path is None:
        length = max(seconds or SECONDS, SHORTEST)
        if base == "floating":
            return standing(joints, length)
        with shown_share("excitation within limits") as progress:
            sizes, _ = fitted_sizes(model, joints, length, progress)
        return design(joints, sizes, length)
    excitation = read_excitation(path)
    missing = sorted(set(joints.names) ^ set(excitation.joints))
    if missing:
        raise UsageError(f"{path}: its joints are not the model's: {', '.join(missing)}")
    return excitation.for_joints(joints.names)

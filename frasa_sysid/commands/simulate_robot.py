"""`frasa-sysid simulate --robot`: a log of a whole robot with known truth."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import input_hashes, say, sha256_of_file
from frasa_sysid.commands.progress import shown_share
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_file import read_excitation
from frasa_sysid.excitation_hung import SHORTEST, design
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.holds import HOLDS, RECOMMENDED, UPRIGHT, gain_of, holds_of, part_seconds
from frasa_sysid.recording import Recording
from frasa_sysid.robot_body import Joints, joints_of
from frasa_sysid.robot_truth import Base, draw, held
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
    group.add_argument(
        "--seconds", type=float, metavar="S", help=f"length, all holds together [that of the excitation, {SECONDS:g}]"
    )
    group.add_argument(
        "--holds",
        metavar="LIST",
        help=f"ways to hold the trunk, a run each, of {','.join(HOLDS)} [{','.join(RECOMMENDED)}]; a few degrees off "
        "at random",
    )
    group.add_argument(
        "--firmware-gain",
        type=float,
        metavar="P",
        help="of the servos of a held robot [as --excitation says, else a third of the model's]",
    )
    group.add_argument("--roll", type=float, metavar="DEG", help="of a held trunk, in place of --holds: a single run")
    group.add_argument("--pitch", type=float, metavar="DEG", help="likewise, positive forward")
    group.add_argument(
        "--excitation", type=Path, nargs="+", metavar="TRAJ", help="goals from `frasa-sysid excite`, a file a hold"
    )
    group.add_argument("--model", type=Path, metavar="XML", help=f"body of the robot [{MODEL}]")


@dataclass(frozen=True)
class _Run:
    """One log to make: how the robot stands or is held, its goals, its length [s], and its number of that base."""

    base: Base
    excitation: Excitation
    seconds: float
    take: int


def run_robot(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate a robot and write its log.

    Raises:
        UsageError: a length or a hold that makes no sense, or an excitation of other joints.
    """
    bases: tuple[Base, ...] = ("fixed", "floating") if args.base == "both" else (args.base or "fixed",)
    path = args.model or MODEL
    joints = joints_of(path)
    holds = _checked_holds(args, bases, joints)
    runs = [one for base in bases for one in _runs(args, path, joints, base, holds)]
    recordings = [_simulated(args, path, joints, one, f"{args.out.name}#{i:02d}") for i, one in enumerate(runs)]
    inputs = input_hashes((path, *(args.excitation or ())))
    write_mcap(args.out, recordings, made={"command": "simulate", "inputs": inputs, "seed": args.seed or 0})
    length = sum(one.duration for one in recordings)
    how = [f"held {one.excitation.hold}" if one.base == "fixed" else "on its feet" for one in runs]
    say(f"{args.out}: {length:.0f} s of a simulated robot ({', '.join(how)}), seed {args.seed or 0}")
    return {
        "base": list(bases),
        "holds": [one.excitation.hold for one in runs if one.base == "fixed"],
        "seconds": length,
        "truth": dict(recordings[0].truth),
        "seed": args.seed or 0,
        "inputs": inputs,
        "outputs": {"log": args.out, "sha256": sha256_of_file(args.out)},
    }


def _checked_holds(args: argparse.Namespace, bases: tuple[Base, ...], joints: Joints) -> tuple[str, ...]:
    """How the trunk is held, one run after the other, unless excitations say it."""
    for name in TILT:
        angle = getattr(args, name)
        if angle is not None and (bases == ("floating",) or not abs(angle) <= 180.0):
            raise UsageError(f"--{name} {angle}: expected degrees, -180 to 180, of a held trunk (--base fixed)")
    tilted = any(getattr(args, name) is not None for name in TILT)
    if args.firmware_gain is not None and bases == ("floating",):
        raise UsageError("--firmware-gain is for a held trunk (--base fixed)")
    gain_of(args.firmware_gain, joints.firmware_gain)
    if args.excitation is not None and len(bases) > 1:
        raise UsageError("--excitation is for one base, not for --base both")
    if args.holds is not None and (bases == ("floating",) or tilted or args.excitation is not None):
        raise UsageError(
            "--holds is for a held trunk without --roll, --pitch and --excitation, which say it themselves"
        )
    holds = (UPRIGHT,) if tilted else holds_of(args.holds)
    count = 1 if bases == ("floating",) else len(args.excitation or holds)
    if args.seconds is not None and not 0.5 * count <= args.seconds <= LONGEST:
        raise UsageError(f"--seconds {args.seconds}: expected {0.5 * count:g} to {LONGEST:g}")
    return holds


def _runs(args: argparse.Namespace, path: Path, joints: Joints, base: Base, holds: Sequence[str]) -> list[_Run]:
    if args.excitation is not None:
        told = [_read(one, joints) for one in args.excitation]
        each = [one.seconds if args.seconds is None else part_seconds(args.seconds, told) for one in told]
    elif base == "floating":
        length = args.seconds or SECONDS
        told, each = [standing(joints, max(length, SHORTEST))], [length]
    else:
        length = part_seconds(args.seconds or SECONDS, holds)
        gain = gain_of(args.firmware_gain, joints.firmware_gain)
        told = [_designed(path, joints, hold, gain, max(length, SHORTEST)) for hold in holds]
        each = [length] * len(holds)
    return [_Run(base, one, seconds, i) for i, (one, seconds) in enumerate(zip(told, each, strict=True))]


def _simulated(args: argparse.Namespace, path: Path, joints: Joints, run: _Run, name: str) -> Recording:
    gain = (args.firmware_gain if run.base == "fixed" else None) or run.excitation.firmware_gain
    drawn = draw(
        run.base,
        args.seed or 0,
        joints.classes,
        joints.names,
        joints.types,
        joints.supply_voltage,
        joints.firmware_gain,
    )
    truth = held(drawn, run.excitation.hold, gain)
    roll = truth.roll if args.roll is None else math.radians(args.roll)
    pitch = truth.pitch if args.pitch is None else math.radians(args.pitch)
    truth = replace(truth, roll=roll, pitch=pitch)
    how = f"base {run.base}, {run.excitation.hold}, {run.seconds:g} s"
    with shown_share(f"robot, {how}") as progress:
        return simulate_robot(path, joints, truth, run.excitation, run.seconds, name, take=run.take, progress=progress)


def _designed(path: Path, joints: Joints, hold: str, gain: float, seconds: float) -> Excitation:
    with shown_share(f"excitation within limits, {hold}") as progress:
        sizes, _ = fitted_sizes(path, joints, seconds, progress, hold=hold, firmware_gain=gain)
    return design(joints, sizes, seconds, hold=hold, firmware_gain=gain)


def _read(path: Path, joints: Joints) -> Excitation:
    excitation = read_excitation(path)
    missing = sorted(set(joints.names) ^ set(excitation.joints))
    if missing:
        raise UsageError(f"{path}: its joints are not the model's: {', '.join(missing)}")
    return excitation.for_joints(joints.names)

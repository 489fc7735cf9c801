"""Virtual robots of random truth: errors and intervals of a whole-robot fit.

    python tests/benchmarks/bench_robot_fit.py [ROBOTS] [SECONDS] [--base fixed|floating|both] [--groups GROUP ...]

Each robot is drawn and simulated by `frasa_sysid.simulate_robot` (0.25 ms physics, 1 kHz firmware, delays, zeros, sag,
counts, jitter and bus loss; equations of its own), and fitted with the stored bench fits frozen. Held in the
recommended ways, SECONDS in all; or on the ground for SECONDS; with `both`, from its logs of either kind, SECONDS
each. Printed: errors of delays, scales, zeros and trunk, how often 95 % intervals hold the truth, and the time a fit
takes.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from frasa_sysid import stored_fit
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_hung import design as hung
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.holds import RECOMMENDED, RECOMMENDED_GAIN, part_seconds
from frasa_sysid.recording import Recording
from frasa_sysid.robot_body import Joints, joints_of
from frasa_sysid.robot_fit import RobotFit, fit_robot
from frasa_sysid.robot_problem import GROUPS
from frasa_sysid.robot_truth import Base, RobotTruth, draw
from frasa_sysid.robot_truth import held as turned
from frasa_sysid.simulate_robot import simulate_robot

ROOT = Path(__file__).parents[2] / "robot_model"
MODEL = ROOT / "nominal.xml"


def truth_of(recording: Recording) -> dict[str, float]:
    """True numbers as a fit can know them: delays relative to the age of positions."""
    truth = dict(recording.truth)
    age = truth["sensor.position_delay"]
    truth["command.delay"] = truth["mx64.delay"] + age
    for name in ("velocity", "gyro", "orientation"):
        truth[f"sensor.{name}_delay"] -= age
    return truth


def excitations_of(joints: Joints, args: argparse.Namespace) -> list[tuple[Base, Excitation]]:
    """Goals of every log of a robot, and what its trunk does meanwhile."""
    found: list[tuple[Base, Excitation]] = []
    if args.base != "floating":
        each = part_seconds(args.seconds, RECOMMENDED)
        for hold in RECOMMENDED:
            sizes = fitted_sizes(MODEL, joints, each, hold=hold, firmware_gain=args.firmware_gain)[0]
            found.append(("fixed", hung(joints, sizes, each, hold=hold, firmware_gain=args.firmware_gain)))
    if args.base != "fixed":
        found.append(("floating", standing(joints, args.seconds)))
    return found


def robot_of(seed: int, joints: Joints, base: Base, goals: Excitation) -> RobotTruth:
    """The robot of a seed as it is held, or stands, for those goals."""
    drawn = draw(base, seed, joints.classes, joints.names)
    return turned(drawn, goals.hold, goals.firmware_gain) if base == "fixed" else drawn


def fits(args: argparse.Namespace) -> Iterator[tuple[int, RobotFit, dict[str, float], float]]:
    """Seed, fit, truth and seconds of every robot."""
    joints = joints_of(MODEL)
    frozen = [stored_fit.load(ROOT / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]
    excitations = excitations_of(joints, args)
    for seed in range(args.first, args.first + args.robots):
        recordings = [
            simulate_robot(
                MODEL, joints, robot_of(seed, joints, base, one), one, one.seconds, f"robot{seed}.mcap#{i}", take=i
            )
            for i, (base, one) in enumerate(excitations)
        ]
        truth = {name: value for one in recordings for name, value in truth_of(one).items()}
        started = time.monotonic()
        found = fit_robot(MODEL, frozen, recordings, groups=args.groups)
        yield seed, found, truth, time.monotonic() - started


def arguments() -> argparse.Namespace:
    """What was asked."""
    parser = argparse.ArgumentParser()
    parser.add_argument("robots", nargs="?", type=int, default=30)
    parser.add_argument("seconds", nargs="?", type=float, default=30.0)
    parser.add_argument("--base", choices=("fixed", "floating", "both"), default="fixed")
    parser.add_argument("--groups", nargs="+", choices=GROUPS, help="what is free [trunk on the ground only]")
    parser.add_argument("--first", type=int, default=0, help="seed of the first robot")
    parser.add_argument("--firmware-gain", type=float, default=RECOMMENDED_GAIN, help="P of a held robot's servos")
    return parser.parse_args()


def main() -> None:
    """Run the study."""
    args = arguments()
    rows = defaultdict(list)
    times, before, after = [], [], []
    for seed, found, truth, seconds in fits(args):
        times.append(seconds)
        before.append(found.errors["nominal"]["position"][0])
        after.append(found.errors["fitted"]["position"][0])
        for free, one, value, half in zip(
            found.problem.free, found.estimates(), found.settled.x, found.half, strict=True
        ):
            field = free.name.rpartition(".")[2]
            kind = free.name if "delay" in field else field
            rows[kind].append((abs(value - truth[free.name]), half, one.verdict))
        print(f"robot {seed}: {before[-1] * 1e3:.2f} to {after[-1] * 1e3:.2f} mrad in {times[-1]:.0f} s", flush=True)
    print(f"{args.robots} robots, {args.base}, {args.seconds:g} s each; positions on average "
          f"{np.mean(before) * 1e3:.2f} to {np.mean(after) * 1e3:.2f} mrad")  # fmt: skip
    print(f"a fit takes {np.median(times):.0f} s (median), {np.max(times):.0f} s at most")
    tell(rows)


def tell(rows: dict[str, list[tuple[float, float, str]]]) -> None:
    """Print errors and intervals by kind of number."""
    print(f"{'number':26s} {'said':>7s} {'median error':>14s} {'worst':>9s}   95 % intervals that hold the truth")
    inside = total = 0
    for kind, found_rows in rows.items():
        said = [row for row in found_rows if row[2] in ("identified", "known roughly")]
        held = [error <= half for error, half, _ in said]
        inside, total = inside + sum(held), total + len(held)
        unit, scale = _unit(kind)
        if said:
            errors = np.array([row[0] for row in said]) * scale
            sure = [row[0] * scale for row in found_rows if row[2] == "identified"]
            print(f"{kind:26s} {len(said):3d}/{len(found_rows):3d} {np.median(errors):11.3f} {unit:3s}"
                  f" {errors.max():9.3f}   {100.0 * np.mean(held):5.1f} %, identified {len(sure)}"
                  + (f", worst {max(sure):.3f}" if sure else ""))  # fmt: skip
    print(f"all that are known: {inside} of {total} intervals hold the truth, {100.0 * inside / max(total, 1):.1f} %")


def _unit(kind: str) -> tuple[str, float]:
    if "delay" in kind:
        return "ms", 1e3
    if "shift" in kind:
        return "mm", 1e3
    return ("deg", 57.29578) if kind == "zero" else ("%", 100.0)


if __name__ == "__main__":
    main()

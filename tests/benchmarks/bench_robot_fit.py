"""Virtual robots of random truth: errors and intervals of a whole-robot fit.

    python tests/benchmarks/bench_robot_fit.py [ROBOTS] [SECONDS] [--base fixed|floating]

Each robot is drawn and simulated by `frasa_sysid.simulate_robot` (0.25 ms physics, 1 kHz firmware, delays, zeros, sag,
counts, jitter and bus loss; equations of its own), and fitted with the stored bench fits frozen; held in the
recommended ways, SECONDS in all. Printed: errors of delays, scales and zeros, how often 95 % intervals hold the truth,
and the time a fit takes.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from frasa_sysid import stored_fit
from frasa_sysid.excitation_hung import design as hung
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.holds import RECOMMENDED, RECOMMENDED_GAIN, part_seconds
from frasa_sysid.recording import Recording
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_fit import fit_robot
from frasa_sysid.robot_truth import draw
from frasa_sysid.robot_truth import held as turned
from frasa_sysid.simulate_robot import simulate_robot

ROOT = Path(__file__).parents[2] / "robot_model"


def truth_of(recording: Recording) -> dict[str, float]:
    """True numbers as a fit can know them: delays relative to the age of positions."""
    truth = dict(recording.truth)
    age = truth["sensor.position_delay"]
    truth["command.delay"] = truth["mx64.delay"] + age
    for name in ("velocity", "gyro", "orientation"):
        truth[f"sensor.{name}_delay"] -= age
    return truth


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("robots", nargs="?", type=int, default=30)
    parser.add_argument("seconds", nargs="?", type=float, default=30.0)
    parser.add_argument("--base", default="fixed")
    parser.add_argument("--firmware-gain", type=float, default=RECOMMENDED_GAIN, help="P of a held robot's servos")
    args = parser.parse_args()
    fits = [stored_fit.load(ROOT / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]
    rows = defaultdict(list)
    times, before, after = [], [], []
    model = ROOT / "nominal.xml"
    joints = joints_of(model)
    if args.base == "fixed":
        each = part_seconds(args.seconds, RECOMMENDED)
        how = [{"hold": hold, "firmware_gain": args.firmware_gain} for hold in RECOMMENDED]
        excitations = [hung(joints, fitted_sizes(model, joints, each, **one)[0], each, **one) for one in how]
    else:
        excitations = [standing(joints, args.seconds)]
    for seed in range(args.robots):
        drawn = draw(args.base, seed, joints.classes, joints.names)
        recordings = [
            simulate_robot(model, joints, robot, one, one.seconds, f"robot{seed}.mcap#{i}", take=i)
            for i, one in enumerate(excitations)
            for robot in [turned(drawn, one.hold, one.firmware_gain)]
        ]
        truth = truth_of(recordings[0])
        started = time.monotonic()
        found = fit_robot(model, fits, recordings)
        times.append(time.monotonic() - started)
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
    print(f"{'number':26s} {'said':>6s} {'median error':>14s} {'worst':>9s}   95 % intervals that hold the truth")
    inside = total = 0
    for kind, found_rows in rows.items():
        said = [row for row in found_rows if row[2] in ("identified", "known roughly")]
        held = [error <= half for error, half, _ in said]
        inside, total = inside + sum(held), total + len(held)
        unit, scale = ("ms", 1e3) if "delay" in kind else ("deg", 57.29578) if kind == "zero" else ("%", 100.0)
        if said:
            errors = np.array([row[0] for row in said]) * scale
            print(f"{kind:26s} {len(said):3d}/{len(found_rows):3d} {np.median(errors):11.3f} {unit:3s}"
                  f" {errors.max():9.3f}   {100.0 * np.mean(held):5.1f} %")  # fmt: skip
    print(f"all that are known: {inside} of {total} intervals hold the truth, {100.0 * inside / max(total, 1):.1f} %")


if __name__ == "__main__":
    main()

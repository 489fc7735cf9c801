"""Delays, drifts and warnings that real logs of others give; and how often intervals hold a known delay.

    python tests/benchmarks/bench_real_delays.py [DATA]   (some minutes)

DATA is a folder with the logs as they were published (`imu_on_axis/`, `mx64_dynaban/`, `robstride/`, `mx106_jandi/`,
`robots/`); they are not part of this repository. Without it only the synthetic part runs.
"""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from frasa_sysid.commands.lag import interval_words, joint_words
from frasa_sysid.commands.log_health import clock_words
from frasa_sysid.joint_checks import checks
from frasa_sysid.lag import Lag, lags
from frasa_sysid.lag_joint import joint_lags
from frasa_sysid.readers.dynaban import read_dynaban
from frasa_sysid.readers.harold import read_harold
from frasa_sysid.readers.imu_on_axis import read_imu_on_axis
from frasa_sysid.readers.jandi import read_jandi
from frasa_sysid.readers.kbot import read_kbot
from frasa_sysid.readers.robstride import read_robstride
from frasa_sysid.readers.rostopic_csv import read_rostopic_csv
from frasa_sysid.readers.upkie import read_upkie
from frasa_sysid.recording import FloatArray, Recording, RigFacts, Signal

SEEDS = 100
DURATION = 20.0  # [s]
COUNT = 2 * np.pi / 4096  # [rad] a step of a servo's encoder
MOTIONS = ("multisine", "chirp", "steps", "noise 5 %")
FREQUENCIES = np.array([0.4, 0.9, 1.7, 2.3, 3.1])  # [Hz]


def motion(kind: str, rng: np.random.Generator) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """A motion [rad] of time, and the noise of its readings [rad]."""
    phase = rng.uniform(0.0, 2 * np.pi, FREQUENCIES.size)
    levels = rng.normal(0.0, 0.5, int(DURATION) + 4)
    if kind == "chirp":
        return lambda t: 0.5 * np.sin(2 * np.pi * (0.3 * t + 0.07 * t**2)), 0.001
    if kind == "steps":
        # Ramps of 0.5 s from level to level: what a servo makes of steps.
        return lambda t: np.interp(t, np.arange(levels.size) - 1.0 + 0.5 * (np.arange(levels.size) % 2), levels), 0.001
    noise = 0.025 if kind == "noise 5 %" else 0.001
    waves = 2 * np.pi * FREQUENCIES
    return lambda t: 0.5 * (np.sin(np.multiply.outer(t, waves) + phase) / FREQUENCIES).sum(axis=-1), noise


def synthetic(kind: str, seed: int, speed: bool) -> tuple[Recording, float]:
    """A log whose second channel is late by a random, not whole number of samples; each on its own uneven clock."""
    rng = np.random.default_rng(seed)
    q, noise = motion(kind, rng)
    delay = float(rng.uniform(0.002, 0.06))
    t = np.arange(0.0, DURATION, 0.01) + rng.uniform(0.0, 0.002, int(DURATION / 0.01))
    s = np.arange(0.0, DURATION, 0.013)
    s = s + rng.uniform(0.0, 0.002, s.size)
    position = np.round((q(t) + noise * rng.normal(size=t.size)) / COUNT) * COUNT
    late = (q(s - delay + 5e-4) - q(s - delay - 5e-4)) / 1e-3 if speed else q(s - delay)
    late = late + 10 * noise * rng.normal(size=s.size) if speed else late + noise * rng.normal(size=s.size)
    name, unit = ("velocity", "rad/s") if speed else ("late", "rad")
    signals = {"position": Signal("position", "rad", t, position), name: Signal(name, unit, s, late)}
    return Recording("synthetic", signals, RigFacts(), "simulated", "none", "", "file"), delay


def coverage() -> None:
    print(f"Known delays, {SEEDS} seeds each: uneven own clocks of 10 and 13 ms, {DURATION:.0f} s, encoder of 4096")
    print("motion      channel   |error| ms: median  95 %   worst | 95 % interval: half ms, holds | verdicts")
    for kind in MOTIONS:
        for speed in (False, True):
            errors, halves, verdicts = [], [], Counter[str]()
            for seed in range(SEEDS):
                recording, delay = synthetic(kind, seed, speed)
                one = lags([recording], "velocity" if speed else "late", "position")[0]
                errors.append(abs((one.delay or np.nan) - delay))
                halves.append(one.half_width)
                verdicts[one.verdict] += 1
            name = "velocity" if speed else "position"
            size, half = 1e3 * np.array(errors), 1e3 * np.array(halves)
            print(
                f"{kind:11} {name}  {np.median(size):13.3f} {np.quantile(size, 0.95):7.3f}"
                f" {size.max():7.3f} | {np.median(half):16.3f} {100 * (size < half).mean():9.0f} % | {dict(verdicts)}"
            )


def told(title: str, found: Sequence[Lag], one_by_one: bool = True) -> None:
    print(f"\n{title}")
    for one in found if one_by_one else []:
        value = "-" if one.delay is None else f"{1e3 * one.delay:.2f} ms ({interval_words(one.low, one.high)})"
        joint = f" {one.joint}" if one.joint else ""
        print(f"  {one.recording}{joint}: {value}, ratio {one.ratio:.3f}, {one.verdict}: {one.reason}")
        if len(one.bands) > 1:
            by_band = (
                f"{band.frequency:.2f} Hz {1e3 * band.delay:.1f} ± {1960 * band.error:.1f}" for band in one.bands
            )
            print(f"      by frequency [ms]: {', '.join(by_band)}")
    if not one_by_one:
        print(f"  {dict(Counter(one.verdict for one in found))}")
    for joint in joint_lags(found):
        print(f"  together: {joint_words(joint)}")
        for row in joint.by_frequency:
            group = "" if row.group_delay is None else f", group delay {1e3 * row.group_delay:.2f} ms"
            print(
                f"      {row.frequency:.2f} Hz: {1e3 * row.delay:.2f} ms ({interval_words(row.low, row.high)}){group}"
            )


def health(title: str, recordings: Sequence[Recording]) -> None:
    print(f"\n{title}")
    for recording in recordings:
        print(f"  {recording.name}: {recording.duration:.1f} s, {', '.join(sorted(recording.signals))[:150]}")
        for fault in recording.faults:
            print(f"      handled  {fault.message}")
        for clocks in recording.extra.get("clocks", []):
            print(f"      clocks   {clock_words(clocks)}")
        for check in checks(recording):
            print(f"      {check.level:8} {check.message}")


def real(data: Path) -> None:
    imu = [read_imu_on_axis(path)[0] for path in sorted((data / "imu_on_axis").iterdir())]
    told("imu_on_axis: gyro against the motor's commanded speed", lags(imu, "gyro", "goal_velocity"))
    dynaban = read_dynaban(data / "mx64_dynaban" / "completeTest.gz")
    late = lags(dynaban, "velocity", "position")
    good = [one for one in late if one.verdict == "identified"]
    told("mx64_dynaban: speed against position, the tests that tell", good)
    told("mx64_dynaban: all tests", late, one_by_one=False)
    robstride = [read_robstride(path)[0] for path in sorted((data / "robstride").glob("real_*"))]
    for kind in ("chirp", "steps"):
        some = [one for one in robstride if one.rig.trajectory == kind]
        told(f"robstride, {kind}: position against goal", lags(some, "position", "goal"))
    jandi = [read_jandi(path)[0] for path in sorted((data / "mx106_jandi").iterdir())]
    told("mx106_jandi: speed against position", lags(jandi, "velocity", "position"))
    told("mx106_jandi: position against goal", lags(jandi, "position", "goal"))
    health("mx106_jandi: clocks", jandi)
    kbot = read_kbot(data / "robstride" / "kbot_squat_real_data.json.gz")
    harold = [read_harold(path)[0] for path in sorted((data / "robots").glob("harold*"))]
    upkie = read_upkie(data / "robots" / "upkie_robot.json")
    health("K-Bot squat", kbot)
    health(
        "robots/: Harold, Upkie, Spirit 40",
        [*harold, *upkie, *read_rostopic_csv(data / "robots" / "spirit40_imu.csv.gz")],
    )
    told("K-Bot squat: position against goal", lags(kbot, "position", "goal"))
    told("Upkie: velocity against position", lags(upkie, "velocity", "position"))
    told("Harold: position against goal", lags(harold[1:], "position", "goal"), one_by_one=False)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        real(Path(sys.argv[1]))
        print()
    coverage()

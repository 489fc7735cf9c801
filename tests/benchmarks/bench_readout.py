"""How well the duty tells the ages of two channels, on random simulated benches; and what real logs say.

    python tests/benchmarks/bench_readout.py [DATA]

Each bench has one load, two gains, four trajectories, a position and a duty that are up to 4 ms old, a command delay
of 1 to 12 ms and one of five sampling periods, two of which keep step with the firmware. DATA is a folder with XL330
and Jandi logs as they were published (`xl330/`, `mx106_jandi/`); without it only the simulated part runs.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from frasa_sysid.readers.bam import read_bam
from frasa_sysid.readers.jandi import read_jandi
from frasa_sysid.readout import separate
from frasa_sysid.recording import Recording
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.simulate import PHYSICS_DT, simulate_bench
from frasa_sysid.simulated_bench import BENCHES, Bench

COUNT = 40
SEED = 5
LONGEST_AGE = 0.004  # [s]
DELAYS = (0.001, 0.012)  # [s]
PERIODS = (0.005, 0.0053, 0.0097, 0.01, 0.0127)  # [s]


def random_bench(index: int, rng: np.random.Generator) -> tuple[str, Bench]:
    name = ("mx106", "mx64")[index % 2]
    whole = BENCHES[name]
    load, gain = rng.integers(len(whole.loads)), rng.integers(len(whole.gains) - 1)
    ages = np.round(rng.uniform(0.0, LONGEST_AGE, 2) / PHYSICS_DT) * PHYSICS_DT
    return name, replace(
        whole,
        loads=whole.loads[load : load + 1],
        gains=whole.gains[gain : gain + 2],
        position_age=float(ages[0]),
        duty_age=float(ages[1]),
        command_delay=float(rng.uniform(*DELAYS)),
        period=float(rng.choice(PERIODS)),
        seed=index,
    )


def simulated() -> None:
    rng = np.random.default_rng(SEED)
    errors, widths, held, sums = [], [], 0, 0
    for index in range(COUNT):
        name, bench = random_bench(index, rng)
        logs = simulate_bench(PUBLISHED_M4[name], bench, "bench.mcap")
        found, truth = separate(logs), logs[0].truth["bench.readout"]
        if found.difference is None or found.total is None:
            print(f"{name:6} {bench.loads[0][0]:.2f} kg, {bench.period * 1e3:4.1f} ms: {found.reason}")
            continue
        best, low, high = found.difference
        total = bench.command_delay + bench.position_age
        errors.append(best - truth)
        widths.append(high - low)
        held += low <= truth <= high
        sums += found.total[0] <= total <= found.total[1]
        print(
            f"{name:6} {bench.loads[0][0]:.2f} kg, {bench.period * 1e3:4.1f} ms: difference {truth * 1e3:6.2f} ms, "
            f"found {best * 1e3:6.2f} ({low * 1e3:.2f} to {high * 1e3:.2f}); sum {total * 1e3:5.2f} ms, "
            f"found {found.total[0] * 1e3:.2f} to {found.total[1] * 1e3:.2f}"
        )
    size = 1e3 * np.abs(errors)
    print(
        f"\n{len(errors)} of {COUNT} benches separated: difference off by {np.median(size):.2f} ms (median), "
        f"{np.quantile(size, 0.95):.2f} (95 %), {size.max():.2f} (worst); interval {np.median(widths) * 1e3:.2f} ms "
        f"wide (median); truth inside for {held} differences and {sums} sums"
    )


def told(title: str, recordings: list[Recording]) -> None:
    found = separate(recordings)
    more = "" if found.loop_gain is None else f"; {found.loop_gain:.6f} duty/rad for each unit of firmware gain"
    print(f"\n{title}: {found.words()}{more}")


def real(data: Path) -> None:
    xl330 = [read_bam(path)[0] for path in sorted((data / "xl330").glob("*.json*"))]
    told("XL330, all runs", xl330)
    for gain in sorted({one.rig.firmware_gain or 0.0 for one in xl330}):
        told(f"XL330, P = {gain:g}", [one for one in xl330 if one.rig.firmware_gain == gain])
    jandi = [read_jandi(path)[0] for path in sorted((data / "mx106_jandi").iterdir())]
    told("Jandi", jandi)


if __name__ == "__main__":
    simulated()
    if len(sys.argv) > 1:
        real(Path(sys.argv[1]))

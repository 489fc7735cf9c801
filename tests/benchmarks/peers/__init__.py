"""Other ways to simulate and fit the same bench logs, to hold ours against.

Every peer has `measure(bench, ...) -> Measured`, which times evaluations of its own objective.
"""

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from frasa_sysid.rig import BenchRun
from frasa_sysid.servo import Servo

ENOUGH = 2.0  # [s] of repetitions, once there are as many as asked for


@dataclass(frozen=True)
class Bench:
    """Logs and what is known of their servo.

    Attributes:
        runs: on the grid of the bench model.
        servo: firmware constants, supply and gain at which the nominal values are stated.
        nominal: `ServoValues` fields before any fit.
        timestep: of the bench model [s].
        model_path: of the bench model.
    """

    runs: tuple[BenchRun, ...]
    servo: Servo
    nominal: Mapping[str, float]
    timestep: float
    model_path: Path

    @property
    def seconds(self) -> float:
        """Recorded time of all logs [s]."""
        return sum(float(run.t[-1]) for run in self.runs)


@dataclass(frozen=True)
class Timing:
    """Wall time of repeated calls [s]; on a shared machine the fastest is the cost, the median says how shared."""

    fastest: float
    median: float

    def per(self, count: int) -> "Timing":
        """Of one of `count` candidates that were simulated together."""
        return Timing(self.fastest / count, self.median / count)


@dataclass(frozen=True)
class Measured:
    """Cost of one evaluation: one candidate on all logs.

    Attributes:
        timing: of one evaluation.
        log_steps: simulated steps, summed over logs.
        seconds: of log time that they cover.
        evaluate: the evaluation itself, giving the mean absolute position error [rad].
    """

    timing: Timing
    log_steps: int
    seconds: float
    evaluate: Callable[[], float]


def timed(call: Callable[[], object], least: int = 5) -> Timing:
    """Time a call, after one that does not count, `least` times and longer if it is short."""
    times: list[float] = []
    while len(times) <= least or (sum(times) < ENOUGH and len(times) < 100):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return Timing(min(times[1:]), statistics.median(times[1:]))

"""Tuning keyframes: CMA-ES over the times and angles of one routine after the other, on real trials.

routine -> numbers -> CMA-ES asks -> trials -> cost -> CMA-ES tells -> the mean is checked, the best saved

The trials of a generation run side by side. Nothing here knows a robot: joints, standing pose and rate limit come from
the task, limits from the model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np
from cmaes import CMA

from frasa_rl.fall_trials import Falls, Trial
from frasa_rl.keyframe import KeyframeController
from frasa_rl.protocol import SIDES, Side
from frasa_rl.robot import Floats
from frasa_rl.routine import LONGEST_S, Key, Keyframes, Routine
from frasa_rl.simulation import Start
from frasa_sysid.calibration import UsageError

_ANGLE = 60.0  # degrees that one unit of the search stands for
_TIME = 0.5  # natural logarithm of a duration that one unit stands for
_SHORTEST_S = 0.05
_FAILED = 10.0  # cost of a failure beside how far it ended from the standing pose; no success costs as much
_PATIENCE_S = 2.0  # beyond the routine's own time, until a trial counts as failed


@dataclass(frozen=True)
class Tuning:
    """How long and how widely to search.

    Attributes:
        minutes: both sides together; each has one generation at least.
        sigma: first standard deviation of the search, in units of 60 deg and of a factor of 1.65 in time.
        population: candidates a generation.
        trials: falls a candidate is tried on, the same for all of a generation and new in the next.
        checks: falls that decide whether a generation's mean is better than the best so far, always the same.
        seed: of everything.
        sides: which routines.
        generations: of each side at most; None for no limit but the time.
    """

    minutes: float = 20.0
    sigma: float = 0.05
    population: int = 12
    trials: int = 3
    checks: int = 8
    seed: int = 0
    sides: tuple[Side, ...] = SIDES
    generations: int | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.minutes) and self.minutes > 0.0):
            raise UsageError(f"minutes are {self.minutes:g}: expected more than 0")
        if self.seed < 0 or self.population < 4 or min(self.trials, self.checks) < 1 or not self.sigma > 0.0:
            raise UsageError(
                "expected a seed of 0 or more, a population of 4 or more, trials, checks and sigma above 0"
            )


@dataclass(frozen=True)
class Progress:
    """Where a search stands.

    Attributes:
        side: the routine being tuned.
        share: of the time, 0 to 1.
        cost: of the best so far: mean time to stand [s], more for failures.
        success_rate: of the best so far, over the checks.
    """

    side: Side
    share: float
    cost: float
    success_rate: float


def tune(
    keyframes: Keyframes,
    falls: Falls,
    tuning: Tuning,
    save: Callable[[Keyframes], None],
    tell: Callable[[Progress], None] = lambda _: None,
) -> Keyframes:
    """Search from the given keyframes on; every improvement is saved at once.

    An interrupted search loses nothing that was saved: starting again from the saved file goes on from there.

    Args:
        keyframes: where to start; its number of keys stays.
        falls: what trials run on; with `randomize` every fall is another robot's.
        tuning: how long and how widely.
        save: called with the best so far, whenever it improves.
        tell: called after every generation.

    Returns:
        The best so far.
    """
    begun, span = monotonic(), 60.0 * tuning.minutes / len(tuning.sides)
    for index, side in enumerate(tuning.sides):
        search = _Search(keyframes, falls, tuning, side)
        while search.going:
            if search.generation():
                keyframes = search.best
                save(keyframes)
            spent = monotonic() - begun
            tell(Progress(side, min(1.0, spent / (span * len(tuning.sides))), search.cost, search.success_rate))
            if spent >= span * (index + 1):
                break
    return keyframes


class _Search:
    """CMA-ES over one routine."""

    def __init__(self, keyframes: Keyframes, falls: Falls, tuning: Tuning, side: Side) -> None:
        self.best, self._falls, self._tuning, self._side = keyframes, falls, tuning, side
        self._limits = np.degrees(falls.robot.limits)
        self._rng = np.random.default_rng([tuning.seed, SIDES.index(side)])
        self._checks = self._draw(tuning.checks)
        self.cost, self.success_rate = self._try([keyframes], self._checks)[0]
        self._cma = CMA(
            mean=encode(getattr(keyframes, side)),
            sigma=tuning.sigma,
            seed=int(self._rng.integers(2**31)),
            population_size=tuning.population,
        )

    @property
    def going(self) -> bool:
        """Whether the search has not converged, nor used up its generations."""
        most = self._tuning.generations
        return (most is None or self._cma.generation < most) and not self._cma.should_stop()

    def generation(self) -> bool:
        """Ask, try, tell, and check the new mean; whether it is the best so far."""
        starts = self._draw(self._tuning.trials)
        candidates = [self._cma.ask() for _ in range(self._tuning.population)]
        tried = self._try([self._with(one) for one in candidates], starts)
        costs = [cost + self._outside(one) for (cost, _), one in zip(tried, candidates, strict=True)]
        self._cma.tell(list(zip(candidates, costs, strict=True)))
        mean = self._with(self._cma.mean)
        cost, success_rate = self._try([mean], self._checks)[0]
        better = cost < self.cost
        if better:
            self.best, self.cost, self.success_rate = mean, cost, success_rate
        return better

    def _with(self, numbers: Floats) -> Keyframes:
        """The keyframes with this side's routine from the search's numbers."""
        routine = decode(numbers, self._limits)
        return replace(self.best, prone=routine) if self._side == "prone" else replace(self.best, supine=routine)

    def _outside(self, numbers: Floats) -> float:
        """A small cost for angles beyond the limits, so that the search comes back from there."""
        angles = _split(numbers, len(self._limits))[0]
        beyond = np.abs(angles - np.clip(angles, self._limits[:, 0], self._limits[:, 1])).sum()
        return float(beyond) / 100.0

    def _draw(self, count: int) -> list[Start]:
        """Some falls on this side."""
        return self._falls.make(self._side, [int(seed) for seed in self._rng.integers(2**31, size=count)])

    def _try(self, candidates: Sequence[Keyframes], starts: Sequence[Start]) -> list[tuple[float, float]]:
        """Mean cost and success rate of each candidate over some falls."""
        routines: list[Routine] = [getattr(one, self._side) for one in candidates]
        longest = [sum(key.duration_s for key in one.keys) + one.rise_s + _PATIENCE_S for one in routines]
        trials = self._falls.run([KeyframeController(one, self._falls.task) for one in candidates], starts, longest)
        return [
            (float(np.mean([cost_of(one) for one in some])), float(np.mean([np.isfinite(one.time_s) for one in some])))
            for some in trials
        ]


def cost_of(trial: Trial) -> float:
    """The time of a success [s]; for a failure more, the farther from the standing pose it ended."""
    return trial.time_s if np.isfinite(trial.time_s) else _FAILED + 10.0 * trial.worst_error + 10.0 * trial.ended


def encode(routine: Routine) -> Floats:
    """The numbers that the search varies: every key's angles and duration, and the rise, shape (K (n + 1) + 1,)."""
    keys = [[*(angle / _ANGLE for angle in key.angles_deg), _log(key.duration_s)] for key in routine.keys]
    return np.array([number for key in keys for number in key] + [_log(routine.rise_s)])


def decode(numbers: Floats, limits_deg: Floats) -> Routine:
    """The routine of such numbers, angles cut to the limits (n, 2) [deg], durations to what a file may hold."""
    angles, durations = _split(numbers, len(limits_deg))
    angles = np.clip(angles, limits_deg[:, 0], limits_deg[:, 1])
    durations = np.clip(durations, _SHORTEST_S, LONGEST_S)
    keys = tuple(
        Key(round(float(duration), 3), tuple(round(float(angle), 2) for angle in pose))
        for duration, pose in zip(durations[:-1], angles, strict=True)
    )
    return Routine(keys, round(float(durations[-1]), 3))


def _split(numbers: Floats, joints: int) -> tuple[Floats, Floats]:
    """Angles (K, n) [deg] and durations (K + 1,) [s]."""
    keys = numbers[:-1].reshape(-1, joints + 1)
    return keys[:, :-1] * _ANGLE, np.exp(np.append(keys[:, -1], numbers[-1]) * _TIME)


def _log(duration: float) -> float:
    return float(np.log(max(duration, _SHORTEST_S)) / _TIME)

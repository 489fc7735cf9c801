"""Falls that no run trains on, and how a policy does on them: the 5 degree rule within an episode, ends included."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from frasa_rl.config import Task
from frasa_rl.controllers import PolicyController
from frasa_rl.fall_trials import Falls
from frasa_rl.falls import Kind
from frasa_rl.physics import own_physics, with_physics
from frasa_rl.policy import Policy
from frasa_rl.pool import Pool, cache_folder
from frasa_rl.protocol import SIDES
from frasa_rl.simulation import Start
from frasa_sysid.calibration import load_calibration

SEED = 5_000  # the same falls for all runs, so that runs can be compared
_BRANCH = 2  # of the seed; training's pools and choices are on others, whatever their seed


@dataclass(frozen=True)
class Result:
    """How a policy did.

    Attributes:
        prone, supine: share of the falls of that side that ended standing.
        time_s: mean time of these, from the first action to the start of the time held; NaN without any [s].
    """

    prone: float
    supine: float
    time_s: float

    @property
    def success(self) -> float:
        """Share of all falls."""
        return (self.prone + self.supine) / 2.0


class HeldOut:
    """Sets of falls, half of them prone and half supine, each with a robot and floor of its own.

    Args:
        model: a model file; a calibrated one brings its ranges along.
        task: what is trained; an episode's time is a trial's.
        falls: of each side in a set.
        physics: how they are simulated, a name of `frasa_rl.physics`.

    Raises:
        ModelError: the file is missing or broken, or lacks a joint or sensor.
        CalibrationError: the model is calibrated and its ranges are missing or belong to another.
    """

    def __init__(self, model: Path, task: Task, falls: int, physics: str) -> None:
        stepped = with_physics(own_physics(task), physics)
        # Which starts it has is training's: without that the same falls are found in the cache for all.
        self._task = replace(stepped, near_target_share=0.0, near_target_push=0.0, falling_share=0.0)
        self._falls = Falls(model, self._task, randomize=True)
        self._calibration = load_calibration(model)
        self._kinds: list[Kind] = [side for side in SIDES for _ in range(falls)]
        self._sets: dict[int, list[Start]] = {}

    def starts(self, which: int) -> list[Start]:
        """The falls of a set, prone ones first; settled once and kept in the cache folder."""
        if which not in self._sets:
            pool = Pool(
                self._falls.maker,
                self._calibration,
                len(self._kinds),
                SEED,
                cache_folder(),
                kinds=self._kinds,
                branch=(_BRANCH, which),
            )
            self._sets[which] = pool.starts
        return self._sets[which]

    def run(self, policy: Policy, which: int) -> Result:
        """Let a policy try the falls of a set, acting as it would on the robot.

        A quarter of each side is tried first: who stands up from none of them is not asked for the rest, because
        trials that fail take the longest, and early in a run all do.
        """
        starts, each = self.starts(which), len(self._kinds) // 2
        first = np.arange(len(starts)) % each < max(1, each // 4)
        times = np.full(len(starts), np.nan)
        for some in (first, ~first):
            if some.any() and (some is first or np.isfinite(times).any()):
                times[some] = self._times(policy, [start for start, one in zip(starts, some, strict=True) if one])
        prone, supine = np.isfinite(times).reshape(2, -1).mean(axis=1)
        known = times[np.isfinite(times)]
        return Result(float(prone), float(supine), float(known.mean()) if known.size else float("nan"))

    def _times(self, policy: Policy, starts: list[Start]) -> list[float]:
        trials = self._falls.run([PolicyController(policy, "policy")], starts, [self._task.episode_s])[0]
        return [one.time_s for one in trials]

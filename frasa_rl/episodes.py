"""Episodes that follow one another: many robots, each restarted from a pool when its episode ends."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl.batch_env import Flags, Outcome, StandUpBatch
from frasa_rl.config import Task
from frasa_rl.curriculum import Curriculum
from frasa_rl.observation import Observation
from frasa_rl.pool import Pool, cache_folder
from frasa_rl.robot import Floats
from frasa_rl.snapshots import Arrays, nested, part, set_states, state_of
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import calibration_id, load_calibration


@dataclass(frozen=True)
class Step:
    """A step of all robots, and what they see next.

    Attributes:
        out: what it brought; observations before any restart.
        reward: as the curriculum pays, shape (count,).
        over: whose episode ended, shape (count,).
        following: observations with which the next step is decided: of restarted robots at their starts, shape
            (count, 22).
    """

    out: Outcome
    reward: Floats
    over: Flags
    following: Observation


class Episodes:
    """Many robots; an episode that ends is followed by one of another start, chosen by the generator of its place.

    Attributes:
        core: the robots.
        pool: their starts.
        curriculum: chooses starts and pays.
        calibration_id: of the model.
        chosen: which start every robot has now, shape (count,).

    Args:
        core: nobody else's.
        pool: made of the same model and task.
        seed: of the choices.
        curriculum: None for the task as it is.
        calibration: id that the model carries; None for a nominal one.
    """

    def __init__(
        self,
        core: StandUpBatch,
        pool: Pool,
        seed: int,
        curriculum: Curriculum | None = None,
        calibration: str | None = None,
    ) -> None:
        self.core, self.pool, self.calibration_id = core, pool, calibration
        self.curriculum = curriculum or Curriculum()
        self.chosen = np.zeros(core.count, dtype=np.int64)
        self.seed(seed)

    def seed(self, seed: int) -> None:
        """Restart the choice of starts."""
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, place)))
            for place in range(self.core.count)
        ]

    def begin(self) -> Observation:
        """Start an episode of every robot: what they see, shape (count, 22)."""
        for place in range(self.core.count):
            self._restart(place)
        self.core.batch.look()
        return self.core.batch.observation.copy()

    def step(self, actions: np.ndarray) -> Step:
        """Apply one action each in [-1, 1], shape (count, n), and restart the episodes that end."""
        before = self.core.batch.now
        out = self.core.step(actions)
        reward = np.where(out.diverged, 0.0, self.curriculum.reward(self.core, before, out))
        over = out.terminated | out.truncated
        for place in np.flatnonzero(over):
            self._restart(int(place))
        seen = out.observation
        if over.any():
            self.core.batch.look()
            seen = np.where(over[:, None], self.core.batch.observation, seen)
        return Step(out, reward, over, seen)

    def _restart(self, place: int) -> None:
        self.chosen[place] = self.curriculum.choose(self._rngs[place], self.pool)
        self.core.begin(place, self.pool.starts[self.chosen[place]], look=False)

    def snapshot(self) -> Arrays:
        """All robots as they are and all chance to come, for a checkpoint; their models come from the pool."""
        return {
            "chosen": self.chosen.copy(),
            "random": state_of(self._rngs),
            **nested("core", self.core.snapshot()),
            **nested("curriculum", self.curriculum.snapshot()),
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> Observation:
        """The other way round, on robots of the same pool: what they see, shape (count, 22).

        Raises:
            KeyError: something is missing.
            ValueError: it is of other robots.
        """
        chosen = kept["chosen"]
        if chosen.shape != self.chosen.shape or not ((chosen >= 0) & (chosen < len(self.pool))).all():
            raise ValueError(f"starts {chosen.shape} of another pool: expected {self.chosen.shape} of {len(self.pool)}")
        self.chosen[:] = chosen
        for place in range(self.core.count):
            self.core.begin(place, self.pool.starts[self.chosen[place]], look=False)
        self.core.restore(part("core", kept))
        self.curriculum.restore(part("curriculum", kept))
        set_states(self._rngs, kept["random"])
        return self.core.batch.observation.copy()

    def close(self) -> None:
        """End the threads."""
        self.core.close()


def make_episodes(
    model: Path | str,
    task: Task,
    count: int,
    *,
    randomize: bool = True,
    pool: int = 512,
    seed: int = 0,
    threads: int | None = None,
    keep: bool = True,
    tell: Callable[[float], None] = lambda _: None,
    curriculum: Curriculum | None = None,
) -> Episodes:
    """Episodes of a model file; a calibrated one brings its ranges along.

    Args:
        model: a model file.
        task: poses, rates, rewards, ranges.
        count: of robots.
        randomize: False keeps the model as it is in its file.
        pool: starts to choose from, each with a robot of its own.
        seed: of the pool and of the choices.
        threads: None for one a core.
        keep: keep the pool in the cache folder.
        tell: called with the share done while the pool is made.
        curriculum: None for the task as it is.

    Raises:
        ModelError: the file is missing or broken, or lacks a joint or sensor.
        CalibrationError: the model is calibrated and its ranges are missing or belong to another.
    """
    compiled = build_model(Path(model), task)
    calibration = load_calibration(Path(model))
    maker = StartMaker(compiled, task, calibration, randomize=randomize)
    starts = Pool(maker, calibration, pool, seed, cache_folder() if keep else None, tell)
    core = StandUpBatch(compiled, task, count, threads)
    return Episodes(core, starts, seed, curriculum, calibration_id(compiled))

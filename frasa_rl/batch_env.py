"""The stand-up task with its rewards and ends, for many robots; what both environments are made of."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_rl import reward
from frasa_rl.batch import Batch
from frasa_rl.compat2024 import EXTRA_STEPS
from frasa_rl.config import Task
from frasa_rl.observation import Observation
from frasa_rl.poses import trunk_heights
from frasa_rl.robot import Floats
from frasa_rl.simulation import Start
from frasa_rl.snapshots import Arrays, nested, part, put_back, taken
from frasa_rl.support import Support

Flags = npt.NDArray[np.bool_]
_KEPT = ("_last", "_steps", "_standing")


@dataclass(frozen=True)
class Outcome:
    """What a step of all robots brought.

    Attributes:
        observation: shape (count, 22); of a robot that diverged, the one before.
        reward: shape (count,).
        terms: of the reward by name, shape (6, count), in the order of `reward.TERMS`; the paper's first.
        terminated: fallen, too fast or diverged, shape (count,).
        truncated: time is up, shape (count,).
        success: standing for long enough, shape (count,).
        diverged: shape (count,).
    """

    observation: Observation
    reward: Floats
    terms: Floats
    terminated: Flags
    truncated: Flags
    success: Flags
    diverged: Flags


class StandUpBatch:
    """Episodes of many robots. Nothing restarts by itself: `begin` the ones that ended.

    Attributes:
        batch: the robots.
        divergences: episodes that ended because the simulation blew up.
        drawn: what was randomized in each robot.

    Args:
        model: of the task (`build_model`).
        task: what is rewarded, when an episode ends.
        count: of robots.
        threads: None for one a core.
    """

    def __init__(self, model: mujoco.MjModel, task: Task, count: int, threads: int | None = None) -> None:
        self.task, self.count = task, count
        self.batch = Batch(model, task, count, threads)
        self.divergences = 0
        self.drawn: list[dict[str, float]] = [{} for _ in range(count)]
        n = len(task.joints)
        self._last = np.zeros((count, n))
        self._floor, standing = trunk_heights(model, self.batch.robot, task)
        self._standing_height = standing - self._floor
        self._support = Support(model, self.batch.robot, task) if task.reward.gathering else None
        self._steps = np.zeros(count, dtype=np.int64)
        self._standing = np.zeros(count, dtype=np.int64)
        longest = round(task.episode_s / task.control_period_s)
        self._longest = longest + EXTRA_STEPS if task.compat else longest

    def begin(self, index: int, start: Start, *, look: bool = True) -> None:
        """Start an episode of one robot; with `look` off, `batch.look()` before the next step."""
        self.batch.put(index, start, look=look)
        self.batch.fastest[index] = min(1.0, start.drawn.get("time_ratio", 1.0))
        self.drawn[index] = start.drawn
        self._last[index] = 0.0
        self._steps[index] = self._standing[index] = 0

    def step(self, actions: npt.ArrayLike) -> Outcome:
        """Apply one action each, for a control period.

        Args:
            actions: joint rates as a share of the rate limit, clipped to [-1, 1], shape (count, 5).

        Raises:
            ValueError: another shape, or numbers that are not finite.
        """
        wanted = np.asarray(actions, dtype=np.float64)
        if wanted.shape != self._last.shape or not np.isfinite(wanted).all():
            robots, n = self._last.shape
            raise ValueError(
                f"actions of shape {wanted.shape}: expected {n} finite numbers for each of {robots} robots"
            )
        before, previous = self.batch.observation, self._last
        self._last = np.clip(wanted, -1.0, 1.0)
        self._steps += 1
        self.batch.act(self._last)
        diverged = self.batch.sim.diverged.copy()
        self.divergences += int(diverged.sum())
        errors = self.batch.errors()
        terms = np.where(diverged, 0.0, self._terms(errors, previous))
        near = np.degrees(np.abs(errors)).max(axis=1) < self.task.success_deg
        self._standing = np.where(near & ~diverged, self._standing + 1, 0)
        held_s = (self._standing - 1) * self.task.control_period_s
        terminated = self._over() | diverged
        seen = np.where(diverged[:, None], before, self.batch.observation)
        return Outcome(
            observation=seen,
            reward=terms.sum(axis=0),
            terms=terms,
            terminated=terminated,
            truncated=(self._steps >= self._longest) & ~terminated,
            success=held_s >= self.task.success_hold_s - 1e-9,
            diverged=diverged,
        )

    def _terms(self, errors: Floats, previous: Floats) -> Floats:
        weights, limit = self.task.reward, self.task.rate_limit
        high = reward.height_share(self.batch.now.height - self._floor, self._standing_height)
        upright = reward.upright_share(errors[:, -1])
        return np.stack(
            [
                reward.posture(weights, errors),
                reward.action(weights, self._last * limit),
                reward.variation(weights, self._last * limit, previous * limit),
                reward.self_contact(weights, self.batch.now.contact),
                self._gathering(errors[:, -1]),
                reward.approach(weights, high, upright, errors, self._last),
            ]
        )

    def _gathering(self, pitch_error: Floats) -> Floats:
        if self._support is None:
            return np.zeros(self.count)
        numbers, of = self.batch.now.support, self._support
        return reward.gathering(self.task.reward, of.above(numbers) / of.standing, of.flat(numbers), pitch_error)

    def _over(self) -> Flags:
        """Fallen beyond the pitch limit, or turning too fast, tested at the end of a control period."""
        now = self.batch.now
        fallen = np.abs(np.degrees(now.pitch)) > self.task.end_pitch_deg
        return np.asarray(fallen | (np.abs(now.turning[:, 1]) > self.task.end_gyro))

    def snapshot(self) -> Arrays:
        """All episodes as they are, for a checkpoint; which starts they had is not part of it."""
        return {
            **taken(self, _KEPT),
            "divergences": np.array(self.divergences),
            **nested("batch", self.batch.snapshot()),
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round, after every robot's episode was begun from its start."""
        put_back(self, _KEPT, kept)
        self.divergences = int(kept["divergences"])
        self.batch.restore(part("batch", kept))

    def close(self) -> None:
        """End the threads."""
        self.batch.close()

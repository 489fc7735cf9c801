"""Steps all robots with the policy as it explores, and writes down what they did: arrays only, nothing a robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from frasa_rl.actor import ActorLayers, Noise, uniform
from frasa_rl.episodes import Episodes
from frasa_rl.replay import Transitions
from frasa_rl.reward import PAPER_TERMS
from frasa_rl.snapshots import Arrays, nested, part, put_back, taken

_KEPT = ("_fresh", "_returned", "_lasted")


@dataclass(frozen=True)
class Round:
    """What a round of collecting brought.

    Attributes:
        transitions: of all robots.
        returned: sum of the paper's rewards of the episodes that ended, in order, shape (episodes,); what a curriculum
            or a preset pays beyond them is not in it, so that runs can be compared.
        lasted: their steps, shape (episodes,).
        success: which ended standing, shape (episodes,).
        posture: mean of the task's posture term.
        diverged: episodes that ended because the simulation blew up.
    """

    transitions: Transitions
    returned: npt.NDArray[np.float64]
    lasted: npt.NDArray[np.int64]
    success: npt.NDArray[np.bool_]
    posture: float
    diverged: int


class Collector:
    """Robots that act and are watched; episodes go on from round to round.

    Args:
        episodes: nobody else's.
        correlation: of the exploration noise between two steps.
        seed: of that noise.
    """

    def __init__(self, episodes: Episodes, correlation: float, seed: int) -> None:
        self.episodes = episodes
        count, joints = episodes.core.count, len(episodes.core.task.joints)
        self._noise = Noise(count, joints, correlation, seed)
        self._seen = episodes.begin()
        self._fresh = np.ones(count, dtype=bool)
        self._returned, self._lasted = np.zeros(count), np.zeros(count, dtype=np.int64)

    def collect(self, actor: ActorLayers | None, steps: int) -> Round:
        """Step all robots; without an actor their actions are random."""
        core = self.episodes.core
        count, joints, observed = core.count, len(core.task.joints), self._seen.shape[1]
        new = Transitions(
            *(np.empty((steps, count, width), dtype=np.float32) for width in (observed, observed, joints)),
            *(np.empty((steps, count), dtype=np.float32) for _ in range(3)),
        )
        ended: list[tuple[npt.NDArray[Any], ...]] = []
        posture, before = 0.0, core.divergences
        for row in range(steps):
            noise = self._noise.next(self._fresh)
            action = uniform(noise) if actor is None else actor.act(self._seen, noise)
            step = self.episodes.step(action)
            new.observations[row], new.actions[row] = self._seen, action
            new.next_observations[row], new.rewards[row] = step.out.observation, step.reward
            new.dones[row], new.lasts[row] = step.out.terminated, step.over
            self._returned += step.out.terms[: len(PAPER_TERMS)].sum(axis=0)
            self._lasted += 1
            posture += float(step.out.terms[0].mean()) / steps
            if step.over.any():
                ended.append((self._returned[step.over], self._lasted[step.over], step.out.success[step.over]))
                self._returned[step.over] = self._lasted[step.over] = 0
            self._seen, self._fresh = step.following, step.over
        empty = (np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool))
        returned, lasted, success = (np.concatenate(each) for each in zip(empty, *ended, strict=True))
        return Round(new, returned, lasted, success, posture, core.divergences - before)

    def snapshot(self) -> Arrays:
        """All robots, the noise, and the episodes' sums so far, for a checkpoint."""
        return {
            **taken(self, _KEPT),
            **nested("noise", self._noise.snapshot()),
            **nested("episodes", self.episodes.snapshot()),
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        self._fresh = self._fresh.copy()
        put_back(self, _KEPT, kept)
        self._noise.restore(part("noise", kept))
        self._seen = self.episodes.restore(part("episodes", kept))

"""What changes while a run learns: where episodes start, and what they are rewarded for. By default nothing does."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.random import Generator

from frasa_rl.batch_env import Flags, Outcome, StandUpBatch
from frasa_rl.pool import Pool
from frasa_rl.readings import Truth
from frasa_rl.robot import Floats
from frasa_rl.snapshots import Arrays


class Curriculum:
    """The task as it is: starts with the shares they have in the pool, its own reward. Others override methods.

    All that a method changes must be in `snapshot`, or a resumed run is another one.
    """

    def choose(self, rng: Generator, pool: Pool) -> int:
        """Which start of a pool the next episode has; `pool.of_kind` says which are of a kind."""
        return int(rng.integers(len(pool)))

    def reward(self, core: StandUpBatch, before: Truth, out: Outcome) -> Floats:
        """What a step of all robots earns, shape (count,).

        Args:
            core: the robots after the step, none restarted: `core.batch.now` is the truth, `core.batch.errors()` how
                far they are from the standing pose. Of those that diverged no number may be finite; they earn nothing.
            before: the truth before the step.
            out: what the step brought; its `terms` are the task's.
        """
        return out.reward

    def note(self, steps: int, success: Flags) -> None:
        """A round is over.

        Args:
            steps: transitions of the run so far.
            success: of the episodes that ended in this round, in order.
        """

    def snapshot(self) -> Arrays:
        """All that changes, for a checkpoint."""
        return {}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""


class Shares(Curriculum):
    """Starts of three kinds with given shares, whatever shares the pool has; may be written to between rounds.

    Attributes:
        shares: of starts near the standing pose, still falling, and lying; not negative, shape (3,).
    """

    KINDS = ("target", "falling", "random")

    def __init__(self, near: float, falling: float, lying: float) -> None:
        self.shares = np.array([near, falling, lying])

    def choose(self, rng: Generator, pool: Pool) -> int:
        """A kind by the shares of those that the pool has, then any start of it."""
        kinds = [pool.of_kind(kind) for kind in self.KINDS]
        edges = np.cumsum([share * bool(one.size) for share, one in zip(self.shares, kinds, strict=True)])
        if edges[-1] <= 0.0:
            return super().choose(rng, pool)
        chosen = kinds[int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))]
        return int(chosen[rng.integers(chosen.size)])

    def snapshot(self) -> Arrays:
        """The shares."""
        return {"shares": self.shares.copy()}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        self.shares[:] = kept["shares"]

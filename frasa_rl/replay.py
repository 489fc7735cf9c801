"""What robots did, kept in a ring; batches are drawn from it many at once, rewards summed over n steps as they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from frasa_rl.batches import Array, Batches
from frasa_rl.snapshots import Arrays, set_states, state_of
from frasa_sysid.calibration import UsageError

Ints = npt.NDArray[np.int64]
_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "lasts")


@dataclass(frozen=True)
class Transitions:
    """Steps of all robots, one after the other.

    Attributes:
        observations: before, shape (steps, robots, observed).
        next_observations: after; of an episode that ends, its last one, shape (steps, robots, observed).
        actions: taken, in [-1, 1], shape (steps, robots, n).
        rewards: shape (steps, robots).
        dones: 1 where the episode ended by itself, shape (steps, robots).
        lasts: 1 where it ended in any way, a time limit among them, shape (steps, robots).
    """

    observations: Array
    next_observations: Array
    actions: Array
    rewards: Array
    dones: Array
    lasts: Array


class Replay:
    """A ring of transitions.

    Attributes:
        filled: steps of every robot that are held.

    Args:
        capacity: transitions kept, of all robots together.
        robots: side by side.
        observed: numbers of an observation.
        actions: numbers of an action.
        n_step: rewards summed before the value is asked for.
        discount: of a step.
        seed: of the batches and their noise.

    Raises:
        UsageError: the ring does not hold a step of all robots.
    """

    def __init__(
        self, capacity: int, robots: int, observed: int, actions: int, *, n_step: int, discount: float, seed: int
    ) -> None:
        self._rows = capacity // robots
        if self._rows < n_step:
            raise UsageError(f"a buffer of {capacity} transitions does not hold {n_step} steps of {robots} robots")
        self._n_step, self._discount, self._robots = n_step, discount, robots
        widths = {"observations": observed, "next_observations": observed, "actions": actions}
        for name in _FIELDS:
            shape = (self._rows, robots, widths[name]) if name in widths else (self._rows, robots)
            setattr(self, f"_{name}", np.zeros(shape, dtype=np.float32))
        self._next = 0  # the row that is written next
        self.filled = 0
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))

    def __len__(self) -> int:
        return self.filled * self._robots

    def add(self, new: Transitions) -> None:
        """Append steps, the oldest first; they replace the oldest ones when the ring is full."""
        count = len(new.rewards)
        rows = (self._next + np.arange(count)) % self._rows
        kept = slice(max(0, count - self._rows), count)  # of more than fit, the newest
        for name in _FIELDS:
            self._of(name)[rows[kept]] = getattr(new, name)[kept]
        self._next = (self._next + count) % self._rows
        self.filled = min(self._rows, self.filled + count)

    def draw(self, many: int, size: int) -> Batches:
        """Batches of transitions, each as likely as any other, and the noise that goes with them.

        Sums of rewards stop where an episode ends, and at the newest step, after which there is nothing yet: then
        the value that follows is discounted by as many steps as were summed.

        Args:
            many: batches.
            size: of each.
        """
        picked = self._rng.integers(len(self), size=many * size)
        oldest = self._next - self.filled
        age, robot = picked // self._robots, picked % self._robots  # rows since the oldest
        flat = ((oldest + age) % self._rows) * self._robots + robot
        rewards, last, steps = self._sums(flat, age)
        discounts = (self._discount ** np.arange(self._n_step + 1)).astype(np.float32)
        shape = (many, size)

        def taken(name: str, where: Ints) -> Array:
            values = self._of(name).reshape(self._rows * self._robots, -1)
            return np.take(values, where, axis=0).reshape(*shape, -1)

        actions = taken("actions", flat)
        return Batches(
            observations=taken("observations", flat),
            actions=actions,
            next_observations=taken("next_observations", last),
            rewards=rewards.reshape(shape),
            dones=taken("dones", last)[..., 0],
            discounts=discounts[steps].reshape(shape),
            next_noise=self._rng.standard_normal(actions.shape, dtype=np.float32),
            noise=self._rng.standard_normal(actions.shape, dtype=np.float32),
        )

    def _sums(self, flat: Ints, age: Ints) -> tuple[Array, Ints, Ints]:
        """Discounted rewards, where the last step summed is, and how many were, shape (batch,) each."""
        paid, ends = self._rewards.reshape(-1), self._lasts.reshape(-1)
        total, last, steps = paid[flat], flat.copy(), np.ones(flat.size, dtype=np.int64)
        going = np.arange(flat.size)
        for step in range(1, self._n_step):
            going = going[(ends[last[going]] == 0.0) & (age[going] + step < self.filled)]
            last[going] = (last[going] + self._robots) % ends.size
            total[going] += np.float32(self._discount**step) * paid[last[going]]
            steps[going] += 1
        return total, last, steps

    def _of(self, name: str) -> Array:
        array: Array = getattr(self, f"_{name}")
        return array

    def snapshot(self) -> Arrays:
        """The filled part, where it is written next, and the generator, for a checkpoint. No copy of the data."""
        place = {"place": np.array([self._next, self.filled]), "random": state_of([self._rng])}
        return {**{name: self._of(name)[: self.filled] for name in _FIELDS}, **place}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round.

        Raises:
            KeyError: something is missing.
            ValueError: it is of another ring.
        """
        following, filled = (int(one) for one in kept["place"])
        if not (following == filled < self._rows or (filled == self._rows and 0 <= following < self._rows)):
            raise ValueError(f"{filled} steps in a ring of {self._rows}")
        for name in _FIELDS:
            mine, value = self._of(name), kept[name]
            if value.shape != (filled, *mine.shape[1:]) or value.dtype != mine.dtype:
                raise ValueError(f"{name} is {value.dtype} of shape {value.shape}: another buffer")
            mine[:filled] = value
        self._next, self.filled = following, filled
        set_states([self._rng], kept["random"])

    _rewards: Array
    _lasts: Array

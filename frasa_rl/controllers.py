"""Whatever tells the robots what to do in an evaluation: a policy, keyframes, nothing."""

from typing import Protocol

import numpy as np

from frasa_rl.config import Task
from frasa_rl.observation import Observation
from frasa_rl.policy import Array, Policy


class Controller(Protocol):
    """Turns what robots see into rates for them."""

    @property
    def name(self) -> str:
        """What tables call it."""

    def start(self, count: int, period_s: float) -> None:
        """Forget everything: `count` robots begin, and a decision is asked for every `period_s` [s]."""

    def act(self, observation: Observation) -> Array:
        """Rates in [-1, 1] of the rate limit, shape (count, n), from observations, shape (count, 22)."""


class Nothing:
    """Every command stays where it is."""

    name = "nothing"

    def __init__(self, task: Task) -> None:
        self._n = len(task.joints)

    def start(self, count: int, period_s: float) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> Array:
        """Zeros, shape (count, n)."""
        return np.zeros((len(observation), self._n), dtype=np.float32)


class PolicyController:
    """A trained policy; it sees only the present, so that any rate of decisions suits it."""

    def __init__(self, policy: Policy, name: str) -> None:
        self._policy, self.name = policy, name

    def start(self, count: int, period_s: float) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> Array:
        """The policy's actions, shape (count, n).

        Robot by robot: a product of matrices rounds differently for other numbers of rows, and a
        trial shall not depend on how many others there are.
        """
        return np.stack([self._policy.act(one) for one in observation])

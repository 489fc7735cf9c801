"""The policy as it explores: linear layers with numpy, noise of its own, white or correlated in time."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from frasa_rl.policy import Array, Policy
from frasa_rl.snapshots import Arrays, put_back, set_states, state_of, taken

Layer = tuple[Array, Array]
_LOG_STD = (-20.0, 2.0)  # between which SAC and CrossQ keep it


@dataclass(frozen=True)
class ActorLayers:
    """An actor with all normalisation folded in: a Gaussian before a hyperbolic tangent.

    Attributes:
        hidden: weights (out, in) and biases (out,), a rectifier after each.
        mean: of the Gaussian.
        log_std: logarithm of its standard deviation, before it is limited.
    """

    hidden: tuple[Layer, ...]
    mean: Layer
    log_std: Layer

    def act(self, observations: Array, noise: npt.NDArray[np.float64]) -> Array:
        """Actions in [-1, 1], shape (robots, n), from standard normal noise of that shape."""
        values = observations
        for weight, bias in self.hidden:
            values = np.maximum(values @ weight.T + bias, 0.0)
        mean, log_std = (values @ weight.T + bias for weight, bias in (self.mean, self.log_std))
        action: Array = np.tanh(mean + np.exp(np.clip(log_std, *_LOG_STD)) * noise.astype(np.float32))
        return action

    def policy(self, run: dict[str, Any]) -> Policy:
        """The mean action alone, as it is published."""
        return Policy((*self.hidden, self.mean), run)


class Average:
    """The mean of an actor's weights over its last updates, the newest counting most: the policy that is published.

    An actor that learns fast leans now forward, now backward by some degrees, as often as it is asked; its mean does
    not (Polyak averaging, https://doi.org/10.1137/0330046).

    Args:
        updates: over which the mean is taken; 0 for none.
    """

    def __init__(self, updates: int) -> None:
        self._updates = updates
        self._numbers: list[npt.NDArray[np.float64]] = []

    def follow(self, actor: ActorLayers, updates: int) -> None:
        """The actor after so many more updates."""
        newest = [one.astype(np.float64) for layer in (*actor.hidden, actor.mean) for one in layer]
        share = 1.0 - np.exp(-updates / self._updates) if self._updates and self._numbers else 1.0
        before = self._numbers or newest
        self._numbers = [old + share * (new - old) for old, new in zip(before, newest, strict=True)]

    def policy(self, run: dict[str, Any]) -> Policy:
        """The mean, as it is published."""
        weights = [one.astype(np.float32) for one in self._numbers]
        return Policy(tuple(zip(weights[::2], weights[1::2], strict=True)), run)

    def snapshot(self) -> Arrays:
        """For a checkpoint."""
        return {str(place): one.copy() for place, one in enumerate(self._numbers)}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        self._numbers = [kept[str(place)].copy() for place in range(len(kept))]


class Noise:
    """Standard normal numbers for every robot and joint; each step keeps a share of the one before.

    With correlation r, noise_k+1 = r noise_k + sqrt(1 - r^2) eps: normal at every step, and as slow as servos are.
    Sums of white noise hardly move a robot; an episode begins with fresh numbers.

    Args:
        robots: side by side.
        joints: numbers of an action.
        correlation: r between two steps, in [0, 1).
        seed: of all of it.
    """

    def __init__(self, robots: int, joints: int, correlation: float, seed: int) -> None:
        self._share = correlation
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
        self._now = self._rng.standard_normal((robots, joints))

    def next(self, fresh: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """The noise of a step, shape (robots, joints); `fresh` says whose episode begins, shape (robots,)."""
        drawn = self._rng.standard_normal(self._now.shape)
        slow = self._share * self._now + np.sqrt(1.0 - self._share**2) * drawn
        self._now = np.where(fresh[:, None], drawn, slow)
        return self._now

    def snapshot(self) -> Arrays:
        """For a checkpoint."""
        return {**taken(self, ("_now",)), "random": state_of([self._rng])}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        put_back(self, ("_now",), kept)
        set_states([self._rng], kept["random"])


def uniform(noise: npt.NDArray[np.float64]) -> Array:
    """Actions that are uniform in [-1, 1], as correlated in time as the normal noise they are made of."""
    actions: Array = (2.0 * ndtr(noise) - 1.0).astype(np.float32)
    return actions

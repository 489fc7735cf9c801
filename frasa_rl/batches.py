"""What the learner is given for a round: all batches and all random numbers at once, as plain arrays."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Batches:
    """Transitions for K updates of B each, and the noise of the policy's own actions in them.

    Attributes:
        observations: before, shape (K, B, observed).
        actions: taken, in [-1, 1], shape (K, B, n).
        next_observations: n steps later, shape (K, B, observed).
        rewards: discounted sum of n steps, shape (K, B).
        dones: 1 where the episode ended by itself (not by a time limit), shape (K, B).
        discounts: of the value that follows, gamma to the power of the steps summed, shape (K, B).
        next_noise: standard normal numbers that draw the next actions, shape (K, B, n).
        noise: those of the policy's own update, shape (K, B, n); read where the policy is updated only.
    """

    observations: Array
    actions: Array
    next_observations: Array
    rewards: Array
    dones: Array
    discounts: Array
    next_noise: Array
    noise: Array

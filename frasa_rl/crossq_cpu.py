"""K updates of CrossQ in one compiled call on one core, without Python and without the interpreter's lock.

CrossQ (Bhatt et al. 2024) in the order of sb3-contrib's `train`: both critics on (s, a) and (s', a') in one batch, so
that batch statistics are of both; no target networks; every few updates the entropy coefficient and the policy.
The same batches give the same bits, in any thread, on processors with registers of one width.
"""

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from frasa_rl.crossq_adam import adam, learn
from frasa_rl.crossq_back import backward
from frasa_rl.crossq_input import center_input, measure_input, put
from frasa_rl.crossq_layers import forward, refold
from frasa_rl.crossq_net import BATCH_MEAN, Net
from frasa_rl.crossq_passes import clear
from frasa_rl.crossq_squash import Room, actor_slopes, draw
from frasa_rl.crossq_tiles import padded_rows
from frasa_rl.crossq_vectors import Array, entry, inlined, line

CRITIC_LOSS, ACTOR_LOSS, ENTROPY, ENTROPY_LOSS = range(4)  # columns of what `updates` writes
_OBSERVATIONS, _ACTIONS, _FOLLOWING, _REWARDS, _DONES, _DISCOUNTS, _NEXT_NOISE, _NOISE = range(8)
Data = tuple[Array, Array, Array, Array, Array, Array, Array, Array]  # of `Batches`, in its order
Entropy = tuple[Array, Array, Array, Array]
Numbers = npt.NDArray[np.float64]


class Rules(NamedTuple):
    """What stays the same in a call.

    Attributes:
        delay: critic updates to one of the policy.
        target_entropy: of the entropy coefficient.
        tuned: whether the entropy coefficient learns.
        fixed: entropy coefficient where it does not.
        actor_norm, critic_norm: see `crossq_norm.normalise`.
        actor_adam, critic_adam, entropy_adam: see `crossq_adam.adam`.
    """

    delay: int
    target_entropy: float
    tuned: bool
    fixed: float
    actor_norm: Array
    critic_norm: Array
    actor_adam: Numbers
    critic_adam: Numbers
    entropy_adam: Numbers


@inlined
def _judge_pairs(actor: Net, critic: Net, k: int, data: Data, rules: Rules, room: Room) -> None:
    """The critics' output for (s, a), then (s', a') with a' drawn from the policy, in training."""
    observations, following = data[_OBSERVATIONS][k], data[_FOLLOWING][k]
    batch, seen = observations.shape
    rows, center = padded_rows(batch), line(actor.mean, 0, 0)
    put(actor, rows, 0, 0, following)
    center_input(actor, rows, batch, center)
    forward(actor, 0, rows, batch, False, center, rules.actor_norm)
    draw(actor, rows, data[_NEXT_NOISE][k], room)
    rows, both, center = padded_rows(2 * batch), 2 * batch, line(critic.norm, BATCH_MEAN, 0)
    put(critic, rows, 0, 0, observations)
    put(critic, rows, 0, seen, data[_ACTIONS][k])
    put(critic, rows, batch, 0, following)
    put(critic, rows, batch, seen, room.actions)
    measure_input(critic, rows, both)
    center_input(critic, rows, both, center)
    for c in range(len(critic.values)):
        forward(critic, c, rows, both, True, center, rules.critic_norm)


@inlined
def _critic_loss(critic: Net, k: int, data: Data, alpha: float, room: Room) -> float:
    """Half the squared errors' mean, summed over critics; its gradient is left in `result`."""
    q, loss = critic.result, 0.0
    rewards, dones, discounts = data[_REWARDS], data[_DONES], data[_DISCOUNTS]
    batch = rewards.shape[1]
    for n in range(batch):
        least = q[0, batch + n]
        for c in range(1, len(q)):
            least = min(least, q[c, batch + n])
        value = float(least) - alpha * room.log_probability[n]
        room.target[n] = rewards[k, n] + (1.0 - dones[k, n]) * discounts[k, n] * value
    for c in range(len(q)):
        for n in range(batch):
            error = q[c, n] - room.target[n]
            loss += 0.5 * error * error / batch
            q[c, n] = error / batch
        clear(line(q, c, 0), batch, 2 * batch)
    return loss


@inlined
def _learn_critic(actor: Net, critic: Net, k: int, data: Data, alpha: float, rules: Rules, room: Room) -> float:
    """Gradients of the critics; returns their loss."""
    _judge_pairs(actor, critic, k, data, rules, room)
    loss = _critic_loss(critic, k, data, alpha, room)
    both = 2 * data[_REWARDS].shape[1]
    for c in range(len(critic.values)):
        backward(critic, c, padded_rows(both), both, True, False, room.scratch)
    return loss


@inlined
def _judge(critic: Net, observations: Array, rules: Rules, room: Room) -> float:
    """The critics' least value of the policy's actions; leaves minus its mean's gradient in their input."""
    batch, seen = observations.shape
    rows, total, center = padded_rows(batch), 0.0, line(critic.mean, 0, 0)
    put(critic, rows, 0, 0, observations)
    put(critic, rows, 0, seen, room.actions)
    center_input(critic, rows, batch, center)
    q = critic.result
    for c in range(len(q)):
        refold(critic, c, center, rules.critic_norm)
        forward(critic, c, rows, batch, False, center, rules.critic_norm)
    for n in range(batch):
        least = 0
        for c in range(1, len(q)):
            least = c if q[c, n] < q[least, n] else least
        total += q[least, n]
        for c in range(len(q)):
            q[c, n] = -1.0 / batch if c == least else 0.0
    for c in range(len(q)):
        backward(critic, c, rows, batch, False, True, room.scratch)
    return float(total / batch)


@inlined
def _learn_actor(
    actor: Net, critic: Net, k: int, data: Data, alpha: float, rules: Rules, room: Room
) -> tuple[float, float]:
    """Gradients of the policy; returns its loss and the mean log probability of its actions."""
    observations = data[_OBSERVATIONS][k]
    batch, seen = observations.shape
    rows, center = padded_rows(batch), line(actor.norm, BATCH_MEAN, 0)
    put(actor, rows, 0, 0, observations)
    measure_input(actor, rows, batch)
    center_input(actor, rows, batch, center)
    forward(actor, 0, rows, batch, True, center, rules.actor_norm)
    draw(actor, rows, data[_NOISE][k], room)
    value, log_probability = _judge(critic, observations, rules, room), 0.0
    for n in range(batch):
        log_probability += room.log_probability[n] / batch
    actor_slopes(actor, critic, seen, alpha, room)
    backward(actor, 0, rows, batch, True, False, room.scratch)
    return alpha * log_probability - value, log_probability


@inlined
def _all_updates(
    actor: Net,
    critic: Net,
    entropy: Entropy,
    steps: Numbers,
    done: int,
    data: Data,
    rules: Rules,
    room: Room,
    losses: Numbers,
) -> None:
    """What `updates` does."""
    refold(actor, 0, line(actor.mean, 0, 0), rules.actor_norm)
    for k in range(len(losses)):
        alpha = math.exp(entropy[0][0]) if rules.tuned else rules.fixed
        losses[k, ENTROPY] = alpha
        losses[k, CRITIC_LOSS] = _learn_critic(actor, critic, k, data, alpha, rules, room)
        steps[1] += 1.0
        learn(critic, steps[1], rules.critic_adam)
        if (done + k + 1) % rules.delay != 0:
            continue
        losses[k, ACTOR_LOSS], log_probability = _learn_actor(actor, critic, k, data, alpha, rules, room)
        if rules.tuned:
            slope = -(log_probability + rules.target_entropy)
            losses[k, ENTROPY_LOSS] = entropy[0][0] * slope
            entropy[1][0] = slope
            steps[2] += 1.0
            adam(entropy[0], entropy[1], entropy[2], entropy[3], steps[2], rules.entropy_adam)
        steps[0] += 1.0
        learn(actor, steps[0], rules.actor_adam)
        refold(actor, 0, line(actor.mean, 0, 0), rules.actor_norm)


Updates = Callable[[Net, Net, Entropy, Numbers, int, Data, Rules, Room, Numbers], None]


def _entry(sources: str) -> Updates:
    """The call from Python, kept on disk for these sources: numba sees edits of this file, not of what it imports."""

    @entry
    def updates(
        actor: Net,
        critic: Net,
        entropy: Entropy,
        steps: Numbers,
        done: int,
        data: Data,
        rules: Rules,
        room: Room,
        losses: Numbers,
    ) -> None:
        """All updates that the arrays hold.

        Args:
            actor: the policy's network.
            critic: the critics'.
            entropy: logarithm of the coefficient, scratch for its gradient, its two moments, each of shape (1,).
            steps: steps that Adam has made of actor, critic and entropy coefficient.
            done: updates made before.
            data: what is learned from.
            rules: what stays the same.
            room: scratch.
            losses: written, shape (K, 4).
        """
        _ = sources  # numba's key of a function on disk holds what its closure holds
        _all_updates(actor, critic, entropy, steps, done, data, rules, room, losses)

    return updates


def _digest() -> str:
    """Of the sources of this folder's compiled functions."""
    files = sorted(Path(__file__).parent.glob("crossq_*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


updates = _entry(_digest())

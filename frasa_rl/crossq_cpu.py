"""K updates of CrossQ in one compiled call on one core, without Python and without the interpreter's lock."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from frasa_rl.crossq_adam import adam
from frasa_rl.crossq_back import ROOMS, backward
from frasa_rl.crossq_layers import forward, refold
from frasa_rl.crossq_net import BATCH_MEAN, BATCH_VAR, IN_PANELS, Net, aligned, padded
from frasa_rl.crossq_passes import clear, moved, statistics
from frasa_rl.crossq_rows import copy_columns
from frasa_rl.crossq_tiles import PANEL, ROWS, Array, compiled
from frasa_rl.crossq_vectors import line, not_inlined

CRITIC_LOSS, ACTOR_LOSS, ENTROPY, ENTROPY_LOSS = range(4)  # columns of what `updates` writes
_LOG_STD_MIN, _LOG_STD_MAX = -20.0, 2.0
_SQUASH_EPSILON = 1e-6  # of SB3's squashed Gaussian
_LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)


class Room(NamedTuple):
    """Scratch for batches of B.

    Attributes:
        actions: the policy's, shape (B, n).
        log_probability: theirs, shape (B,).
        slack: 1 - action^2, then what the sample adds to the mean, shape (2, B, n).
        target: of the critics, shape (B,).
        scratch: of `backward`, shape (ROOMS, ...).
        still: an array of zeros, the centre where nothing is subtracted.
    """

    actions: Array
    log_probability: Array
    spread: Array
    target: Array
    scratch: Array


class Rules(NamedTuple):
    """What stays the same in a call.

    Attributes:
        delay: critic updates to one of the policy.
        target_entropy: of the entropy coefficient.
        tuned: whether the entropy coefficient learns.
        actor_norm, critic_norm: epsilon, momentum and warm-up batches of batch renormalisation.
        actor_adam, critic_adam, entropy_adam: see `crossq_adam.adam`.
    """

    delay: int
    target_entropy: float
    tuned: bool
    actor_norm: Array
    critic_norm: Array
    actor_adam: npt.NDArray[np.float64]
    critic_adam: npt.NDArray[np.float64]
    entropy_adam: npt.NDArray[np.float64]


def room(batch: int, actions: int, widest: int, dtype: npt.DTypeLike) -> Room:
    """Scratch for batches of this size and layers of at most this width."""
    rows, most = padded(2 * batch, ROWS), padded(widest, PANEL)
    return Room(
        aligned((batch, actions), dtype),
        aligned((batch,), dtype),
        aligned((2, batch, actions), dtype),
        aligned((batch,), dtype),
        aligned((ROOMS, PANEL * max(rows, most)), dtype),
    )


@compiled
def _put(net: Net, rows: int, row: int, column: int, source: Array) -> None:
    """Write a matrix into the input panels, from this row and column on."""
    not_inlined()
    count = source.shape[1]
    for panel in range(column // PANEL, (column + count - 1) // PANEL + 1):
        first, last = max(column, panel * PANEL), min(column + count, (panel + 1) * PANEL)
        at = (panel * rows + row) * PANEL + first - panel * PANEL
        copy_columns(len(source), last - first, line(net.active, 0, at), 0, line(source, 0, first - column), 0, count)


@compiled
def _center(net: Net, rows: int, real: int, center: Array) -> None:
    """Subtract it from the input."""
    not_inlined()
    for panel in range(net.table[0, IN_PANELS]):
        moved(real, line(net.active, 0, panel * rows * PANEL), center[panel * PANEL :])


@compiled
def _measure(net: Net, rows: int, real: int) -> None:
    """Statistics of the input, for all networks."""
    not_inlined()
    count, norm = net.table[0, IN_PANELS] * PANEL, net.norm
    for k in range(0, count, PANEL):
        x = line(net.active, 0, k * rows)
        statistics(x, real, line(norm[0], BATCH_MEAN, k), line(norm[0], BATCH_VAR, k))
    for c in range(1, len(norm)):
        for k in range(count):
            norm[c, BATCH_MEAN, k], norm[c, BATCH_VAR, k] = norm[0, BATCH_MEAN, k], norm[0, BATCH_VAR, k]


@compiled
def _squash(actor: Net, rows: int, noise: Array, room: Room) -> None:
    """Draw actions from the actor's output, and their log probability, as SB3 computes it."""
    not_inlined()
    y, (batch, count) = actor.result[0], noise.shape
    for n in range(batch):
        total = 0.0
        for j in range(count):
            k = count + j
            mean = float(y[(j // PANEL) * rows * PANEL + n * PANEL + j % PANEL])
            raw = float(y[(k // PANEL) * rows * PANEL + n * PANEL + k % PANEL])
            log_std = min(max(raw, _LOG_STD_MIN), _LOG_STD_MAX)
            spread, draw = math.exp(log_std) * noise[n, j], noise[n, j]
            action = math.tanh(mean + spread)
            total -= 0.5 * draw * draw + log_std + _LOG_ROOT_TWO_PI + math.log(1.0 - action * action + _SQUASH_EPSILON)
            room.actions[n, j] = action
            room.spread[0, n, j] = spread
            room.spread[1, n, j] = 1.0 if log_std == raw else 0.0
        room.log_probability[n] = total


@compiled
def _critic_losses(
    critic: Net, batch: int, rewards: Array, dones: Array, discounts: Array, alpha: float, room: Room
) -> float:
    """Leave the gradient of the critics' loss in their `result`; return the loss."""
    not_inlined()
    q, loss = critic.result, 0.0
    for n in range(batch):
        after = q[0, batch + n]
        for c in range(1, len(q)):
            after = min(after, q[c, batch + n])
        value = float(after) - alpha * room.log_probability[n]
        room.target[n] = rewards[n] + (1.0 - dones[n]) * discounts[n] * value
    for c in range(len(q)):
        for n in range(batch):
            error = q[c, n] - room.target[n]
            loss += 0.5 * error * error / batch
            q[c, n] = error / batch
        clear(line(q, c, 0), batch, 2 * batch)
    return loss


@compiled
def _learn_critic(actor: Net, critic: Net, k: int, data: Any, alpha: float, rules: Rules, room: Room) -> float:  # noqa: ANN401
    observations, actions, following, rewards, dones, discounts, next_noise, _ = data
    batch, seen = observations.shape[1], observations.shape[2]
    rows = padded_rows(batch)
    center = line(actor.mean, 0, 0)
    _put(actor, rows, 0, 0, following[k])
    _center(actor, rows, batch, center)
    forward(actor, 0, rows, batch, False, center, rules.actor_norm)
    _squash(actor, rows, next_noise[k], room)
    rows, both = padded_rows(2 * batch), 2 * batch
    _put(critic, rows, 0, 0, observations[k])
    _put(critic, rows, 0, seen, actions[k])
    _put(critic, rows, batch, 0, following[k])
    _put(critic, rows, batch, seen, room.actions)
    _measure(critic, rows, both)
    center = line(critic.norm[0], BATCH_MEAN, 0)
    _center(critic, rows, both, center)
    for c in range(len(critic.values)):
        forward(critic, c, rows, both, True, center, rules.critic_norm)
    loss = _critic_losses(critic, batch, rewards[k], dones[k], discounts[k], alpha, room)
    for c in range(len(critic.values)):
        backward(critic, c, rows, both, True, False, room.scratch)
    return loss


@compiled
def padded_rows(size: int) -> int:
    """The next multiple of the rows of a tile."""
    return (size + ROWS - 1) // ROWS * ROWS


@compiled
def _judge(critic: Net, observations: Array, rules: Rules, room: Room) -> float:
    """The critics' least value of the policy's actions; leaves minus its gradient in the input. Returns the mean."""
    not_inlined()
    batch, seen = observations.shape
    rows, total = padded_rows(batch), 0.0
    center = line(critic.mean, 0, 0)
    _put(critic, rows, 0, 0, observations)
    _put(critic, rows, 0, seen, room.actions)
    _center(critic, rows, batch, center)
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
    return total / batch


@compiled
def _actor_slopes(actor: Net, critic: Net, seen: int, alpha: float, room: Room) -> None:
    """The gradient of the actor's loss in its output, from that of its actions in the critics' input."""
    not_inlined()
    batch, count = room.actions.shape
    rows = padded_rows(batch)
    y, x = actor.result[0], critic.active[0]
    clear(y, 0, y.size)
    for n in range(batch):
        for j in range(count):
            action, i, k = float(room.actions[n, j]), seen + j, count + j
            room_left = 1.0 - action * action
            slope = float(x[(i // PANEL) * rows * PANEL + n * PANEL + i % PANEL]) * room_left
            slope += alpha / batch * 2.0 * action * room_left / (room_left + _SQUASH_EPSILON)
            of_log_std = (slope * room.spread[0, n, j] - alpha / batch) * room.spread[1, n, j]
            y[(j // PANEL) * rows * PANEL + n * PANEL + j % PANEL] = slope
            y[(k // PANEL) * rows * PANEL + n * PANEL + k % PANEL] = of_log_std


@compiled
def _learn_actor(
    actor: Net, critic: Net, k: int, data: Any, alpha: float, rules: Rules, room: Room
) -> tuple[float, float]:
    not_inlined()
    observations, noise = data[0], data[7]
    batch, seen = observations.shape[1], observations.shape[2]
    rows = padded_rows(batch)
    _put(actor, rows, 0, 0, observations[k])
    _measure(actor, rows, batch)
    center = line(actor.norm[0], BATCH_MEAN, 0)
    _center(actor, rows, batch, center)
    forward(actor, 0, rows, batch, True, center, rules.actor_norm)
    _squash(actor, rows, noise[k], room)
    value = _judge(critic, observations[k], rules, room)
    log_probability = room.log_probability.sum() / batch
    _actor_slopes(actor, critic, seen, alpha, room)
    backward(actor, 0, rows, batch, True, False, room.scratch)
    return alpha * log_probability - value, log_probability


@compiled
def updates(
    actor: Net,
    critic: Net,
    entropy: tuple[Array, Array, Array, Array],
    steps: npt.NDArray[np.float64],
    done: int,
    data: Any,  # noqa: ANN401 - the eight arrays of `Batches`, in its order
    rules: Rules,
    room: Room,
    losses: npt.NDArray[np.float64],
) -> None:
    """All updates that the arrays hold.

    Args:
        entropy: logarithm of the coefficient, scratch for its gradient, its two moments, each of shape (1,).
        steps: steps that Adam has made of actor, critic and entropy coefficient.
        done: updates made before.
        losses: written, shape (K, 4).
    """
    not_inlined()
    refold(actor, 0, line(actor.mean, 0, 0), rules.actor_norm)
    for k in range(len(losses)):
        alpha = math.exp(entropy[0][0])
        losses[k, ENTROPY] = alpha
        losses[k, CRITIC_LOSS] = _learn_critic(actor, critic, k, data, alpha, rules, room)
        steps[1] += 1.0
        adam(
            critic.values.ravel(),
            critic.slopes.ravel(),
            critic.first.ravel(),
            critic.second.ravel(),
            steps[1],
            rules.critic_adam,
        )
        if (done + k + 1) % rules.delay != 0:
            continue
        loss, log_probability = _learn_actor(actor, critic, k, data, alpha, rules, room)
        losses[k, ACTOR_LOSS] = loss
        if rules.tuned:
            slope = -(log_probability + rules.target_entropy)
            losses[k, ENTROPY_LOSS] = entropy[0][0] * slope
            entropy[1][0] = slope
            steps[2] += 1.0
            adam(entropy[0], entropy[1], entropy[2], entropy[3], steps[2], rules.entropy_adam)
        steps[0] += 1.0
        adam(
            actor.values.ravel(),
            actor.slopes.ravel(),
            actor.first.ravel(),
            actor.second.ravel(),
            steps[0],
            rules.actor_adam,
        )
        refold(actor, 0, line(actor.mean, 0, 0), rules.actor_norm)

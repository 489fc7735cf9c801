"""The policy's squashed Gaussian: a draw, its log probability, and the way back to the actor's output."""

import math
from typing import NamedTuple

import numpy.typing as npt

from frasa_rl.crossq_back import ROOMS
from frasa_rl.crossq_net import Net, aligned, padded
from frasa_rl.crossq_passes import clear
from frasa_rl.crossq_tiles import ROWS, padded_rows
from frasa_rl.crossq_vectors import PANEL, Array, as_written, compiled, line, not_inlined
from frasa_sysid.calibration.fast_math import fast_exp2, fast_log2

_LOG_STD_MIN, _LOG_STD_MAX = -20.0, 2.0  # of sb3-contrib's actor
_EPSILON = 1e-6  # of SB3's squashed Gaussian
_LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)
_LN2, _LOG2_E = math.log(2.0), math.log2(math.e)
MEAN, LOG_STD, NOISE, SPREAD, LEFT, SAFE = range(6)  # rows of the room's draws


class Room(NamedTuple):
    """Scratch for batches of B.

    Attributes:
        actions: the policy's, shape (B, n).
        log_probability: theirs, shape (B,).
        draws: mean, log deviation, noise, what the noise added to the mean, 1 - action^2 without
            and with epsilon, shape (6, B n).
        target: of the critics, shape (B,).
        scratch: of `backward`, shape (ROOMS, ...).
    """

    actions: Array
    log_probability: Array
    draws: Array
    target: Array
    scratch: Array


def room(batch: int, actions: int, widest: int, dtype: npt.DTypeLike) -> Room:
    """Scratch for batches of this size and layers of at most this width."""
    most = max(padded(2 * batch, ROWS), padded(widest, PANEL))
    return Room(
        actions=aligned((batch, actions), dtype),
        log_probability=aligned((batch,), dtype),
        draws=aligned((6, batch * actions), float),
        target=aligned((batch,), dtype),
        scratch=aligned((ROOMS, PANEL * most), dtype),
    )


@compiled
def _place(rows: int, row: int, column: int) -> int:
    """Where an element of a matrix in panels lies."""
    return (column // PANEL) * rows * PANEL + row * PANEL + column % PANEL


@as_written
def _spread(log_std: Array, noise: Array, spread: Array) -> None:
    """What the noise adds to the mean. A loop over few arrays: the compiler turns those into vector instructions."""
    not_inlined()
    for i in range(len(spread)):
        spread[i] = fast_exp2(min(max(log_std[i], _LOG_STD_MIN), _LOG_STD_MAX) * _LOG2_E) * noise[i]


@as_written
def _squash(mean: Array, spread: Array, actions: Array) -> None:
    """The hyperbolic tangent."""
    not_inlined()
    for i in range(len(mean)):
        x = mean[i] + spread[i]
        e = fast_exp2(-2.0 * _LOG2_E * abs(x))
        actions[i] = math.copysign((1.0 - e) / (1.0 + e), x)


@as_written
def _left(actions: Array, left: Array, safe: Array) -> None:
    """1 - action^2, and with epsilon added, rounded where SB3 rounds: near the ends of actions that is much of it."""
    not_inlined()
    kind = actions.dtype.type
    one, epsilon = kind(1), kind(_EPSILON)
    for i in range(len(actions)):
        rest = one - actions[i] * actions[i]
        left[i], safe[i] = rest, rest + epsilon


@as_written
def _density(log_std: Array, safe: Array, noise: Array) -> None:
    """The log probability, in place of the noise."""
    not_inlined()
    for i in range(len(noise)):
        surely = min(max(log_std[i], _LOG_STD_MIN), _LOG_STD_MAX) + _LOG_ROOT_TWO_PI
        noise[i] = -0.5 * noise[i] * noise[i] - surely - _LN2 * fast_log2(safe[i])


@compiled
def draw(actor: Net, rows: int, noise: Array, room: Room) -> None:
    """Actions from the actor's output, and their log probability, as SB3 computes it."""
    not_inlined()
    y, (batch, count) = line(actor.result, 0, 0), noise.shape
    mean, log_std, drawn = line(room.draws, MEAN, 0), line(room.draws, LOG_STD, 0), line(room.draws, NOISE, 0)
    for n in range(batch):
        for j in range(count):
            mean[n * count + j], log_std[n * count + j] = y[_place(rows, n, j)], y[_place(rows, n, count + j)]
            drawn[n * count + j] = noise[n, j]
    spread, safe, actions = line(room.draws, SPREAD, 0), line(room.draws, SAFE, 0), room.actions.ravel()
    _spread(log_std, drawn, spread)
    _squash(mean, spread, actions)
    _left(actions, line(room.draws, LEFT, 0), safe)
    _density(log_std, safe, drawn)
    for n in range(batch):
        total = 0.0
        for j in range(count):
            total += drawn[n * count + j]
        room.log_probability[n] = total


@compiled
def actor_slopes(actor: Net, critic: Net, seen: int, alpha: float, room: Room) -> None:
    """The gradient of mean(alpha log probability - value) in the actor's output, left in `result`.

    That of minus the value in the actions lies in the critics' input, from column `seen` on.
    """
    not_inlined()
    batch, count = room.actions.shape
    rows = padded_rows(batch)
    y, x, share = line(actor.result, 0, 0), line(critic.active, 0, 0), alpha / batch
    clear(y, 0, y.size)
    for n in range(batch):
        for j in range(count):
            i = n * count + j
            log_std, of_log = room.draws[LOG_STD, i], share * 2.0 * room.actions[n, j] / room.draws[SAFE, i]
            slope = (float(x[_place(rows, n, seen + j)]) + of_log) * room.draws[LEFT, i]
            y[_place(rows, n, j)] = slope
            free = 1.0 if _LOG_STD_MIN <= log_std <= _LOG_STD_MAX else 0.0
            y[_place(rows, n, count + j)] = (slope * room.draws[SPREAD, i] - share) * free

"""The policy's squashed Gaussian: a draw, its log probability, and the way back to the actor's output."""

import math
from typing import NamedTuple

import numpy.typing as npt

from frasa_rl.crossq_back import ROOMS
from frasa_rl.crossq_net import Net, aligned, padded
from frasa_rl.crossq_passes import clear
from frasa_rl.crossq_tiles import ROWS
from frasa_rl.crossq_vectors import PANEL, Array, compiled, line, not_inlined

_LOG_STD_MIN, _LOG_STD_MAX = -20.0, 2.0  # of sb3-contrib's actor
_EPSILON = 1e-6  # of SB3's squashed Gaussian
_LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)


class Room(NamedTuple):
    """Scratch for batches of B.

    Attributes:
        actions: the policy's, shape (B, n).
        log_probability: theirs, shape (B,).
        spread: what the draw added to the mean, and 1 where its deviation was not clipped, shape (2, B, n).
        target: of the critics, shape (B,).
        scratch: of `backward`, shape (ROOMS, ...).
    """

    actions: Array
    log_probability: Array
    spread: Array
    target: Array
    scratch: Array


def room(batch: int, actions: int, widest: int, dtype: npt.DTypeLike) -> Room:
    """Scratch for batches of this size and layers of at most this width."""
    most = max(padded(2 * batch, ROWS), padded(widest, PANEL))
    return Room(
        actions=aligned((batch, actions), dtype),
        log_probability=aligned((batch,), dtype),
        spread=aligned((2, batch, actions), dtype),
        target=aligned((batch,), dtype),
        scratch=aligned((ROOMS, PANEL * most), dtype),
    )


@compiled
def _place(rows: int, row: int, column: int) -> int:
    """Where an element of a matrix in panels lies."""
    return (column // PANEL) * rows * PANEL + row * PANEL + column % PANEL


@compiled
def draw(actor: Net, rows: int, noise: Array, room: Room) -> None:
    """Actions from the actor's output, and their log probability, as SB3 computes it."""
    not_inlined()
    y, (batch, count) = actor.result[0], noise.shape
    for n in range(batch):
        total = 0.0
        for j in range(count):
            mean, raw = float(y[_place(rows, n, j)]), float(y[_place(rows, n, count + j)])
            log_std = min(max(raw, _LOG_STD_MIN), _LOG_STD_MAX)
            spread, drawn = math.exp(log_std) * noise[n, j], noise[n, j]
            action = math.tanh(mean + spread)
            total -= 0.5 * drawn * drawn + log_std + _LOG_ROOT_TWO_PI + math.log(1.0 - action * action + _EPSILON)
            room.actions[n, j] = action
            room.spread[0, n, j] = spread
            room.spread[1, n, j] = 1.0 if log_std == raw else 0.0
        room.log_probability[n] = total


@compiled
def actor_slopes(actor: Net, critic: Net, seen: int, alpha: float, room: Room) -> None:
    """The gradient of mean(alpha log probability - value) in the actor's output, left in `result`.

    That of minus the value in the actions lies in the critics' input, from column `seen` on.
    """
    not_inlined()
    batch, count = room.actions.shape
    rows = (batch + ROWS - 1) // ROWS * ROWS
    y, x, share = line(actor.result, 0, 0), line(critic.active, 0, 0), alpha / batch
    clear(y, 0, y.size)
    for n in range(batch):
        for j in range(count):
            action = float(room.actions[n, j])
            left = 1.0 - action * action  # of tanh
            slope = (float(x[_place(rows, n, seen + j)]) + share * 2.0 * action / (left + _EPSILON)) * left
            y[_place(rows, n, j)] = slope
            y[_place(rows, n, count + j)] = (slope * room.spread[0, n, j] - share) * room.spread[1, n, j]

"""The finer facts of a run that laws and effects beyond Coulomb-viscous friction show in."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from frasa_sysid.recording import FloatArray, Signal

BANDS = (0.1, 0.3, 1.0, 3.0)  # [rad/s] borders; Stribeck curves of such servos fade between them
SMALL = 0.02  # [rad] error up to which a punch or a dead zone is not drowned by it
_WINDOW, _FEWEST = 0.05, 7  # [s] and samples that a speed is averaged over: encoder steps are no motion
_LIFTED = 0.3  # |sin q| from which on gravity's direction matters

BoolArray = np.ndarray[tuple[int], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Detail:
    """What one run did, in more detail than `inspection.Motion`; seconds count powered time only.

    Attributes:
        in_bands: at the speeds between neighbouring `BANDS` [s].
        standstills: changes of direction.
        lifting: moving against gravity, well off the vertical [s].
        lowering: moving with it [s].
        low, high: of the position [rad].
        small_errors: with an error of at least a count and at most `SMALL` [s].
        goal_step: largest change from one goal to the next [rad].
        supply_rate: changes of the measured supply [1/s]; 0 when not measured.
        supply_swing: how much it changes, 5 to 95 % quantile over the median.
    """

    in_bands: tuple[float, ...]
    standstills: int
    lifting: float
    lowering: float
    low: float
    high: float
    small_errors: float
    goal_step: float
    supply_rate: float
    supply_swing: float


def detail_of(
    t: FloatArray,
    q: FloatArray,
    powered: BoolArray,
    error: FloatArray,
    count: float,
    goal: Signal | None,
    supply: Signal | None,
) -> Detail:
    """The finer facts of a run.

    Args:
        t: times [s], shape (T,).
        q: position [rad], (T,).
        powered: whether the motor is on, (T,).
        error: goal minus position [rad], (T,); zeros where there is no goal.
        count: step of the position [rad].
        goal: goal angles.
        supply: measured supply.
    """
    speed = _speed(t, q)
    held = np.where(powered, np.gradient(t), 0.0)
    fast, away = np.abs(speed), np.sin(q)
    slowest = fast >= BANDS[0]
    off = slowest & (np.abs(away) > _LIFTED)
    small = (np.abs(error) >= count) & (np.abs(error) <= SMALL) & (error != 0.0)
    signs = np.sign(speed[powered & slowest])
    return Detail(
        in_bands=tuple(float(held[(fast >= low) & (fast < high)].sum()) for low, high in pairwise(BANDS)),
        standstills=int(np.count_nonzero(np.diff(signs))),
        lifting=float(held[off & (speed * away > 0.0)].sum()),
        lowering=float(held[off & (speed * away < 0.0)].sum()),
        low=float(q.min()),
        high=float(q.max()),
        small_errors=float(held[small].sum()),
        goal_step=_largest_step(goal),
        supply_rate=_rate(supply),
        supply_swing=_swing(supply),
    )


def _speed(t: FloatArray, q: FloatArray) -> FloatArray:
    """Speed of the position averaged over a window [rad/s], (T,)."""
    width = max(_FEWEST, round(_WINDOW / max(float(np.median(np.diff(t))), 1e-9)) | 1)
    width = min(width, (q.size - 1) | 1)
    padded = np.pad(q, width // 2, mode="edge")
    return np.asarray(np.gradient(np.convolve(padded, np.full(width, 1.0 / width), mode="valid")[: q.size], t))


def _largest_step(goal: Signal | None) -> float:
    if goal is None or goal.columns or goal.t.size < 2:
        return 0.0
    return float(np.abs(np.diff(goal.y)).max())


def _rate(supply: Signal | None) -> float:
    if supply is None or supply.t.size < 2:
        return 0.0
    return float(np.count_nonzero(np.diff(supply.y)) / (supply.t[-1] - supply.t[0]))


def _swing(supply: Signal | None) -> float:
    if supply is None:
        return 0.0
    low, middle, high = np.percentile(supply.y, (5, 50, 95))
    return float((high - low) / middle) if middle > 0.0 else 0.0

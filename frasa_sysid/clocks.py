"""Clocks of a log against each other: how far apart, how evenly they run, and how fast they drift apart.

Stamps of the same events on two clocks differ by an offset, a drift, and by waiting: a message arrives late but never
early. So the drift is taken from the least difference in each of several stretches of time, a line through those
minima that outliers do not turn (Theil and Sen), with an interval by leaving out stretches one by one.
"""

from typing import Any

import numpy as np
from scipy import stats

from frasa_sysid.recording import FloatArray

_STRETCHES = (8, 24)  # fewest and most
_FEWEST = 24  # stamps that a drift is asked of
_STEPS = (1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # [s] that stamps may come in
_ROUNDING = 5e-7  # [s] of seconds since 1970 as a float
_CONFIDENCE = 0.95


def compare_clocks(of: str, t: FloatArray, against: str, other: FloatArray) -> dict[str, Any]:
    """How one clock's stamps of events lie to another's, as plain JSON values.

    Args:
        of: name of the first clock.
        t: its stamps [s], shape (T,).
        against: name of the second clock.
        other: its stamps of the same events [s], shape (T,).

    Returns:
        `of`, `against`, `samples`; `offset_ms` (median, 99 % and largest of first minus second, above the least one,
        and the least one itself); `drift_ppm` (value, low, high: by how much faster the first runs), None where the
        log is too short for it. Empty with fewer than two usable stamps.
    """
    good = np.isfinite(t) & np.isfinite(other)
    t, other = t[good], other[good]
    order = np.argsort(other, kind="stable")
    t, other = t[order], other[order]
    if t.size < 2:
        return {}
    apart = t - other
    least = float(apart.min())
    beyond = 1e3 * (apart - least)
    drift = drift_ppm(t, other)
    return {
        "of": of,
        "against": against,
        "samples": int(t.size),
        "offset_ms": {
            "least": 1e3 * least,
            "median_above": float(np.median(beyond)),
            "p99_above": float(np.percentile(beyond, 99)),
            "most_above": float(beyond.max()),
        },
        "drift_ppm": None if drift is None else {"value": drift[0], "low": drift[1], "high": drift[2]},
    }


def drift_ppm(t: FloatArray, other: FloatArray) -> tuple[float, float, float] | None:
    """By how many parts in a million the first clock runs faster, with a 95 % interval; None for too few stamps.

    Args:
        t: stamps on the first clock [s], shape (T,).
        other: stamps of the same events on the second [s], shape (T,), in order of time.
    """
    if t.size < _FEWEST or not np.ptp(other) > 0.0:
        return None
    count = int(np.clip(t.size // 6, *_STRETCHES))
    edges = np.linspace(other[0], other[-1], count + 1)
    place = np.clip(np.searchsorted(edges, other, side="right") - 1, 0, count - 1)
    apart = t - other
    stretches = [np.flatnonzero(place == k) for k in range(count)]
    lowest = [int(members[apart[members].argmin()]) for members in stretches if members.size]
    x, y = other[lowest], apart[lowest]
    if x.size < _STRETCHES[0] // 2:
        return None
    slope = _slope(x, y)
    left = np.array([_slope(np.delete(x, i), np.delete(y, i)) for i in range(x.size)])
    jackknife = np.sqrt((x.size - 1) / x.size * ((left - left.mean()) ** 2).sum())
    # The jackknife of a median may vanish; residuals about the line bound it from below.
    rest = y - slope * x
    plain = 1.4826 * np.median(np.abs(rest - np.median(rest))) / np.sqrt(((x - x.mean()) ** 2).sum())
    half = float(stats.t.ppf(0.5 + _CONFIDENCE / 2, x.size - 2)) * max(float(jackknife), float(plain))
    # Stamps that are whole milliseconds cannot say more than half of one over the log, however well they agree.
    half = max(half, 0.5 * max(_resolution(t), _resolution(other)) / float(np.ptp(other)))
    return 1e6 * slope, 1e6 * (slope - half), 1e6 * (slope + half)


def _resolution(t: FloatArray) -> float:
    """The step of a clock's stamps [s], as far as it is a decimal one; 1 ns where they are finer."""
    beyond = t - t[0]
    for step in _STEPS:
        if (np.abs(beyond - step * np.round(beyond / step)) < min(_ROUNDING, 0.01 * step)).all():
            return step
    return 1e-9


def _slope(x: FloatArray, y: FloatArray) -> float:
    i, j = np.triu_indices(x.size, 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def jitter(t: FloatArray) -> dict[str, float] | None:
    """How evenly a clock ticks, as plain JSON values; None for fewer than three stamps.

    Args:
        t: stamps [s], shape (T,).

    Returns:
        `period_ms` (median), and of its deviations `rms_us`, `p99_us` and `most_us` (absolute); `drift_free_rms_us` is
        that of the stamps about a straight line: what a reader that counts samples would be off.
    """
    if t.size < 3:
        return None
    dt = np.diff(t)
    period = float(np.median(dt))
    off = np.abs(dt - period)
    # Missed slots are gaps, not jitter: a stamp counts by the slot that it is in.
    slots = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(dt / period), 1.0))])
    line = np.polynomial.polynomial.polyfit(slots, t, 1)
    rest = t - np.polynomial.polynomial.polyval(slots, line)
    return {
        "period_ms": 1e3 * period,
        "rms_us": 1e6 * float(np.sqrt(((off[off < 0.5 * period]) ** 2).mean())) if (off < 0.5 * period).any() else 0.0,
        "p99_us": 1e6 * float(np.percentile(off, 99)),
        "most_us": 1e6 * float(off.max()),
        "drift_free_rms_us": 1e6 * float(rest.std()),
    }

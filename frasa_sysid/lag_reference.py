"""One channel as a function of time, so that another can be held against it at any delay.

A cubic spline with fewer knots than samples stands for a measured channel: a line through every sample is noisy at
the samples and smooth between them, and some delays would look better than others for that alone. How many knots the
noise leaves is found by generalised cross-validation (Craven and Wahba, 1979). A goal has no noise and may step,
where a spline would ring; it is joined by lines.

A velocity is held against a position over a window W: its mean over the window against the way made in it,
:math:`(x(t + W/2) - x(t - W/2)) / W`. The same symmetric filter on both sides moves neither in time; W = 0 would be
the derivative, whose noise is that of the position's last digit, a long W the integral, which wanders.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline, make_lsq_spline

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray, Signal

Relation = Literal["same", "derivative"]
FEWEST = 16  # samples of a channel
_KNOTS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # samples from one to the next
_FINER = 4  # lines of a spectrum for one that the log resolves
GAP = 4.0  # median periods from which on nothing is known in between

Mask = np.ndarray[tuple[int], np.dtype[np.bool_]]
Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Reference:
    """x(t), or its slope over a window.

    Attributes:
        curve: the channel between its samples.
        rate: its derivative.
        t: the samples' times [s], shape (n,).
        window: W [s]; 0 for x itself.
    """

    curve: Function
    rate: Function
    t: FloatArray
    window: float

    def value(self, t: FloatArray) -> FloatArray:
        """x, or its mean slope, at times t [s], shape (n,)."""
        return self._over_window(self.curve, t)

    def slope(self, t: FloatArray) -> FloatArray:
        """The derivative of `value` [1/s], shape (n,)."""
        return self._over_window(self.rate, t)

    def known(self, t: FloatArray) -> Mask:
        """Where x is between samples that stand close enough together."""
        half = self.window / 2
        good = np.asarray((t - half >= self.t[0]) & (t + half <= self.t[-1]))
        gaps = np.diff(self.t)
        wide = np.concatenate([[False], gaps > GAP * np.median(gaps), [False]])
        for edge in (t - half, t + half):
            good &= ~wide[np.searchsorted(self.t, edge)]
        return good

    def _over_window(self, function: Function, t: FloatArray) -> FloatArray:
        if self.window == 0.0:
            return function(t)
        half = self.window / 2
        return (function(t + half) - function(t - half)) / self.window


def reference(signal: Signal, y: FloatArray, window: float) -> Reference:
    """One column of a signal as a function of time.

    Args:
        signal: with the times.
        y: the column, shape (T,).
        window: over which its slope is taken [s]; 0 for the values themselves.

    Raises:
        LogError: fewer samples than a curve needs.
    """
    if signal.t.size < FEWEST:
        raise LogError(f"'{signal.name}' has {signal.t.size} samples, a delay needs {FEWEST} or more")
    if signal.name.startswith("goal"):
        curve: BSpline = make_interp_spline(signal.t, y, k=1)
    else:
        curve = smooth(signal.t, y)
    return Reference(_inside(curve, signal.t), _inside(curve.derivative(), signal.t), signal.t, window)


def smooth(t: FloatArray, y: FloatArray) -> BSpline:
    """The least-squares cubic spline whose number of knots predicts left-out samples best.

    Args:
        t: times [s], shape (T,).
        y: values, shape (T,).
    """
    best, least = None, np.inf
    for every in _KNOTS:
        inner = t[3:-3:every]
        # With the last knot a sample away from the end the spline would have no support there.
        knots = np.r_[[t[0]] * 4, inner[inner < t[-4]], [t[-1]] * 4]
        free = knots.size - 4
        if free < 4 or free > 0.7 * t.size:
            continue
        curve = make_lsq_spline(t, y, knots, k=3)
        score = float(((y - curve(t)) ** 2).mean()) / (1.0 - free / t.size) ** 2
        if score < least:
            best, least = curve, score
    return best if best is not None else make_interp_spline(t, y, k=1)


def _inside(curve: BSpline, t: FloatArray) -> Function:
    """A curve that stays at its ends' values: beyond them nothing is used, but a cubic would overflow there."""
    return lambda at: np.asarray(curve(np.clip(at, t[0], t[-1])), dtype=np.float64)


def window_mean(t: FloatArray, y: FloatArray, window: float) -> tuple[FloatArray, FloatArray, Mask]:
    """Means of a channel over a window around each sample.

    Args:
        t: sample times [s], shape (T,).
        y: values, shape (T,).
        window: W [s]; 0 gives the samples themselves.

    Returns:
        Times and means, shape (T,), and where the whole window lies inside, without a gap at its ends.
    """
    if window == 0.0:
        return t, y, np.ones(t.size, dtype=bool)
    total = _inside(make_interp_spline(t, y, k=1).antiderivative(), t)
    mean = (total(t + window / 2) - total(t - window / 2)) / window
    gaps = np.diff(t)
    wide = np.concatenate([[False], gaps > GAP * np.median(gaps), [False]])
    good = np.asarray((t - window / 2 >= t[0]) & (t + window / 2 <= t[-1]))
    good &= ~wide[np.searchsorted(t, t - window / 2)] & ~wide[np.searchsorted(t, t + window / 2)]
    return t, mean, good


def main_frequency(t: FloatArray, values: FloatArray) -> float:
    """Where most of a motion's power is [Hz]; 0 where it stands still. Shapes (T,), times need not be even."""
    line, power, width = _spectrum(t, values)
    return float(line / width) if power[line] > 0.0 else 0.0


def purity(t: FloatArray, values: FloatArray) -> float:
    """Share of a motion's power that lies at its main frequency: 1 for a sine, shapes (T,)."""
    line, power, _ = _spectrum(t, values)
    near = slice(max(line - 2 * _FINER, 1), line + 2 * _FINER + 1)
    total = float(power[1:].sum())
    return float(power[near].sum()) / total if total > 0.0 else 0.0


def _spectrum(t: FloatArray, values: FloatArray) -> tuple[int, FloatArray, float]:
    grid = np.linspace(t[0], t[-1], int(np.clip(t.size, 16, 8192)))
    level = np.interp(grid, t, values)
    power = np.abs(np.fft.rfft((level - level.mean()) * np.hanning(grid.size), _FINER * grid.size)) ** 2
    return int(power[1:].argmax()) + 1, power, float(_FINER * grid.size * (grid[1] - grid[0]))

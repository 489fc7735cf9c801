r"""The delay by frequency: a pure delay is the same at all of them, a filter or a control loop is not.

The log is cut into pieces; in each both channels are taken apart into frequencies at their own, uneven times. In a
band the ratio H of the two, fitted to all pieces and frequencies in it, has the phase :math:`-2\pi f d`. What H does
not explain is the noise, and gives the interval.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from frasa_sysid.lag_reference import Reference
from frasa_sysid.recording import FloatArray

_PERIODS = 6.0  # of the slowest frequency that matters, in a piece
_PIECES = (3, 40)
_LOW, _HIGH = 0.1, 0.999  # shares of the power of x, below two frequencies that matter
_SHARE = 3e-3  # of the power of x, below which a frequency is not excited
_WIDTH = 1.5  # highest over lowest frequency of a band
_FEWEST_CELLS = 6  # of piece and frequency, in a band
_MOST_LINES = 400
_CORRELATED = 2.0  # neighbouring frequencies of a windowed piece are not independent: variance times this
_EDGE = 0.35  # of the sampling rate; nearer to half of it nothing is trusted

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Band:
    """What one band of frequencies says.

    Attributes:
        frequency: mean of the band, weighted by power [Hz].
        delay: phase delay [s].
        error: its standard error [s].
        ratio: amplitude of y over that of x.
        ratio_error: its standard error.
    """

    frequency: float
    delay: float
    error: float
    ratio: float
    ratio_error: float


def bands(t: FloatArray, y: FloatArray, x: Reference, delay: float) -> list[Band]:
    """The delay by frequency, for the frequencies that x has.

    Args:
        t: times of y [s], shape (T,).
        y: values, shape (T,).
        x: what it is held against.
        delay: first guess [s]: a period more or less cannot be told by one band.
    """
    inside = x.known(t - delay)
    t, y = t[inside], y[inside]
    if t.size < 64:
        return []
    # The other channel at the very same instants, so that both leak alike: x moved by the first guess.
    X = x.value(t - delay)
    extent = _extent(t, X)
    if extent is None:
        return []
    count = int(np.clip((t[-1] - t[0]) * extent[0] / _PERIODS, *_PIECES))
    lines = _lines(t, count, extent[1])
    if lines.size == 0:
        return []
    FX, FY = _spectra(t, np.stack([X, y]), lines, count)
    return _by_band(lines, FX, FY, delay)


def _extent(t: FloatArray, X: FloatArray) -> tuple[float, float] | None:
    """The frequencies below and above which hardly any power lies [Hz]."""
    grid = np.linspace(t[0], t[-1], min(t.size, 4096))
    values = np.interp(grid, t, X)
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(grid.size))) ** 2
    if not power[1:].sum() > 0.0:
        return None
    total = np.cumsum(power[1:])
    low, high = (int(np.searchsorted(total, share * total[-1])) + 1 for share in (_LOW, _HIGH))
    return float(low / (grid[-1] - grid[0])), float((high + 1) / (grid[-1] - grid[0]))


def _lines(t: FloatArray, count: int, highest: float) -> FloatArray:
    """Frequencies that a piece resolves [Hz], from the second on: the first is the window's own."""
    length = (t[-1] - t[0]) / count
    highest = min(_EDGE / float(np.median(np.diff(t))), 1.5 * highest)
    lines: FloatArray = np.arange(2, min(int(highest * length), _MOST_LINES) + 1) / length
    return lines


def _spectra(t: FloatArray, channels: FloatArray, lines: FloatArray, count: int) -> tuple[Complex, Complex]:
    """Both channels by piece and frequency, (pieces, lines) each; times need not be even."""
    weight = np.gradient(t)
    found = []
    edges = np.linspace(t[0], t[-1], count + 1)
    for k in range(count):
        part = (t >= edges[k]) & (t <= edges[k + 1])
        if part.sum() < 8:
            continue
        phase = (t[part] - edges[k]) / (edges[k + 1] - edges[k])
        taper = weight[part] * np.sin(np.pi * phase) ** 2
        level = channels[:, part] @ taper / taper.sum()
        waves = np.exp(-2j * np.pi * np.outer(t[part], lines))
        found.append((taper * (channels[:, part] - level[:, None])) @ waves)
    both = np.array(found)
    return both[:, 0], both[:, 1]


def _by_band(lines: FloatArray, FX: Complex, FY: Complex, delay: float) -> list[Band]:
    power = (np.abs(FX) ** 2).sum(axis=0)
    excited = np.flatnonzero(power > _SHARE * power.max())
    result: list[Band] = []
    while excited.size:
        group = excited[lines[excited] <= _WIDTH * lines[excited[0]]]
        band = _band(lines[group], FX[:, group], FY[:, group], delay)
        if band is not None:
            result.append(band)
        excited = excited[group.size :]
    return result


def _band(lines: FloatArray, FX: Complex, FY: Complex, delay: float) -> Band | None:
    if FX.size < _FEWEST_CELLS:
        return None
    power = np.abs(FX) ** 2
    total = float(power.sum())
    frequency = float((power.sum(axis=0) @ lines) / total)
    H = complex((np.conj(FX) * FY).sum() / total)
    rest = float((np.abs(FY - H * FX) ** 2).sum()) / (FX.size - 1)
    if abs(H) == 0.0:
        return None
    error = float(np.sqrt(_CORRELATED * rest / (2.0 * total)))  # of one of the two parts of H
    phase = float(np.angle(H))
    turn = 2.0 * np.pi * frequency
    return Band(frequency, delay - phase / turn, error / (abs(H) * turn), abs(H), error)


@dataclass(frozen=True)
class Agreement:
    """Whether several estimates of one delay agree.

    Attributes:
        mean: weighted by the inverse squared errors [s].
        error: of the mean, by the single errors [s].
        chi2: sum of squared deviations over errors.
        dof: its degrees of freedom.
        p: chance of more, if there is one delay; 1 with one estimate.
        spread: standard deviation that is left between the estimates beyond their errors [s].
    """

    mean: float
    error: float
    chi2: float
    dof: int
    p: float
    spread: float


def agreement(delays: FloatArray, errors: FloatArray) -> Agreement:
    """Weighted mean and test of several estimates, shapes (n,); the spread by DerSimonian and Laird (1986)."""
    weight = 1.0 / np.maximum(errors, 1e-12) ** 2
    mean = float(weight @ delays / weight.sum())
    chi2 = float(weight @ (delays - mean) ** 2)
    dof = delays.size - 1
    p = float(stats.chi2.sf(chi2, dof)) if dof else 1.0
    beyond = (chi2 - dof) / float(weight.sum() - (weight**2).sum() / weight.sum()) if dof else 0.0
    return Agreement(mean, float(weight.sum() ** -0.5), chi2, dof, p, float(np.sqrt(max(beyond, 0.0))))

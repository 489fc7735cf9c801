"""A first look at every delay: how well each does, which one is best, and which others do as well."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from frasa_sysid.errors import LogError
from frasa_sysid.lag_reference import Mask, Reference, main_frequency
from frasa_sysid.recording import FloatArray

FEWEST_SHARED = 30  # samples of y for which x must be known
_MOST_SCANNED = 3000  # in the scan
_STEPS = (201, 2001)  # fewest and most of the scan
_SHARED = 0.4  # share of all samples, likewise
_PARTS = 12  # that two delays are compared on
_DISTINCT = 0.05  # chance up to which two delays count as told apart ...
_ALIKE = 0.02  # ... if they differ by more than this share of y's variance
_BESIDE = 0.4  # of a period; delays nearer to each other belong to one
_WORTH_A_TEST = 0.2  # likewise; what is further behind is no rival


def grid(t: FloatArray, x: Reference, limits: tuple[float, float]) -> FloatArray:
    """Delays to try [s], as close as the samples of the faster channel, shape (D,)."""
    period = min(float(np.median(np.diff(t))), float(np.median(np.diff(x.t))))
    count = int(np.clip(np.ceil((limits[1] - limits[0]) / period) + 1, *_STEPS))
    return np.linspace(*limits, count)


@dataclass(frozen=True)
class Scan:
    """How well every delay does on the samples that it can be judged by.

    Attributes:
        delays: that were tried [s], shape (D,).
        upright: share of y's variance that is explained with a >= 0, shape (D,).
        inverted: likewise with a <= 0, shape (D,).
        t: times of y that were looked at, shape (n,).
        y: shape (n,).
        x: the other channel.
    """

    delays: FloatArray
    upright: FloatArray
    inverted: FloatArray
    t: FloatArray
    y: FloatArray
    x: Reference

    def losses(self, d: float, sign: int, inside: Mask) -> FloatArray:
        """Squared residuals with that delay and sign of a, as shares of y's variance, by block, shape (B,)."""
        y, X = self.y[inside], self.x.value(self.t[inside] - d)
        y, X = y - y.mean(), X - X.mean()
        a = sign * max(sign * float(X @ y) / max(float(X @ X), 1e-300), 0.0)
        blocks = np.arange(y.size) * _PARTS // y.size
        return np.bincount(blocks, (y - a * X) ** 2) / float(y @ y)

    def alike(self, d: float, best: float, sign: int = 1) -> bool:
        """Whether blocks leave open which of two delays is better (paired t test), or hardly anything depends on it."""
        inside = self.x.known(self.t - d) & self.x.known(self.t - best)
        if inside.sum() < FEWEST_SHARED or not np.ptp(self.y[inside]) > 0.0:
            return True
        apart = self.losses(d, 1, inside) - self.losses(best, sign, inside)
        error = float(apart.std(ddof=1)) / np.sqrt(apart.size)
        return bool(apart.mean() <= stats.t.ppf(1 - _DISTINCT, apart.size - 1) * error or apart.sum() < _ALIKE)


def make_scan(t: FloatArray, y: FloatArray, x: Reference, delays: FloatArray) -> Scan:
    """Look at all delays.

    Args:
        t: times of y [s], shape (T,).
        y: values, shape (T,).
        x: what it is held against.
        delays: to try [s], shape (D,).

    Raises:
        LogError: one of the channels stands still, or hardly any samples overlap.
    """
    stride = -(-t.size // _MOST_SCANNED)
    t, y = t[::stride], y[::stride]
    if not np.ptp(y) > 0.0:
        raise LogError("it stands still")
    upright, inverted = np.full(delays.size, -1.0), np.full(delays.size, -1.0)
    for i, d in enumerate(delays):
        inside = x.known(t - d)
        # A motion that begins with the log is seen by small delays only: each is judged by the samples it has.
        if inside.sum() < max(FEWEST_SHARED, _SHARED * t.size):
            continue
        part, X = y[inside] - y[inside].mean(), x.value(t[inside] - d)
        X = X - X.mean()
        power, common = float(X @ X) * float(part @ part), float(X @ part)
        if power > 0.0:
            upright[i], inverted[i] = max(common, 0.0) ** 2 / power, min(common, 0.0) ** 2 / power
    if not (upright >= 0.0).any():
        raise LogError(f"fewer than {FEWEST_SHARED} samples overlap, or the other channel stands still")
    return Scan(delays, upright, inverted, t, y, x)


@dataclass(frozen=True)
class Peak:
    """The best delay of a scan, what does as well beside it and at other periods, and whether there is none."""

    delay: float
    beside: tuple[float, ...] = ()
    others: tuple[float, ...] = ()
    at_edge: bool = False


def motion_period(scan: Scan) -> float:
    """Of the motion [s]; infinite where it stands still."""
    frequency = main_frequency(scan.t, scan.x.value(scan.t))
    return 1.0 / frequency if frequency > 0.0 else np.inf


def choose(scan: Scan, step: float, period: float) -> Peak:
    """The delay to refine.

    Args:
        scan: of all delays.
        step: between two of them [s].
        period: of the motion [s].
    """
    score = scan.upright
    best = int(score.argmax())
    inner = np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] > score[2:]) & (score[1:-1] > 0.0)) + 1
    if best not in inner:
        return Peak(float(scan.delays[best]), at_edge=True)
    alike = [int(i) for i in inner if i == best or _near(scan, int(i), best)]
    # Of periods that are as good the one with the shortest delay is meant; peaks side by side are ripples of one.
    shortest = min(alike, key=lambda i: abs(scan.delays[i]))
    group = [i for i in alike if abs(scan.delays[i] - scan.delays[shortest]) < _BESIDE * period]
    chosen = max(group, key=lambda i: score[i])
    others: list[float] = []
    for i in sorted(set(alike) - set(group), key=lambda i: -score[i]):
        if all(abs(scan.delays[i] - one) > _BESIDE * period for one in others):
            others.append(float(scan.delays[i]))
    beside = tuple(float(scan.delays[i]) for i in group if abs(scan.delays[i] - scan.delays[chosen]) > 2 * step)
    return Peak(float(scan.delays[chosen]), beside, tuple(sorted(others)))


def _near(scan: Scan, i: int, best: int) -> bool:
    if scan.upright[i] < scan.upright[best] - _WORTH_A_TEST:
        return False
    return scan.alike(float(scan.delays[i]), float(scan.delays[best]))


def is_inverted(scan: Scan) -> bool:
    """Whether some delay with a negative a does clearly better than any with a positive one."""
    best, other = int(scan.upright.argmax()), int(scan.inverted.argmax())
    if scan.inverted[other] <= scan.upright[best]:
        return False
    return not scan.alike(float(scan.delays[best]), float(scan.delays[other]), sign=-1)

r"""How much later one channel shows what another shows: :math:`y(t) = a\, x(t - d) + b`, d continuous.

a and b are closed form for every d. A scan of d finds the valleys; in the best one Gauss-Newton steps with weights
that fall for outliers end at the minimum. The interval takes the blocks of the log, not its samples, as what is
independent: left out one by one (delete-a-group jackknife of the linearised problem), with as many degrees of freedom
as there are blocks that tell something about d.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from frasa_sysid.errors import LogError
from frasa_sysid.lag_reference import Mask, Reference, main_frequency
from frasa_sysid.recording import FloatArray

CONFIDENCE = 0.95
_MOST = 20_000  # samples that are used; of more every second, third ... one
_MOST_SCANNED = 3000  # in the scan
_STEPS = (201, 2001)  # fewest and most of the scan
_ROUNDS = 40
_ROAM = 3  # steps of the scan that the minimum may lie beside its best
_ROBUST = 4.0  # median residuals from which on a sample counts little
_OUTLIER_HOLDS = 0.1  # of what it would if its pull grew
_BLOCKS = (6, 24)  # fewest and most
_FEWEST = 30  # samples of y for which x must be known
_SHARED = 0.4  # share of all samples, likewise
_PARTS = 12  # that two delays are compared on
_DISTINCT = 0.05  # chance up to which two delays count as told apart ...
_ALIKE = 0.02  # ... if they differ by more than this share of y's variance
_BESIDE = 0.4  # of a period; delays nearer to each other belong to one
_WORTH_A_TEST = 0.2  # likewise; what is further behind is no rival


@dataclass(frozen=True)
class Fitted:
    """The best delay of one pair.

    Attributes:
        delay: d [s].
        error: its standard error [s].
        dof: degrees of freedom of that error.
        ratio: a.
        ratio_error: its standard error.
        explained: share of y's variance that a x(t - d) + b explains.
        others: further delays that the log does not tell from d [s]: a periodic motion has them.
        low: least of the delays beside d, less than half a period away, that do as well [s]; d itself if there is none.
        high: largest of them [s].
        at_edge: there is no best delay inside the limits.
        inverted: a negative a explains the log clearly better than any positive one.
        used: samples of y.
    """

    delay: float
    error: float
    dof: float
    ratio: float
    ratio_error: float
    explained: float
    others: tuple[float, ...]
    low: float
    high: float
    at_edge: bool
    inverted: bool
    used: int

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval of the delay [s]."""
        return float(stats.t.ppf(0.5 + CONFIDENCE / 2, self.dof) * self.error)


def fit_delay(t: FloatArray, y: FloatArray, x: Reference, limits: tuple[float, float]) -> Fitted:
    """The delay that explains y best.

    Args:
        t: times of y [s], shape (T,).
        y: values, shape (T,).
        x: what it is held against.
        limits: shortest and longest delay that is tried [s].

    Raises:
        LogError: too few samples overlap, or one of the channels stands still.
    """
    stride = -(-t.size // _MOST)
    t, y = t[::stride], y[::stride]
    scan = _scan(t, y, x, _grid(t, x, limits))
    step = float(scan.delays[1] - scan.delays[0])
    peak = _choose(scan, step, _period(scan))
    start = peak.delay
    inverted = _is_inverted(scan)
    near = x.known(t - start - _ROAM * step) & x.known(t - start + _ROAM * step)
    if near.sum() < _FEWEST:
        raise LogError(f"{int(near.sum())} samples overlap at a delay of {1e3 * start:.1f} ms, {_FEWEST} are needed")
    return _refine(t[near], y[near], x, peak, step, inverted)


def _grid(t: FloatArray, x: Reference, limits: tuple[float, float]) -> FloatArray:
    period = min(float(np.median(np.diff(t))), float(np.median(np.diff(x.t))))
    count = int(np.clip(np.ceil((limits[1] - limits[0]) / period) + 1, *_STEPS))
    return np.linspace(*limits, count)


@dataclass(frozen=True)
class _Scan:
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
        if inside.sum() < _FEWEST or not np.ptp(self.y[inside]) > 0.0:
            return True
        apart = self.losses(d, 1, inside) - self.losses(best, sign, inside)
        error = float(apart.std(ddof=1)) / np.sqrt(apart.size)
        return bool(apart.mean() <= stats.t.ppf(1 - _DISTINCT, apart.size - 1) * error or apart.sum() < _ALIKE)


def _scan(t: FloatArray, y: FloatArray, x: Reference, grid: FloatArray) -> _Scan:
    stride = -(-t.size // _MOST_SCANNED)
    t, y = t[::stride], y[::stride]
    if not np.ptp(y) > 0.0:
        raise LogError("it stands still")
    upright, inverted = np.full(grid.size, -1.0), np.full(grid.size, -1.0)
    for i, d in enumerate(grid):
        inside = x.known(t - d)
        # A motion that begins with the log is seen by small delays only: each is judged by the samples it has.
        if inside.sum() < max(_FEWEST, _SHARED * t.size):
            continue
        part, X = y[inside] - y[inside].mean(), x.value(t[inside] - d)
        X = X - X.mean()
        power, common = float(X @ X) * float(part @ part), float(X @ part)
        if power > 0.0:
            upright[i], inverted[i] = max(common, 0.0) ** 2 / power, min(common, 0.0) ** 2 / power
    if not (upright >= 0.0).any():
        raise LogError(f"fewer than {_FEWEST} samples overlap, or the other channel stands still")
    return _Scan(grid, upright, inverted, t, y, x)


@dataclass(frozen=True)
class _Peak:
    """The best delay of a scan, what does as well beside it and at other periods, and whether there is none."""

    delay: float
    beside: tuple[float, ...] = ()
    others: tuple[float, ...] = ()
    at_edge: bool = False


def _period(scan: _Scan) -> float:
    """Of the motion [s]; infinite where it stands still."""
    frequency = main_frequency(scan.t, scan.x.value(scan.t))
    return 1.0 / frequency if frequency > 0.0 else np.inf


def _choose(scan: _Scan, step: float, period: float) -> _Peak:
    score = scan.upright
    best = int(score.argmax())
    inner = np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] > score[2:]) & (score[1:-1] > 0.0)) + 1
    if best not in inner:
        return _Peak(float(scan.delays[best]), at_edge=True)
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
    return _Peak(float(scan.delays[chosen]), beside, tuple(sorted(others)))


def _near(scan: _Scan, i: int, best: int) -> bool:
    if scan.upright[i] < scan.upright[best] - _WORTH_A_TEST:
        return False
    return scan.alike(float(scan.delays[i]), float(scan.delays[best]))


def _is_inverted(scan: _Scan) -> bool:
    best, other = int(scan.upright.argmax()), int(scan.inverted.argmax())
    if scan.inverted[other] <= scan.upright[best]:
        return False
    return not scan.alike(float(scan.delays[best]), float(scan.delays[other]), sign=-1)


def _refine(t: FloatArray, y: FloatArray, x: Reference, peak: _Peak, step: float, inverted: bool) -> Fitted:
    d = start = peak.delay
    weight: FloatArray = np.ones(t.size)
    for _ in range(_ROUNDS):
        before = d
        J, r, theta = _linear(t, y, x, d)
        weight = _weights(r)
        change = np.linalg.lstsq(J.T @ (weight[:, None] * J), J.T @ (weight * r), rcond=None)[0]
        d = float(np.clip(d + np.clip(change[2], -step, step), start - _ROAM * step, start + _ROAM * step))
        if abs(d - before) < 1e-9:
            break
    at_edge = peak.at_edge or abs(d - start) > (_ROAM - 0.01) * step
    J, r, theta = _linear(t, y, x, d)
    errors, dof = _errors(J, r, weight)
    centred = y - np.average(y, weights=weight)
    spread = float(weight @ centred**2)
    return Fitted(
        delay=d,
        error=errors[2],
        dof=dof,
        ratio=float(theta[0]),
        ratio_error=errors[0],
        explained=1.0 - float(weight @ r**2) / spread if spread > 0.0 else 0.0,
        others=peak.others,
        low=min(d, *peak.beside, d),
        high=max(d, *peak.beside, d),
        at_edge=at_edge,
        inverted=inverted,
        used=int(t.size),
    )


def _linear(t: FloatArray, y: FloatArray, x: Reference, d: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives by a, b and d (n, 3), residuals (n,), and (a, b) at one delay; a and b are the robust best."""
    X = x.value(t - d)
    basis = np.stack([X, np.ones(t.size)], axis=1)
    weight: FloatArray = np.ones(t.size)
    theta: FloatArray = np.zeros(2)
    for _ in range(4):
        w = weight[:, None]
        theta = np.asarray(np.linalg.lstsq(basis.T @ (w * basis), basis.T @ (weight * y), rcond=None)[0], np.float64)
        weight = _weights(y - basis @ theta)
    J = np.concatenate([basis, (-theta[0] * x.slope(t - d))[:, None]], axis=1)
    return J, y - basis @ theta, theta


def _weights(r: FloatArray) -> FloatArray:
    """Huber's: 1 for all but outliers, whose pull does not grow further."""
    scale = _ROBUST * float(np.median(np.abs(r)))
    if scale == 0.0:
        return np.ones(r.size)
    return np.asarray(scale / np.maximum(np.abs(r), scale), dtype=np.float64)


def _errors(J: FloatArray, r: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Standard errors of a, b and d (3,) and degrees of freedom, with blocks left out one by one."""
    blocks = _blocks(J, r, weight)
    count = int(blocks.max()) + 1
    # An outlier pulls as hard wherever the minimum is: it does not hold it. (A little, or a log that is nothing but
    # jumps would hold it nowhere.)
    hold = np.where(weight < 1.0, _OUTLIER_HOLDS * weight, 1.0)
    normal = J.T @ (hold[:, None] * J)
    changes = np.zeros((count, 3))
    told = np.zeros(count)
    # What is left of the slope by d once a and b are free: only that tells something about d.
    basis, slope = J[:, :2], J[:, 2]
    shared = np.linalg.lstsq(basis.T @ (hold[:, None] * basis), basis.T @ (hold * slope), rcond=None)[0]
    own = slope - basis @ shared
    for k in range(count):
        part = blocks == k
        less = normal - J[part].T @ (hold[part, None] * J[part])
        changes[k] = np.linalg.lstsq(less, -J[part].T @ (weight[part] * r[part]), rcond=None)[0]
        told[k] = float(hold[part] @ own[part] ** 2)
    errors = np.sqrt((count - 1) / count * ((changes - changes.mean(axis=0)) ** 2).sum(axis=0))
    share = told / told.sum() if told.sum() > 0.0 else np.full(count, 1.0 / count)
    return errors, max(1.0 / float((share**2).sum()) - 1.0, 1.0)


def _blocks(J: FloatArray, r: FloatArray, weight: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Block of each sample: blocks longer than what neighbours have in common, as far as the log is long enough."""
    score = weight * r * J[:, 2]
    score = score - score.mean()
    size = 1 << (2 * score.size - 1).bit_length()
    power = np.abs(np.fft.rfft(score, size)) ** 2
    common = np.fft.irfft(power)[: score.size // 2]
    below = np.flatnonzero(common < 0.05 * common[0]) if common[0] > 0.0 else np.array([1])
    memory = int(below[0]) if below.size else score.size
    count = int(np.clip(score.size / (5 * max(memory, 1)), *_BLOCKS))
    return np.asarray(np.arange(score.size) * count // score.size, dtype=np.int64)

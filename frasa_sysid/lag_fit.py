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
from frasa_sysid.lag_reference import Reference
from frasa_sysid.lag_scan import FEWEST_SHARED, Peak, choose, grid, is_inverted, make_scan, motion_period
from frasa_sysid.recording import FloatArray

CONFIDENCE = 0.95
_MOST = 20_000  # samples that are used; of more every second, third ... one
_ROUNDS = 40
_ROAM = 3  # steps of the scan that the minimum may lie beside its best
_ROBUST = 4.0  # median residuals from which on a sample counts little
_OUTLIER_HOLDS = 0.1  # of what it would if its pull grew
_BLOCKS = (6, 24)  # fewest and most


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
    scan = make_scan(t, y, x, grid(t, x, limits))
    step = float(scan.delays[1] - scan.delays[0])
    peak = choose(scan, step, motion_period(scan))
    start = peak.delay
    inverted = is_inverted(scan)
    near = x.known(t - start - _ROAM * step) & x.known(t - start + _ROAM * step)
    if near.sum() < FEWEST_SHARED:
        raise LogError(
            f"{int(near.sum())} samples overlap at a delay of {1e3 * start:.1f} ms, {FEWEST_SHARED} are needed"
        )
    return _refine(t[near], y[near], x, peak, step, inverted)


def refit(t: FloatArray, y: FloatArray, x: Reference, near: float, step: float) -> float | None:
    """The delay in the same valley, with another curve for x [s]; None where too little overlaps, or it has none.

    Args:
        t: times of y [s], shape (T,).
        y: values, shape (T,).
        x: what it is held against.
        near: delay to begin with [s].
        step: how far a step may go [s].
    """
    inside = x.known(t - near - _ROAM * step) & x.known(t - near + _ROAM * step)
    if inside.sum() < FEWEST_SHARED:
        return None
    found = _refine(t[inside], y[inside], x, Peak(near), step, inverted=False)
    return None if found.at_edge else found.delay


def _refine(t: FloatArray, y: FloatArray, x: Reference, peak: Peak, step: float, inverted: bool) -> Fitted:
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

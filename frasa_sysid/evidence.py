r"""What the logs say about each number: intervals, correlations, a verdict and what to record next.

The cluster-robust covariance, clustered by log, in its jackknife form (CR3; Bell and McCaffrey
2002): with the Jacobian J_l of log l, weights W_l of the robust loss and gradients
g_l = J_l^T W_l r_l, leaving log l out moves the fit by

.. math::
    d_l = (A - A_l)^{-1} g_l, \quad A_l = J_l^T W_l J_l, \quad A = \sum_l A_l, \qquad
    \Sigma = \frac{L - 1}{L} \sum_l (d_l - \bar d)(d_l - \bar d)^T

With as few logs as a bench gives, the plain sandwich :math:`A^{-1} B A^{-1}` is too narrow, because
every log has pulled the fit towards itself; the jackknife knows that. Samples of one log are
anything but independent, so counting them one by one would make intervals several times too narrow.
Slopes are those over an ensemble that raises the cost by a few per cent (`ensemble`): where the cost is
rough, difference quotients at one point are steeper than what the logs can tell, and intervals too narrow.
With few logs B cannot have full rank; then the spread of the residuals with one effective sample
per `CORRELATION_TIME` is used where it is larger.
Of logs in pieces (`shooting`) the :math:`A_l` and :math:`g_l` are sums over the pieces of log l; only
where there is one log its pieces stand for logs, and intervals are too narrow by what they share.
Beside it stands a bootstrap over logs (`resampling`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.free_parameter import FreeParameter
from frasa_sysid.linearised import even_spread, linearise
from frasa_sysid.pieces import independent
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.resampling import Profile, leave_one_out, one_step_bootstrap, profile_likelihoods, worst_pairs

IDENTIFIED, ROUGH, ON_BOUND = "identified", "known roughly", "on its bound"
_BOX_VARIANCE = 1.0 / 12.0  # of a number about which only the bounds are known, in the unit cube
_ON_BOUND = 1e-3  # of the unit cube
_VAGUE = 0.25  # half-width of an interval, as a share of the bounds, that says next to nothing
_RELATIVE = 0.5  # half-width relative to the value from which on next to nothing is known
_FINE = 0.03  # half-width relative to the value up to which it is identified ...
_FINE_ABSOLUTE = 0.01  # ... or relative to the bounds, of what has no scale or is as good as absent
_TOGETHER = 0.95  # correlation beyond which only a combination is known

# Numbers for which "half of the value" is no scale: they are zero as often as not.
_UNSCALED = frozenset(
    (
        "offset",
        "delay",
        "damping_off",
        "sag",
        "follow",
        "punch",
        "dead_zone",
        "bias",
        "loop_lag",
        "drag",
        "stribeck",
        "load_motor",
        "load_external",
        "load_motor_stribeck",
        "load_external_stribeck",
        "quad_motor",
        "quad_external",
    )
)

# Those whose errors count as such, in seconds and radians.
_ABSOLUTE = frozenset(("offset", "delay", "loop_lag", "dead_zone", "punch"))

RECORD = {
    "kp": "heavier loads at the lowest gain, held still at the horizontal (up_and_down)",
    "forcerange": "large fast steps at the highest gain, so that the duty saturates (sin_time_square to the end)",
    "damping": "fast motion with the motor powered (sin_time_square)",
    "damping_off": "a drop with the torque switched off (lift_and_drop)",
    "frictionloss": "slow motion with reversals under a small load (up_and_down)",
    "armature": "fast reversals with the smallest load (sin_time_square)",
    "delay": "quick goal changes (sin_time_square or steps), sampled at 100 Hz or more",
    "offset": "the arm moved to both sides of the vertical (sin_sin)",
    "stribeck": "slow motion through standstill at several speeds (sin_sin)",
    "stribeck_speed": "slow motion at several speeds between 0.1 and 3 rad/s (sin_sin, up_and_down)",
    "stribeck_exponent": "slow motion at several speeds between 0.1 and 3 rad/s (sin_sin, up_and_down)",
    "load_motor": "the same motions with a second load, at least a third heavier or lighter",
    "load_external": "lowering and holding a heavy load (up_and_down), so that the load drives the motor",
    "load_motor_stribeck": "slow lifting of two loads (up_and_down)",
    "load_external_stribeck": "slow lowering of two loads (up_and_down, sin_sin)",
    "quad_motor": "slow lifting of the heaviest load the servo can hold",
    "quad_external": "slow lifting of the heaviest load the servo can hold",
    "sag": "the highest gain with the heaviest load, with the supply voltage logged at every cycle",
    "follow": "the supply voltage at every cycle, under changing load",
    "goal_speed": "a step of the goal by 1 rad or more",
    "punch": "small steps of the goal, of 2 to 20 mrad, at the lowest gain",
    "dead_zone": "small steps of the goal, of 2 to 20 mrad, at the lowest gain",
    "collapse_at": "steps of the goal of growing size, at the highest gain",
    "collapse_to": "steps of the goal of growing size, at the highest gain",
    "loop_lag": "the same fast motion (sin_time_square) at a high and a low gain",
    "drag": "fast motion at several speeds up to the servo's own (sin_time_square, steps)",
    "bias": "the same motion in both directions",
}


@dataclass(frozen=True)
class Estimate:
    """What is known about one parameter.

    Attributes:
        name, unit: as in the problem.
        value, nominal: fitted and before.
        low, high: 95 % interval, inside the bounds.
        verdict: `identified` (to 3 %), `known roughly`, `only in combination with ...`, `not excited` or
            `on its bound`.
        advice: which recording would help; empty when identified.
    """

    name: str
    unit: str
    value: float
    nominal: float
    low: float
    high: float
    verdict: str
    advice: str

    @property
    def excited(self) -> bool:
        """False where the logs say next to nothing."""
        return not self.verdict.startswith("not excited")


@dataclass(frozen=True)
class Evidence:
    """Estimates of all free parameters and how they move together.

    Attributes:
        estimates: n of them, in the order of the problem.
        correlation: shape (n, n).
        bootstrap: 95 % interval of each parameter over resampled logs, (n, 2); see `resampling`.
        profiles: of the parameters in the worst-correlated pairs.
        spread: smallest and largest value when each rig-and-gain group in turn is left out, (n, 2).
    """

    estimates: tuple[Estimate, ...]
    correlation: FloatArray
    spread: FloatArray
    bootstrap: FloatArray
    profiles: tuple[Profile, ...] = ()


def evidence(problem: FitProblem, kernel: BenchKernel, values: FloatArray) -> Evidence:
    """Intervals and verdicts at a fitted point.

    Args:
        problem: what was fitted; its training runs are the evidence.
        kernel: simulates them, about 9 n times.
        values: fitted values, shape (n,).
    """
    x = problem.to_unit(values)
    found = linearise(problem, kernel, x, even_spread(problem, kernel, x))
    logs, spread = independent(problem.train), found.spread
    curvatures, gradients = _summed(found.curvatures, logs), _summed(found.gradients, logs)
    A = np.sum(curvatures, axis=0)
    inverse, silent = _inverse(A, spread)
    covariance = _covariance(inverse, silent, leave_one_out(A, silent, curvatures, gradients), spread)
    quantile = float(stats.t.ppf(0.975, max(len(logs) - 1, 1)))
    half = quantile * np.sqrt(np.diag(covariance))
    correlation = _correlation(covariance)
    # How wide each interval would be if all the other numbers were known.
    alone = np.minimum(half, quantile * np.sqrt(_noise(A, spread) / np.maximum(np.diag(A), 1e-300)))
    estimates = tuple(_estimate(problem, i, x, half[i], alone[i], correlation[i]) for i in range(len(problem.free)))
    spread_of_groups = _leave_out_spread(problem, x, inverse, found.gradients)
    draws = one_step_bootstrap(x, curvatures, gradients, inverse, silent, problem.seed)
    limits = np.quantile(draws, (0.025, 0.975), axis=0)
    interval = np.column_stack([problem.from_unit(limits[0]), problem.from_unit(limits[1])])
    pairs = worst_pairs(correlation, half)
    profiles = profile_likelihoods(problem, kernel, x, A, half, pairs)
    return Evidence(estimates, correlation, spread_of_groups, interval, profiles)


def _summed(parts: Sequence[FloatArray], logs: Sequence[Sequence[int]]) -> list[FloatArray]:
    """What runs contribute, summed over those of each log."""
    return [np.sum([parts[i] for i in log], axis=0) for log in logs]


def _noise(A: FloatArray, spread: FloatArray) -> float:
    """Variance of an estimate along a direction of unit curvature [rad^2]."""
    return float(np.trace(spread) / max(np.trace(A), 1e-300))


def _inverse(A: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of the curvature along the directions the logs speak of, and a projector on those they do not.

    A direction is silent where the logs would leave a wider spread than the bounds already do.
    """
    eigenvalues, vectors = np.linalg.eigh(A)
    heard = eigenvalues * _BOX_VARIANCE > _noise(A, spread)
    inverse = (vectors[:, heard] / eigenvalues[heard]) @ vectors[:, heard].T
    return inverse, vectors[:, ~heard] @ vectors[:, ~heard].T


def _covariance(inverse: FloatArray, silent: FloatArray, steps: FloatArray, spread: FloatArray) -> FloatArray:
    """Jackknife by log, or the spread of residuals with few effective samples where that is larger."""
    count = len(steps)
    centred = steps - steps.mean(axis=0)
    sandwich = centred.T @ centred * (count - 1) / count
    residual = inverse @ spread @ inverse
    # Scale up each parameter's row and column to the larger variance; correlations come from the larger trace.
    base = sandwich if np.trace(sandwich) >= np.trace(residual) else residual
    ratio = np.sqrt(np.maximum(np.diag(sandwich), np.diag(residual)) / np.maximum(np.diag(base), 1e-300))
    # Where the logs are silent anything in the cube is possible.
    return np.asarray(base * np.outer(ratio, ratio) + silent)


def _correlation(covariance: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation: FloatArray = np.clip(covariance / np.outer(scale, scale), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _estimate(
    problem: FitProblem, i: int, x: FloatArray, half: float, alone: float, correlation: FloatArray
) -> Estimate:
    free = problem.free[i]
    width = free.high - free.low
    value = free.low + x[i] * width
    verdict = _verdict(problem, i, x[i], half, alone, correlation)
    return Estimate(
        free.name,
        free.unit,
        value,
        free.nominal,
        max(free.low, value - half * width),
        min(free.high, value + half * width),
        verdict,
        "" if verdict == IDENTIFIED else f"record {RECORD[free.field]}",
    )


def widened(one: Estimate, free: FreeParameter, low: float, high: float) -> Estimate:
    """An estimate whose interval holds low and high too, with the verdict that then is true."""
    low, high = min(one.low, low), max(one.high, high)
    if one.verdict == IDENTIFIED and not _fine(free, one.value, (high - low) / 2.0):
        return replace(one, low=low, high=high, verdict=ROUGH, advice=f"record {RECORD[free.field]}")
    return replace(one, low=low, high=high)


def _verdict(problem: FitProblem, i: int, x: float, half: float, alone: float, correlation: FloatArray) -> str:
    free = problem.free[i]
    others = np.abs(np.where(np.arange(correlation.size) == i, 0.0, correlation))
    partner = problem.free[int(np.argmax(others))].name
    vague = half > _VAGUE or _too_wide(free, x, half)
    if vague and others.max() > _TOGETHER and alone < 0.5 * half:
        return f"only in combination with {partner}"
    if vague:
        return "not excited"
    if x < _ON_BOUND or x > 1.0 - _ON_BOUND:
        return ON_BOUND
    width = free.high - free.low
    return IDENTIFIED if _fine(free, free.low + x * width, half * width) else ROUGH


def _fine(free: FreeParameter, value: float, half: float) -> bool:
    """Whether a half-width [unit of the value] is small against the value or, without such a scale, the bounds."""
    if half <= _FINE * abs(value):
        return True
    absent = free.field in _UNSCALED and value - half <= max(free.low, 0.0)
    return (free.field in _ABSOLUTE or absent) and half <= _FINE_ABSOLUTE * (free.high - free.low)


def _too_wide(free: FreeParameter, x: float, half: float) -> bool:
    """Whether the interval is wide against the value itself; offsets and delays have no such scale."""
    if free.field in _UNSCALED:
        return False
    value = free.low + x * (free.high - free.low)
    return half * (free.high - free.low) > _RELATIVE * abs(value)


def _leave_out_spread(
    problem: FitProblem, x: FloatArray, inverse: FloatArray, gradients: Sequence[FloatArray]
) -> FloatArray:
    """Range of one-step estimates when each group is left out (infinitesimal jackknife), shape (n, 2)."""
    total = np.sum(gradients, axis=0)
    estimates = [x]
    for group in sorted({run.group for run in problem.train}):
        left = [g for run, g in zip(problem.train, gradients, strict=True) if run.group == group]
        if len(left) < len(gradients):
            estimates.append(x + inverse @ (np.sum(left, axis=0) - total / len(gradients) * len(left)))
    values = np.array([problem.from_unit(estimate) for estimate in estimates])
    return np.column_stack([values.min(axis=0), values.max(axis=0)])

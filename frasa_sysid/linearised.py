"""The logs around a fit as straight lines: residual, slopes, curvature and gradient of every run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.cost import residuals, robust_weights
from frasa_sysid.ensemble import differences, ensemble, regression, spread_at
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.shooting import without_starts

CORRELATION_TIME = 0.25  # [s] over which residuals of one log are taken as one sample
_SHARE = 0.03  # of the cost, by which the first ensemble raises it


@dataclass(frozen=True)
class Linearised:
    """What each of L runs says about n numbers, in the unit cube.

    Attributes:
        curvatures: J_l^T W_l J_l of each, every run with equal weight, (n, n).
        gradients: J_l^T W_l r_l of each, (n,).
        spread: covariance of the summed gradient from the residuals' own size, one sample per
            `CORRELATION_TIME`, (n, n).
    """

    curvatures: list[FloatArray]
    gradients: list[FloatArray]
    spread: FloatArray


def even_spread(problem: FitProblem, kernel: BenchKernel, x: FloatArray) -> FloatArray:
    """Covariance of an ensemble that raises the cost by a small share, (n, n).

    Args:
        problem: maps points to candidates.
        kernel: simulates its training runs.
        x: a point of the unit cube, shape (n,).
    """

    def rooted(points: FloatArray) -> FloatArray:
        return kernel.rooted(problem.candidates(points), problem.offsets(points, kernel.runs))

    base, J = differences(rooted, x)
    damping = max(_SHARE * float(base @ base) / x.size, 1e-300)
    # Differences may measure the roughness; the slopes over an ensemble do not, and give the one that counts.
    points = np.clip(x + ensemble(spread_at(J @ J.T, damping), np.random.default_rng((problem.seed, 19))), 0.0, 1.0)
    J = regression(points - x, rooted(points))[1]
    return spread_at(J @ J.T, damping)


def linearise(problem: FitProblem, kernel: BenchKernel, x: FloatArray, covariance: FloatArray) -> Linearised:
    """Lines through an ensemble around a point.

    Args:
        problem: maps points to candidates.
        kernel: simulates its training runs.
        x: a point of the unit cube, shape (n,).
        covariance: of the ensemble, (n, n).
    """
    rng = np.random.default_rng((problem.seed, 17))
    points = np.clip(x + ensemble(covariance, rng), 0.0, 1.0)
    rows = _completed(kernel.readings(problem.candidates(points), problem.offsets(points, kernel.runs)))
    mean, slopes = regression(points - x, rows)
    parts = [np.nan_to_num(part) for part in residuals(problem.train, kernel.split(mean))]
    jacobians = without_starts(problem, kernel, x, [np.array(J.T) for J in _split(kernel, slopes)])
    return Linearised(
        [_curvature(part, jacobian) for part, jacobian in zip(parts, jacobians, strict=True)],
        [_gradient(part, jacobian) for part, jacobian in zip(parts, jacobians, strict=True)],
        _residual_spread(problem.train, parts, jacobians),
    )


def _completed(rows: FloatArray) -> FloatArray:
    """Readings (k, T) with those of simulations that diverged replaced by the others' mean."""
    sound = np.isfinite(rows)
    if sound.all():
        return rows
    mean = np.where(sound, rows, 0.0).sum(axis=0) / np.maximum(sound.sum(axis=0), 1)
    return np.asarray(np.where(sound, rows, mean))


def _split(kernel: BenchKernel, slopes: FloatArray) -> list[FloatArray]:
    """Slopes (n, T) of each run."""
    by_number = [kernel.split(row) for row in slopes]
    return [np.array([one[r] for one in by_number]) for r in range(len(kernel.runs))]


def _gradient(part: FloatArray, jacobian: FloatArray) -> FloatArray:
    """One run's share of the gradient, every run with equal weight, (n,)."""
    return np.asarray((jacobian * (robust_weights(part) / part.size)[:, None]).T @ part)


def _curvature(part: FloatArray, jacobian: FloatArray) -> FloatArray:
    """One run's share of the curvature, (n, n)."""
    weighted = jacobian * (robust_weights(part) / part.size)[:, None]
    return np.asarray(weighted.T @ jacobian)


def _residual_spread(
    runs: Sequence[BenchRun], parts: Sequence[FloatArray], jacobians: Sequence[FloatArray]
) -> FloatArray:
    """Covariance of the gradient from the residuals' own size, one sample per `CORRELATION_TIME`, (n, n)."""
    spread = np.zeros((jacobians[0].shape[1],) * 2)
    for run, part, jacobian in zip(runs, parts, jacobians, strict=True):
        samples = max(run.t[-1] / CORRELATION_TIME, 1.0)
        weights = robust_weights(part)
        slope = jacobian * weights[:, None]
        spread += slope.T @ slope / part.size * float(np.mean(weights * part**2)) / samples
    return spread

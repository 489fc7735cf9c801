r"""Least squares where the cost is rough: slopes from an ensemble of points, not from differences at one.

An arm that sticks in one place or in the next, and commands whose timing is known to the jitter only,
make the cost rough on a scale far below what the logs can tell; a difference quotient then measures
the roughness, and a descent stops in the first pit of a long valley. So residuals are simulated at
points :math:`x + L z_k` spread as widely as the logs hardly mind, and a straight line through them

.. math:: r(x + L z_k) \approx \bar r + J L z_k

gives the slopes J on that scale and the residual :math:`\bar r` without its roughness (statistical
linear regression, as in sigma-point filters; derivative-free Gauss-Newton, Cartis and Roberts 2019).
With the curvature :math:`A = J^T J` the spread is

.. math:: L L^T = (A / \lambda + 100 I)^{-1}, \qquad \lambda = \kappa |r|^2 / n

which raises the cost by the share :math:`\kappa` on average, and leaves nobody further than a tenth of
the cube. The share falls from stage to stage. On four simulated benches of law M4 this ended 0.8 to 5 %
lower in cost than differences did, from any start at the same numbers, and with the single friction
coefficients 1 % from the truth in place of 4 % (`tests/benchmarks/bench_coverage.py` has all of them).
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.finish import Finished
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray

SHARES = (0.3, 0.3, 0.1, 0.1, 0.03, 0.03, 0.01, 0.003)  # kappa of each stage
_POINTS = 4  # simulated for each number and stage
_WIDEST = 0.1  # of the unit cube, standard deviation of a number that the logs do not speak of
_NARROWEST = 1e-5  # of the unit cube
_STEP = 1e-3  # of the unit cube, for the first slopes
_LENGTHS = (1.0, 0.5, 0.25, 1.5, 2.0)  # of the Gauss-Newton step that are tried
Residuals = Callable[[FloatArray], FloatArray]


def settle(problem: FitProblem, kernel: BenchKernel, x: FloatArray, seed: int) -> Finished:
    """Walk down a rough valley from a point near its floor.

    Args:
        problem: maps points to candidates.
        kernel: simulates its runs.
        x: start, a point of the unit cube, shape (n,).
        seed: of the ensembles.

    Returns:
        The best point met, never worse than the start.
    """
    rng = np.random.default_rng((seed, 13))
    used = 0

    def rooted(points: FloatArray) -> FloatArray:
        nonlocal used
        used += len(points)
        return kernel.rooted(problem.candidates(points), problem.offsets(points, kernel.runs))

    base, J = differences(rooted, x)
    best = (float(base @ base), x, base)
    for share in SHARES:
        damping = share * float(base @ base) / x.size
        points = x + ensemble(spread_at(J @ J.T, damping), rng)
        points = np.clip(points, 0.0, 1.0)
        rows = rooted(points)
        mean, J = regression(points - x, rows)
        pinned = max(damping / _WIDEST**2, 1e-15 * float(np.trace(J @ J.T)), 1e-300)
        trials = _trials(x, J @ J.T + pinned * np.eye(x.size), J @ mean)
        met, costs = np.vstack([points, trials]), np.vstack([rows, rooted(trials)])
        squares = np.einsum("kt,kt->k", costs, costs)
        lowest = int(np.argmin(squares))
        if squares[lowest] < best[0]:
            best = (float(squares[lowest]), met[lowest], costs[lowest])
        # A step may climb out of a pit, by no more than the ensemble did; else on from the best.
        after = len(points) + int(np.argmin(squares[len(points) :]))
        x, base = (met[after], costs[after]) if squares[after] < (1.0 + share) * best[0] else best[1:]
    pair = np.array([best[1]])
    cost = float(kernel.costs(problem.candidates(pair), problem.offsets(pair, kernel.runs))[0])
    return Finished(best[1], cost, used + 1, True)


def spread_at(curvature: FloatArray, damping: float) -> FloatArray:
    """Covariance of an ensemble, (n, n), from the curvature of that shape and lambda of the cost."""
    # A perfect fit has no cost to share in: then nobody moves further than rounding asks for.
    least = max(1e-18 * float(np.trace(curvature)), 1e-300)
    return np.asarray(np.linalg.inv(curvature / max(damping, least) + np.eye(len(curvature)) / _WIDEST**2))


def ensemble(covariance: FloatArray, rng: Generator) -> FloatArray:
    """Pairs of opposite normal deviates, shape (4 n, n).

    Args:
        covariance: (n, n); a direction wider than a tenth of the cube or narrower than rounding is kept within.
        rng: of the deviates.
    """
    n = len(covariance)
    variances, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.clip(variances, _NARROWEST**2, _WIDEST**2))
    z = rng.standard_normal((_POINTS * n // 2, n))
    return np.asarray(np.vstack([z, -z]) @ root.T)


def regression(moves: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The straight line through an ensemble.

    Args:
        moves: of the points from the centre, shape (k, n).
        rows: what was simulated there, shape (k, T).

    Returns:
        The line's value at the centre, (T,), and its slopes, (n, T).
    """
    # A number on its bound may not move at all: it then has no slope, instead of an endless one.
    line = np.linalg.pinv(np.column_stack([np.ones(len(moves)), moves]), rcond=1e-9) @ rows
    return line[0], line[1:]


def differences(simulate: Residuals, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is simulated at one point, (T,), and slopes there, (n, T): good enough to spread a first ensemble."""
    steps = np.where(x > 0.5, -_STEP, _STEP)
    rows = simulate(np.vstack([x, x + np.diag(steps)]))
    return rows[0], (rows[1:] - rows[0]) / steps[:, None]


def _trials(x: FloatArray, A: FloatArray, gradient: FloatArray) -> FloatArray:
    """Gauss-Newton steps of several lengths inside the cube, (m, n); numbers pushed out of it stay where they are."""
    moving = np.ones(x.size, bool)
    step = np.zeros(x.size)
    for _ in range(x.size):
        step = np.zeros(x.size)
        step[moving] = -np.linalg.solve(A[np.ix_(moving, moving)], gradient[moving])
        out = moving & (((x <= 0.0) & (step < 0.0)) | ((x >= 1.0) & (step > 0.0)))
        if not out.any():
            break
        moving &= ~out
        if not moving.any():
            return x[None].copy()
    return np.clip(x + np.outer(_LENGTHS, step), 0.0, 1.0)

r"""Two other looks at the same uncertainty: a bootstrap over logs, and profile likelihoods.

The bootstrap draws logs with replacement (Efron 1979; whole logs, as samples of one log are
not independent) and takes one Gauss-Newton step from the fit for each draw: with the
curvature :math:`A_l` and the gradient :math:`g_l` of log l and its count :math:`w_l`,

.. math:: x^* = x - (\sum_l w_l A_l)^{-1} \sum_l w_l g_l

It costs no simulation. `full_bootstrap` in `bootstrap.py` fits every draw anew.

A profile holds one number at several values and fits all others anew; where a pair of
numbers hardly differs in what it does, it shows what the quadratic picture hides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.cost import ROBUST_WIDTH
from frasa_sysid.finish import finish
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray

DRAWS = 1000
PAIRS = 3  # worst-correlated pairs that are profiled
_STRONG = 0.9  # correlation from which on a pair is worth it
_GRID = (-1.5, -1.0, 1.0, 1.5)  # of the half-width of the interval
_ITERATIONS = 4


@dataclass(frozen=True)
class Profile:
    """How the cost rises when one number is held away from the fit and all others follow.

    Attributes:
        name: of the parameter.
        partner: the one it is most correlated with.
        values: at which it was held, in its unit, rising, the fit itself included.
        rise: of the cost over the fit's, at each value [rad].
        low, high: where the rise reaches what the interval's own end would give if all were
            quadratic; None beyond the grid or the bounds.
    """

    name: str
    partner: str
    values: tuple[float, ...]
    rise: tuple[float, ...]
    low: float | None
    high: float | None


def one_step_bootstrap(
    x: FloatArray,
    curvatures: Sequence[FloatArray],
    gradients: Sequence[FloatArray],
    inverse: FloatArray,
    silent: FloatArray,
    seed: int,
) -> FloatArray:
    """Points of the unit cube for resampled logs, shape (draws, n).

    Args:
        x: the fit, shape (n,).
        curvatures: of each log, (n, n).
        gradients: of each log, (n,).
        inverse: of the summed curvature, where the logs are silent left out, (n, n).
        silent: projector on the directions that no log speaks of, (n, n).
        seed: of the draws.
    """
    rng = np.random.default_rng((seed, 7))
    count = len(gradients)
    counts = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS).astype(np.float64)
    stacked, slopes = np.array(curvatures), np.array(gradients)
    slopes = slopes - slopes.mean(axis=0)  # at the fit they cancel, up to what the finisher left
    keep = np.eye(x.size) - silent
    points = np.empty((DRAWS, x.size))
    for i, weights in enumerate(counts):
        A = keep @ np.tensordot(weights, stacked, 1) @ keep + silent
        # A draw may hold too few logs to say anything along some direction: the fit's own inverse then.
        usable = np.linalg.cond(A) < 1e14
        step = np.linalg.solve(A, weights @ slopes) if usable else inverse @ (weights @ slopes)
        points[i] = x - keep @ step
    return np.clip(points, 0.0, 1.0)


def leave_one_out(
    A: FloatArray, silent: FloatArray, curvatures: Sequence[FloatArray], gradients: Sequence[FloatArray]
) -> FloatArray:
    """How the fit moves in the unit cube when each log in turn is left out, one Gauss-Newton step, (L, n).

    Args:
        A: summed curvature, (n, n).
        silent: projector on the directions that no log speaks of, (n, n).
        curvatures: of each log, (n, n).
        gradients: of each log, (n,).
    """
    keep = np.eye(len(A)) - silent
    pinned = keep @ A @ keep
    steps = []
    for own, slope in zip(curvatures, gradients, strict=True):
        rest = pinned - keep @ own @ keep + silent
        # Where one log alone carries a direction nothing is left without it: then the fit's own curvature.
        usable = np.linalg.cond(rest) < 1e14
        steps.append(keep @ np.linalg.solve(rest if usable else pinned + silent, keep @ slope))
    return np.array(steps)


def worst_pairs(correlation: FloatArray, half: FloatArray) -> list[tuple[int, int]]:
    """Indices of the most correlated pairs of parameters, at most `PAIRS`, those of no use left out."""
    n = len(half)
    pairs = [(abs(correlation[i, j]), i, j) for i in range(n) for j in range(i) if half[i] < 1.0 and half[j] < 1.0]
    return [(i, j) for strength, i, j in sorted(pairs, reverse=True)[:PAIRS] if strength > _STRONG]


def profile_likelihoods(
    problem: FitProblem,
    kernel: BenchKernel,
    x: FloatArray,
    A: FloatArray,
    half: FloatArray,
    pairs: Sequence[tuple[int, int]],
) -> tuple[Profile, ...]:
    """Profiles of the parameters in some pairs.

    Args:
        problem: what was fitted.
        kernel: its training runs.
        x: the fit, shape (n,).
        A: curvature at the fit, (n, n).
        half: half-widths of the intervals in the unit cube, (n,).
        pairs: indices of two parameters each.
    """
    partners: dict[int, int] = {}
    for i, j in pairs:
        partners.setdefault(i, j)
        partners.setdefault(j, i)
    base = _cost(problem, kernel, x)
    covariance = np.asarray(np.linalg.pinv(A), dtype=np.float64)
    found = []
    for i, partner in sorted(partners.items()):
        shifts = [shift * half[i] for shift in _GRID if 0.0 <= x[i] + shift * half[i] <= 1.0]
        rises = [_held_cost(problem, kernel, x, covariance, i, shift) - base for shift in shifts]
        # A is the curvature of the summed cost; the cost itself is its mean over runs, in widths.
        order = np.argsort([*shifts, 0.0])
        places, costs = np.array([*shifts, 0.0])[order], np.array([*rises, 0.0])[order]
        limit = _quadratic_limit(kernel, covariance, i, half[i])
        low, high = _crossing(places, costs, limit, -1), _crossing(places, costs, limit, 1)
        values = [float(problem.from_unit(_moved(x, i, place))[i]) for place in places]
        found.append(
            Profile(
                problem.free[i].name,
                problem.free[partner].name,
                tuple(values),
                tuple(float(cost) for cost in costs),
                None if low is None else float(problem.from_unit(_moved(x, i, low))[i]),
                None if high is None else float(problem.from_unit(_moved(x, i, high))[i]),
            )
        )
    return tuple(found)


def _quadratic_limit(kernel: BenchKernel, covariance: FloatArray, i: int, half: float) -> float:
    """Rise of the cost [rad] at the end of the interval if the cost were quadratic."""
    return float(0.5 * half**2 / max(covariance[i, i], 1e-300) / len(kernel.runs) / ROBUST_WIDTH)


def _held_cost(
    problem: FitProblem, kernel: BenchKernel, x: FloatArray, covariance: FloatArray, i: int, shift: float
) -> float:
    """Lowest cost [rad] found with number i held at x_i + shift; the others start where a quadratic puts them."""
    direction = covariance[:, i] / max(covariance[i, i], 1e-300)
    start = np.clip(x + shift * direction, 0.0, 1.0)
    start[i] = x[i] + shift
    held = np.arange(x.size) == i
    return finish(problem, kernel, start, _ITERATIONS, held).cost


def _cost(problem: FitProblem, kernel: BenchKernel, x: FloatArray) -> float:
    return float(kernel.costs(problem.candidates(x[None]), problem.offsets(x[None], kernel.runs))[0])


def _moved(x: FloatArray, i: int, shift: float) -> FloatArray:
    return np.asarray(np.where(np.arange(x.size) == i, x + shift, x))


def _crossing(places: FloatArray, costs: FloatArray, limit: float, side: int) -> float | None:
    """Where the cost first passes the limit going out from the fit on one side; None if it does not."""
    outwards = [(abs(p), p, c) for p, c in zip(places, costs, strict=True) if p * side >= 0.0]
    before = (0.0, 0.0)
    for _, place, cost in sorted(outwards):
        if cost > limit:
            share = (limit - before[1]) / max(cost - before[1], 1e-300)
            return float(before[0] + share * (place - before[0]))
        before = (place, cost)
    return None

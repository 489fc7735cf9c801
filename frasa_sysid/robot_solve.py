r"""Damped Gauss-Newton for a robot's numbers, and what the log says about each.

Minimised is, over residuals r in noise units s with the pseudo-Huber loss :math:`\rho`, thinned to one
sample per correlation time, and the weak prior of `robot_problem`,

.. math:: \sum_i \rho(r_i / s_i) / k_i + \tfrac12 \sum_j (x_j - x_{0j})^2 / p_j^2

The covariance is cluster-robust, clustered by second and joint (sandwich; Liang and Zeger 1986), and at
least the inverse curvature. Derivatives are differences over steps that are wide against the roughness that
sticking joints give the cost (`robot_problem.Kind`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_problem import RobotProblem
from frasa_sysid.robot_residuals import Layout, noise_units
from frasa_sysid.robot_stack import Stack
from frasa_sysid.robot_trail import Place, Trail

ITERATIONS = 12
_HUBER = 3.0  # noise units beyond which a residual counts as model error
_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step that are tried
_BOLD = 2  # of them are tried at once, the others only where those do not help
_WORTHWHILE = 0.2  # relative gain in cost below which slopes are computed anew
_ENOUGH = 1e-3  # relative gain in cost below which it ends
_POLISH = 4  # steps at most with the slopes of the end
_ROUGHLY = 2e-2  # likewise, of a fit that another one goes on from
_SETTLED_UNITS = 6  # iterations in which noise units follow the residuals
_DAMPING = 1e-3  # of the curvature's diagonal
_WIDER = 1.5  # of intervals: joints that stick repeat an error for longer than a second (virtual robots)
Tell = Callable[[str, int, float], None]


@dataclass(frozen=True)
class Linear:
    """Residuals and slopes at a point.

    Attributes:
        x: the point, (n,).
        residuals: (R,).
        slopes: (n, R).
        units: noise unit of each group.
        weights: of each residual, its noise unit, thinning and robust weight included, (R,).
        layout: of the residuals.
    """

    x: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    units: FloatArray
    weights: FloatArray
    layout: Layout


@dataclass(frozen=True)
class Settled:
    """Where the fit ended.

    Attributes:
        x: (n,).
        linear: residuals and slopes there.
        cost: as minimised.
        iterations, evaluations: Gauss-Newton steps and robots simulated.
        converged: False when it ran out of iterations.
    """

    x: FloatArray
    linear: Linear
    cost: float
    iterations: int
    evaluations: int
    converged: bool


def settle_robot(
    problem: RobotProblem,
    stack: Stack,
    start: FloatArray | None = None,
    tell: Tell = lambda stage, count, best: None,
    trail: Trail | None = None,
    stage: str = "all",
    weigh: bool = True,
    near: bool = False,
) -> Settled:
    """Fit the free numbers.

    Args:
        problem: n numbers.
        stack: residuals.
        start: where to begin, (n,); by default the problem's own.
        tell: told (stage, robots simulated, cost).
        trail: what an earlier run did, and what this one does.
        stage: of the trail.
        weigh: end with slopes that intervals can be had from; without, they are those of the last steps.
        near: the start is where a fit to a part of the log ended, from where it is not far.
    """
    trail = trail or Trail()
    at = trail.enter(stage, problem.start() if start is None else start)
    if not at.weighing:
        linear, at = _steps(problem, stack, at, tell, trail, weigh, near)
        if not weigh:
            return Settled(linear.x, linear, at.cost_before, at.iteration, at.used, at.converged)
        trail.mark(at)
    tell("weighing the evidence", at.used, at.cost_before)
    linear = linearise_robot(problem, stack, np.array(at.x))
    used, cost = at.used + 2 * linear.x.size + 1, at.cost_before
    for _ in range(_POLISH):
        before = _cost(problem, stack.layout, linear.residuals, linear.units, linear.x)
        linear, cost, count = _moved(problem, stack, linear, before, _SHARES[:_BOLD], trail, learn=False)
        used += count
        if before - cost < _ENOUGH * before:
            break
    return Settled(linear.x, linear, float(cost), at.iteration, used, at.converged)


def _steps(
    problem: RobotProblem, stack: Stack, at: Place, tell: Tell, trail: Trail, weigh: bool, near: bool
) -> tuple[Linear, Place]:
    """Steps from a place on until they are not worth it: the slopes they end with, and the place to weigh."""
    tell("slopes", at.used, at.cost_before)
    linear = linearise_robot(problem, stack, np.array(at.x), at.units_array, central=False)
    fresh, converged = True, False
    used, cost, iteration = at.used + linear.x.size + 1, at.cost_before, at.iteration
    for iteration in range(at.iteration, ITERATIONS + 1):
        before = _cost(problem, stack.layout, linear.residuals, linear.units, linear.x)
        moved, cost, count = _moved(problem, stack, linear, before, _SHARES if fresh else _SHARES[:_BOLD], trail)
        used += count
        gained = before - cost
        # Noise units that follow the residuals for ever would let the cost go round in circles.
        units = noise_units(moved.residuals, stack.layout) if iteration < _SETTLED_UNITS else linear.units
        linear = _weighted(moved.x, moved.residuals, moved.slopes, units, stack.layout)
        tell("steps", used, cost)
        # What is left is left to the slopes of the end where there was a fit before, or another one goes on.
        converged = gained < _ROUGHLY * before if near else fresh and gained < (_ENOUGH if weigh else _ROUGHLY) * before
        if converged:
            break
        # Slopes serve while they find descent; computing them costs ten times as much as a step.
        fresh = not near and gained < _WORTHWHILE * before
        if fresh:
            here, noise = tuple(linear.x.tolist()), tuple(linear.units.tolist())
            trail.mark(Place(at.stage, here, noise, iteration + 1, used, float(cost)))
            tell("slopes", used, cost)
            linear = linearise_robot(problem, stack, linear.x, linear.units, central=False)
            used += linear.x.size + 1
    x = tuple(linear.x.tolist())
    return linear, Place(at.stage, x, None, min(iteration, ITERATIONS), used, float(cost), True, converged)


def _moved(
    problem: RobotProblem,
    stack: Stack,
    linear: Linear,
    before: float,
    shares: Sequence[float],
    trail: Trail,
    learn: bool = True,
) -> tuple[Linear, float, int]:
    """The best point along a damped Gauss-Newton step, its cost, and how many robots were simulated for it.

    Args:
        problem: n numbers.
        stack: residuals.
        linear: where it is, and slopes.
        before: cost there.
        shares: of the step to try, the boldest first; later ones only where those do not help.
        trail: which of them an earlier run took.
        learn: mend the slopes by what the step showed (Broyden 1965).
    """
    A, g = normal_equations(problem, linear)
    step = -np.linalg.solve(A + _DAMPING * np.diag(np.diag(A)), g)
    trials = np.clip(linear.x + np.outer(shares, step), *problem.bounds())
    taken, row, cost, used = _tried(problem, stack, linear, before, trials, trail)
    if taken < 0:
        return linear, before, used
    slopes, moved = linear.slopes, trials[taken] - linear.x
    if learn:
        way = moved * np.diag(A)  # in units of what the log can tell
        slopes = slopes + np.outer(way, row - linear.residuals - moved @ slopes) / (way @ moved)
    return _weighted(trials[taken], row, slopes, linear.units, stack.layout), cost, used


def _tried(
    problem: RobotProblem, stack: Stack, linear: Linear, before: float, trials: FloatArray, trail: Trail
) -> tuple[int, FloatArray, float, int]:
    """Which of the points (m, n) is taken, -1 for none; residuals (R,) and cost there, and robots simulated."""

    def costs(points: FloatArray) -> tuple[FloatArray, list[float]]:
        rows = stack.residuals(problem, points, linear.x)
        return rows, [_cost(problem, stack.layout, r, linear.units, x) for r, x in zip(rows, points, strict=True)]

    known = trail.known()
    if known is not None:
        taken, used = known
        if not 0 <= taken < len(trials):
            return -1, linear.residuals, before, used
        rows, found = costs(trials[[taken]])
        return taken, rows[0], found[0], used
    used = 0
    for first, some in ((0, trials[:_BOLD]), (_BOLD, trials[_BOLD:])):
        if len(some):
            rows, found = costs(some)
            used += len(some)
            best = int(np.argmin(found))
            if found[best] < before:
                trail.moved(first + best, used)
                return first + best, rows[best], found[best], used
    trail.moved(-1, used)
    return -1, linear.residuals, before, used


def linearise_robot(
    problem: RobotProblem, stack: Stack, x: FloatArray, units: FloatArray | None = None, central: bool = True
) -> Linear:
    """Residuals and slopes at a point (n,): central where the bounds allow, or to one side at half the price.

    Noise units (groups,) are those given, else what the residuals show.
    """
    low, high = problem.bounds()
    steps = np.array([one.kind.step for one in problem.free])
    up = np.where(x + steps <= high, x + steps, x - steps)
    down = np.clip(2.0 * x - up, low, high) if central else x
    own = np.eye(x.size, dtype=bool)
    points = np.vstack([x, np.where(own, up, x), *([np.where(own, down, x)] if central else [])])
    rows = stack.residuals(problem, points, x)
    below = rows[1 + x.size :] if central else rows[0]
    slopes = (rows[1 : 1 + x.size] - below) / (up - down)[:, None]
    units = noise_units(rows[0], stack.layout) if units is None else units
    return _weighted(x, rows[0], slopes, units, stack.layout)


def _weighted(x: FloatArray, residuals: FloatArray, slopes: FloatArray, units: FloatArray, layout: Layout) -> Linear:
    scale = units[layout.column]
    robust = 1.0 / np.sqrt(1.0 + (residuals / scale / _HUBER) ** 2)
    return Linear(x, residuals, slopes, units, robust / scale**2 / layout.thinning[layout.column], layout)


def normal_equations(problem: RobotProblem, linear: Linear) -> tuple[FloatArray, FloatArray]:
    """Curvature (n, n) and gradient (n,), the prior included."""
    weighted = linear.slopes * linear.weights
    precision = 1.0 / np.array([one.kind.prior for one in problem.free]) ** 2
    A = weighted @ linear.slopes.T + np.diag(precision)
    return A, weighted @ linear.residuals + precision * (linear.x - problem.start())


def covariance_of(problem: RobotProblem, linear: Linear) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance by the logs alone, with what the model gets wrong, (n, n) each, and half-widths at 95 %, (n,)."""
    A, _ = normal_equations(problem, linear)
    inverse = np.linalg.inv(A)
    count = int(linear.layout.cluster.max()) + 1
    pulls = linear.slopes * (linear.weights * linear.residuals)
    scores = np.array([np.bincount(linear.layout.cluster, row, count) for row in pulls])
    scores -= scores.mean(axis=1, keepdims=True)
    sandwich = inverse @ (scores @ scores.T * count / max(count - 1, 1)) @ inverse
    # Neither may be narrower than the other says; correlations are those of the wider one.
    base = sandwich if np.trace(sandwich / np.diag(inverse)) > len(A) else inverse
    ratio = np.sqrt(np.maximum(np.diag(sandwich), np.diag(inverse)) / np.diag(base))
    logged = base * np.outer(ratio, ratio) * _WIDER**2
    covariance = logged + _model_error(problem, A)
    seconds = max(len({int(one) for one in linear.layout.cluster}) // max(len(linear.layout.names), 1), 2)
    quantile = float(stats.t.ppf(0.975, max(seconds - 1, 2)))
    return logged, covariance, quantile * np.sqrt(np.diag(covariance))


def _model_error(problem: RobotProblem, A: FloatArray) -> FloatArray:
    """What the numbers that the model cannot be trusted with more closely do to all, (n, n)."""
    total = np.zeros_like(A)
    for i, one in enumerate(problem.free):
        if one.kind.trust:
            others = np.arange(len(A)) != i
            shift = np.full(len(A), one.kind.trust)
            shift[others] = -np.linalg.solve(A[np.ix_(others, others)], A[others, i]) * one.kind.trust
            total += np.outer(shift, shift)
    return total


def _cost(problem: RobotProblem, layout: Layout, residuals: FloatArray, units: FloatArray, x: FloatArray) -> float:
    scaled = residuals / units[layout.column] / _HUBER
    loss = _HUBER**2 * (np.sqrt(1.0 + scaled**2) - 1.0) / layout.thinning[layout.column]
    prior = np.array([one.kind.prior for one in problem.free])
    return float(loss.sum() + 0.5 * np.sum(((x - problem.start()) / prior) ** 2))

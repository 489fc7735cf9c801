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
from frasa_sysid.robot_residuals import Comparison, Layout, noise_units

ITERATIONS = 12
_HUBER = 3.0  # noise units beyond which a residual counts as model error
_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step that are tried
_ENOUGH = 1e-3  # relative gain in cost below which it ends
_SETTLED_UNITS = 3  # iterations in which noise units follow the residuals
_DAMPING = 1e-3  # of the curvature's diagonal
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


class Stack:
    """Several comparisons (a held robot and one on the ground) as one."""

    def __init__(self, comparisons: Sequence[Comparison]) -> None:
        self._parts = list(comparisons)
        columns, clusters, names = [], [], []
        groups = owners = 0
        for part in self._parts:
            columns.append(part.layout.column + groups)
            clusters.append(part.layout.cluster + owners)
            names += [f"{part.simulator.base} {name}" for name in part.layout.names]
            groups, owners = len(names), owners + int(part.layout.cluster.max()) + 1
        self.layout = Layout(
            np.concatenate(columns),
            np.concatenate(clusters),
            tuple(names),
            np.concatenate([part.layout.floors for part in self._parts]),
            np.concatenate([part.layout.thinning for part in self._parts]),
        )

    def residuals(self, problem: RobotProblem, points: FloatArray, centre: FloatArray) -> FloatArray:
        """Residuals of points (m, n), pieces started as the centre (n,) has it: (m, R)."""
        candidates = [problem.candidate(x) for x in points]
        return np.hstack([part.residuals(candidates, problem.candidate(centre)) for part in self._parts])


def settle_robot(
    problem: RobotProblem,
    stack: Stack,
    start: FloatArray | None = None,
    tell: Tell = lambda stage, count, best: None,
    keep: Callable[[FloatArray, int], None] = lambda x, iteration: None,
) -> Settled:
    """Fit the free numbers.

    Args:
        problem: n numbers.
        stack: residuals.
        start: where to begin, (n,); by default the problem's own.
        tell: told (stage, robots simulated, cost).
        keep: told the point after each step, to resume from.
    """
    x = problem.start() if start is None else start
    low, high = problem.bounds()
    used, cost, converged = 0, np.inf, False
    units: FloatArray | None = None
    iteration = 0
    for iteration in range(1, ITERATIONS + 1):
        tell("slopes", used, cost)
        linear = linearise_robot(problem, stack, x, units, central=False)
        # Noise units that follow the residuals for ever would let the cost go round in circles.
        units = linear.units if iteration >= _SETTLED_UNITS else None
        A, g = normal_equations(problem, linear)
        step = -np.linalg.solve(A + _DAMPING * np.diag(np.diag(A)), g)
        trials = np.clip(x + np.outer(_SHARES, step), low, high)
        costs = [_cost(problem, stack.layout, r, linear.units, t)
                 for r, t in zip(stack.residuals(problem, trials, x), trials, strict=True)]  # fmt: skip
        before = _cost(problem, stack.layout, linear.residuals, linear.units, x)
        used += len(x) + 1 + len(trials)
        best = int(np.argmin(costs))
        cost = min(before, costs[best])
        if costs[best] >= before:
            converged = True
            break
        x = trials[best]
        keep(x, iteration)
        if before - costs[best] < _ENOUGH * before:
            converged = True
            break
    tell("weighing the evidence", used, cost)
    linear = linearise_robot(problem, stack, x)
    return Settled(x, linear, float(cost), iteration, used + 2 * len(x) + 1, converged)


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
    scale = units[stack.layout.column]
    robust = 1.0 / np.sqrt(1.0 + (rows[0] / scale / _HUBER) ** 2)
    weights = robust / scale**2 / stack.layout.thinning[stack.layout.column]
    return Linear(x, rows[0], slopes, units, weights, stack.layout)


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
    logged = base * np.outer(ratio, ratio)
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

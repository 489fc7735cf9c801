r"""Multiple shooting: pieces of a log whose starting angle and speed are fitted along with the parameters.

Bock and Plitt (1984). A log cut into pieces cannot run away from its measurements; but a
start that is read off a noisy encoder is wrong, and a wrong start looks like another mass.
The starts enter only their own piece, so they are eliminated (variable projection, Golub and
Pereyra 1973): with the sensitivities :math:`S_i` of piece i to its start and :math:`Q_i` an
orthonormal basis of them, residuals and Jacobian are replaced by
:math:`(I - Q_i Q_i^T) r_i` and :math:`(I - Q_i Q_i^T) J_i`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.cost import robust_weights
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun

_STEP = 5e-4  # of the unit cube
_START_STEPS = (1e-4, 1e-3)  # [rad], [rad/s] for the sensitivity to a start
_ITERATIONS = 30
_TRIALS = 12  # dampings for one step, each ten times the one before
_ENOUGH = 1e-7  # relative gain in cost that ends it


@dataclass(frozen=True)
class Shot:
    """Outcome of multiple shooting.

    Attributes:
        x: point of the unit cube, shape (n,).
        runs: with their fitted starts.
        evaluations: candidates simulated.
    """

    x: FloatArray
    runs: tuple[BenchRun, ...]
    evaluations: int


def shoot(problem: FitProblem, session: BenchSession, x: FloatArray) -> Shot:
    """Fit parameters and starts together, from a fit that took the starts as measured.

    Args:
        problem: its training runs are pieces (`pieces.segments`).
        session: simulates.
        x: start, shape (n,).
    """
    runs: Sequence[BenchRun] = problem.train
    kernel = session.kernel(runs)
    damping, used = 1e-6, 1
    cost = _cost(problem, kernel, x)
    for _ in range(_ITERATIONS):
        parts = _normal_equations(problem, kernel, x)
        used += x.size + 3
        for _ in range(_TRIALS):
            step, changes = parts.step(x, damping)
            moved = [_moved(run, change) for run, change in zip(runs, changes, strict=True)]
            candidate = session.kernel(moved)
            lower = _cost(problem, candidate, x + step)
            used += 1
            if lower < cost:
                break
            damping = max(damping, 1e-8) * 10.0
        else:
            break
        gain = (cost - lower) / cost
        x, runs, kernel, cost, damping = x + step, moved, candidate, lower, damping * 0.1
        if gain < _ENOUGH:
            break
    return Shot(x, tuple(runs), used)


@dataclass(frozen=True)
class _NormalEquations:
    """Curvatures and gradients at one point, starts and parameters apart; R runs, n parameters.

    Attributes:
        A, g: of the parameters, (n, n) and (n,).
        H, C, b: of each run's start, (R, 2, 2), start against parameters (R, 2, n), and (R, 2); a start that is
            not free has no curvature and no gradient.
    """

    A: FloatArray
    g: FloatArray
    H: FloatArray
    C: FloatArray
    b: FloatArray

    def step(self, x: FloatArray, damping: float) -> tuple[FloatArray, FloatArray]:
        """Levenberg-Marquardt step of the parameters, inside the cube, (n,), and of the starts, (R, 2)."""
        # All starts have one scale: where a joint sticks at once its speed hardly shows, and a step on the scale
        # of such a piece would be far too long.
        scale = np.mean(np.diagonal(self.H, axis1=1, axis2=2), axis=0) + 1e-300
        B = self.H + (damping + 1e-12) * np.diag(scale)
        gains, ends = np.linalg.solve(B, self.C), np.linalg.solve(B, self.b[:, :, None])[:, :, 0]
        A = self.A + damping * np.diag(np.diag(self.A) + 1e-300) - np.einsum("rki,rkj->ij", self.C, gains)
        g = self.g - np.einsum("rki,rk->i", self.C, ends)
        step = np.clip(x - np.linalg.solve(A, g), 0.0, 1.0) - x
        return step, -(ends + gains @ step)


def without_starts(
    problem: FitProblem, kernel: BenchKernel, x: FloatArray, jacobians: Sequence[FloatArray]
) -> list[FloatArray]:
    """Jacobians (T, n) of each run with what a free start would take up removed; others as they are."""
    if not any(run.free_start for run in kernel.runs):
        return list(jacobians)
    sensitivities = _sensitivities(problem, kernel, x)[1]
    return [
        jacobian - basis @ (basis.T @ jacobian) if run.free_start else jacobian
        for run, jacobian, basis in zip(kernel.runs, jacobians, map(_basis, sensitivities), strict=True)
    ]


def _normal_equations(problem: FitProblem, kernel: BenchKernel, x: FloatArray) -> _NormalEquations:
    steps = np.where(x > 0.5, -_STEP, _STEP)
    points = x + np.diag(steps)
    rows = [kernel.split(row) for row in kernel.readings(problem.candidates(points), _offsets(problem, points, kernel))]
    base, sensitivities = _sensitivities(problem, kernel, x)
    count, n = len(kernel.runs), x.size
    A, g = np.zeros((n, n)), np.zeros(n)
    H, C, b = np.zeros((count, 2, 2)), np.zeros((count, 2, n)), np.zeros((count, 2))
    for r, run in enumerate(kernel.runs):
        part = np.nan_to_num(base[r] - run.y)
        jacobian = np.column_stack([(row[r] - base[r]) / step for row, step in zip(rows, steps, strict=True)])
        weight = np.sqrt(robust_weights(part) / part.size)
        part, jacobian = part * weight, np.nan_to_num(jacobian) * weight[:, None]
        A += jacobian.T @ jacobian
        g += jacobian.T @ part
        if run.free_start:
            start = sensitivities[r] * weight[:, None]
            H[r], C[r], b[r] = start.T @ start, start.T @ jacobian, start.T @ part
    return _NormalEquations(A, g, H, C, b)


def _sensitivities(
    problem: FitProblem, kernel: BenchKernel, x: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Readings at x, and their derivatives with respect to angle and speed at the start, (T, 2) for each run."""
    points = np.repeat(x[None], 3, axis=0)
    starts = np.zeros((3, len(kernel.runs), 2))
    starts[1, :, 0], starts[2, :, 1] = _START_STEPS
    rows = kernel.readings(problem.candidates(points), _offsets(problem, points, kernel), starts)
    base, angle, speed = (kernel.split(row) for row in rows)
    found = [
        np.nan_to_num(np.column_stack([(a - b) / _START_STEPS[0], (s - b) / _START_STEPS[1]]))
        for b, a, s in zip(base, angle, speed, strict=True)
    ]
    return base, found


def _basis(sensitivity: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(sensitivity)[0])


def _moved(run: BenchRun, change: FloatArray) -> BenchRun:
    """The run with its start moved, if it is free."""
    if not run.free_start:
        return run
    return replace(run, q0=run.q0 + float(change[0]), dq0=run.dq0 + float(change[1]))


def _offsets(problem: FitProblem, points: FloatArray, kernel: BenchKernel) -> FloatArray | None:
    return problem.offsets(points, kernel.runs)


def _cost(problem: FitProblem, kernel: BenchKernel, x: FloatArray) -> float:
    return float(kernel.costs(problem.candidates(x[None]), _offsets(problem, x[None], kernel))[0])

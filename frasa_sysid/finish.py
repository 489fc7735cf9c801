"""The finisher: bounded trust-region least squares from where CMA-ES stopped.

CMA-ES finds the basin and then creeps along correlated directions; a Gauss-Newton step takes
them in one go (field measurement: a third of the evaluations, a hundredth of the error). The
residuals are those of the pseudo-Huber loss (scipy's soft-L1), so both minimise one cost.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray

_STEP = 5e-4  # of the unit cube, for forward differences ...
FINE_STEPS = (1e-4, 2e-5)  # ... and for a last polish, where the coarse ones blur the valley
_INSIDE = 1e-6  # least_squares wants a start strictly inside its bounds
ITERATIONS = 40


@dataclass(frozen=True)
class Finished:
    """Outcome of the finisher.

    Attributes:
        x: the better of start and end, a point of the unit cube, shape (n,).
        cost: robust cost at x [rad].
        evaluations: candidates simulated.
        converged: False when it ran out of iterations.
    """

    x: FloatArray
    cost: float
    evaluations: int
    converged: bool


def finish(
    problem: FitProblem,
    kernel: BenchKernel,
    x: FloatArray,
    iterations: int = ITERATIONS,
    held: FloatArray | None = None,
    step: float = _STEP,
) -> Finished:
    """Polish a point of the unit cube on all runs of a kernel.

    Args:
        problem: maps points to candidates.
        kernel: simulates its runs with the same loss as the search's.
        x: start, shape (n,).
        iterations: at most.
        held: which numbers stay as they are, shape (n,); none by default.
        step: of the unit cube, for derivatives.
    """
    used = 0
    moving = np.flatnonzero(np.logical_not(held)) if held is not None else np.arange(x.size)
    latest: tuple[FloatArray, FloatArray] | None = None

    def full(points: FloatArray) -> FloatArray:
        whole = np.repeat(x[None], len(points), axis=0)
        whole[:, moving] = points
        return whole

    def stacked(points: FloatArray) -> FloatArray:
        nonlocal used
        used += len(points)
        whole = full(points)
        return kernel.rooted(problem.candidates(whole), problem.offsets(whole, kernel.runs))

    def jacobian(point: FloatArray) -> FloatArray:
        # Steps away from the nearer face, so that every point stays inside the box.
        steps = np.where(point > 0.5, -step, step)
        moved = stacked(point + np.diag(steps))
        base = latest[1] if latest is not None and np.array_equal(latest[0], point) else vector(point)
        return np.asarray(((moved - base) / steps[:, None]).T)

    def vector(point: FloatArray) -> FloatArray:
        nonlocal latest
        latest = (point.copy(), stacked(point[None])[0])
        return latest[1]

    found = least_squares(
        vector,
        np.clip(x[moving], _INSIDE, 1.0 - _INSIDE),
        jac=jacobian,
        bounds=(0.0, 1.0),
        x_scale="jac",
        ftol=1e-6,
        xtol=1e-5,
        gtol=1e-10,
        max_nfev=iterations,
    )
    pair = np.array([x, full(found.x[None])[0]])
    before, after = kernel.costs(problem.candidates(pair), problem.offsets(pair, kernel.runs))
    best = 1 if after < before else 0
    return Finished(pair[best], float(min(before, after)), used + 2, found.status > 0)

"""The full bootstrap: logs drawn with replacement and every draw fitted anew (Efron 1979)."""

from dataclasses import replace
from functools import partial

import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.finish import finish
from frasa_sysid.pieces import independent
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.spread import Spread

_ITERATIONS = 8  # from the fit on all logs, which is near


def full_bootstrap(
    problem: FitProblem, session: BenchSession, values: FloatArray, draws: int, spread: Spread
) -> FloatArray:
    """95 % interval of each parameter over resampled logs, shape (n, 2).

    Args:
        problem: what was fitted; its seed makes the draws.
        session: simulates.
        values: the fit, shape (n,).
        draws: how many times the logs are drawn.
        spread: does the draws side by side.
    """
    rng = np.random.default_rng((problem.seed, 11))
    logs = independent(problem.train)
    drawn = [rng.integers(0, len(logs), len(logs)) for _ in range(draws)]
    tasks = [tuple(i for log in one for i in logs[int(log)]) for one in drawn]
    x = np.clip(problem.to_unit(values), 0.0, 1.0)
    found = spread.map(partial(_draw, problem=problem, session=session, x=x), tasks)
    low, high = np.quantile(np.array(found), (0.025, 0.975), axis=0)
    return np.column_stack([low, high])


def _draw(chosen: tuple[int, ...], problem: FitProblem, session: BenchSession, x: FloatArray) -> FloatArray:
    runs = [problem.train[i] for i in chosen]
    part = replace(problem, train=tuple(runs))
    return problem.from_unit(finish(part, session.kernel(runs), x, _ITERATIONS).x)

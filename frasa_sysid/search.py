"""CMA-ES in the unit cube: it knows no robot, asks for costs, saves as it goes and resumes exactly.

Hansen: "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, through the `cmaes` package.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from cmaes import CMA

from frasa_sysid.calibration import write_atomic
from frasa_sysid.recording import FloatArray

_SIGMA = 0.1  # first step size as a share of the cube: nominal values are a guess, not a coin toss
_STALL = 12  # generations without progress after which the search has converged
_PROGRESS = 2e-4  # relative improvement that counts as progress
_MARGIN = 0.01  # a start on a bound is moved inside by this share

Costs = Callable[[list[FloatArray]], list[float]]


class Stop(Enum):
    """Why a search ended, in words."""

    CONVERGED = "converged: no generation improved the best by 0.02 % for 12 generations"
    BUDGET = "budget: the number of evaluations was used up; more may improve it (--evaluations)"
    FINISHED = "converged: least squares settled from the best of CMA-ES"
    INTERRUPTED = "interrupted by the user; the best so far is kept"


@dataclass
class Trace:
    """Best cost after each generation, and everything needed to repeat the search exactly.

    Attributes:
        costs: cost of every candidate, generation by generation.
        best: lowest cost so far after each generation.
    """

    costs: list[list[float]] = field(default_factory=list)
    best: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class SearchResult:
    """Outcome of a search.

    Attributes:
        x: best point of the unit cube, shape (n,).
        cost: at x.
        evaluations: costs computed, those of a resumed run included.
        stop: why it ended.
        trace: see `Trace`.
    """

    x: FloatArray
    cost: float
    evaluations: int
    stop: Stop
    trace: Trace


def search(
    costs: Costs,
    start: FloatArray,
    seed: int,
    evaluations: int,
    checkpoint: Path | None = None,
    identity: str = "",
    on_generation: Callable[[int, float], None] | None = None,
) -> SearchResult:
    """Minimise over the unit cube.

    Args:
        costs: finite cost of each of a list of points of shape (n,).
        start: first mean, shape (n,); moved inside where it lies on a face.
        seed: of the sampling.
        evaluations: budget; the start itself is evaluated first and always.
        checkpoint: file for the costs so far; a search that finds one of the same `identity`
            goes on where that one stopped, to the same result.
        identity: what makes two searches the same (problem, seed).
        on_generation: told (evaluations, best cost) after each generation.

    Returns:
        The best point seen.
    """
    optimizer, population = _optimizer(start, seed)
    saved = _load(checkpoint, identity)
    trace = Trace()
    best_x, best = np.clip(start, 0.0, 1.0), np.inf
    count, stop = 0, Stop.BUDGET
    try:
        while count < evaluations:
            points = [optimizer.ask() for _ in range(population)]
            # The nominal values compete in the first generation, so the fit is never worse than they are.
            asked = [np.clip(start, 0.0, 1.0), *points] if not trace.costs else points
            known = saved[len(trace.costs)] if len(trace.costs) < len(saved) else None
            found = known if known is not None and len(known) == len(asked) else costs(asked)
            trace.costs.append(list(found))
            count += len(asked)
            lowest = int(np.argmin(found))
            if found[lowest] < best:
                best, best_x = found[lowest], asked[lowest]
            trace.best.append(best)
            optimizer.tell(list(zip(points, found[-population:], strict=True)))
            _save(checkpoint, identity, trace)
            if on_generation is not None:
                on_generation(count, best)
            if _stalled(trace.best):
                stop = Stop.CONVERGED
                break
    except KeyboardInterrupt:
        if not trace.costs:
            raise
        stop = Stop.INTERRUPTED
    return SearchResult(np.asarray(best_x), float(best), count, stop, trace)


def _optimizer(start: FloatArray, seed: int) -> tuple[Any, int]:
    n = start.size
    population = 4 + int(3 * np.log(n)) + n // 2
    bounds = np.array([[0.0, 1.0]] * n)
    mean = np.clip(start, _MARGIN, 1.0 - _MARGIN)
    return CMA(mean=mean, sigma=_SIGMA, bounds=bounds, seed=seed, population_size=population), population


def _stalled(best: list[float]) -> bool:
    return len(best) > 2 * _STALL and best[-1] > best[-1 - _STALL] * (1.0 - _PROGRESS)


def _save(path: Path | None, identity: str, trace: Trace) -> None:
    if path is not None:
        write_atomic(path, json.dumps({"identity": identity, "costs": trace.costs}))


def _load(path: Path | None, identity: str) -> list[list[float]]:
    """Costs of an earlier run of the very same search; nothing when there is none."""
    if path is None or not path.is_file():
        return []
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["identity"] != identity:
            return []
        rows = [[float(cost) for cost in row] for row in data["costs"]]
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        # A checkpoint is only a shortcut: a broken one costs time, never the result.
        return []
    return rows if np.isfinite(np.concatenate([np.zeros(1), *map(np.array, rows)])).all() else []

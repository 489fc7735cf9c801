"""CMA-ES in the unit cube: it knows no robot, asks for costs, saves as it goes and resumes exactly.

Hansen: "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, through the `cmaes` package.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from cmaes import CMA

from frasa_sysid.calibration import read_limited, write_atomic
from frasa_sysid.errors import InputError
from frasa_sysid.recording import FloatArray

_SIGMA = 0.1  # first step size as a share of the cube: nominal values are a guess, not a coin toss
_STALL = 12  # generations without progress after which the search has converged
_PROGRESS = 2e-4  # relative improvement that counts as progress
_SAVE_EVERY = 0.5  # [s] between writes of a checkpoint
_LARGEST = 2**26  # [bytes] of a checkpoint
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
    saved = _Checkpoint(checkpoint, identity)
    trace = Trace()
    best_x, best = np.clip(start, 0.0, 1.0), np.inf
    count, stop = 0, Stop.BUDGET
    try:
        while count < evaluations:
            points = [optimizer.ask() for _ in range(population)]
            # The nominal values compete in the first generation, so the fit is never worse than they are.
            asked = [np.clip(start, 0.0, 1.0), *points] if not trace.costs else points
            known = saved.known(len(trace.costs))
            found = known if known is not None and len(known) == len(asked) else costs(asked)
            trace.costs.append(list(found))
            count += len(asked)
            lowest = int(np.argmin(found))
            if found[lowest] < best:
                best, best_x = found[lowest], asked[lowest]
            trace.best.append(best)
            optimizer.tell(list(zip(points, found[-population:], strict=True)))
            saved.save(trace)
            if on_generation is not None:
                on_generation(count, best)
            if _stalled(trace.best):
                stop = Stop.CONVERGED
                break
    except KeyboardInterrupt:
        if not trace.costs:
            raise
        stop = Stop.INTERRUPTED
    saved.save(trace, now=True)
    return SearchResult(np.asarray(best_x), float(best), count, stop, trace)


def _optimizer(start: FloatArray, seed: int) -> tuple[Any, int]:
    n = start.size
    population = 4 + int(3 * np.log(n)) + n // 2
    bounds = np.array([[0.0, 1.0]] * n)
    mean = np.clip(start, _MARGIN, 1.0 - _MARGIN)
    return CMA(mean=mean, sigma=_SIGMA, bounds=bounds, seed=seed, population_size=population), population


def _stalled(best: list[float]) -> bool:
    return len(best) > 2 * _STALL and best[-1] > best[-1 - _STALL] * (1.0 - _PROGRESS)


class _Checkpoint:
    """Costs so far of every search that shares a file; written at most twice a second."""

    def __init__(self, path: Path | None, identity: str) -> None:
        self._path, self._identity = path, identity
        self._searches = _load(path)
        self._written = time.monotonic()

    def known(self, generation: int) -> list[float] | None:
        """Costs of a generation of the very same search, if an earlier run got that far."""
        rows = self._searches.get(self._identity, [])
        return rows[generation] if generation < len(rows) else None

    def save(self, trace: Trace, now: bool = False) -> None:
        """Keep the costs; `now` writes them whatever the time."""
        if self._path is None or not (now or time.monotonic() - self._written > _SAVE_EVERY):
            return
        earlier = self._searches.get(self._identity, [])
        # What an earlier run of this very search computed beyond these generations is kept.
        self._searches[self._identity] = trace.costs + (
            earlier[len(trace.costs) :] if earlier[: len(trace.costs)] == trace.costs else []
        )
        write_atomic(self._path, json.dumps({"searches": self._searches}))
        self._written = time.monotonic()


def _load(path: Path | None) -> dict[str, list[list[float]]]:
    """Costs of earlier searches by identity; nothing when there are none."""
    if path is None or not path.exists():
        return {}
    try:
        found = {
            str(identity): [[float(cost) for cost in row] for row in rows]
            for identity, rows in json.loads(read_limited(path, _LARGEST, InputError))["searches"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, InputError):
        # A checkpoint is only a shortcut: a broken one costs time, never the result.
        return {}
    return {identity: rows for identity, rows in found.items() if np.isfinite([c for row in rows for c in row]).all()}

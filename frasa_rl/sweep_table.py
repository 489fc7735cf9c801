"""What many agents came to, from the tables of their run folders: a row for each, and their spread along the way."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from frasa_rl.tables import EVALUATIONS, PROGRESS, Table

Floats = npt.NDArray[np.float64]
Curve = tuple[Floats, Floats]

AGENTS = Table(
    "sweep.csv",
    (
        "seed", "steps", "minutes", "success_prone", "success_supine", "success", "time_s", "best_steps",
        "best_minutes", "steps_to_50", "minutes_to_50", "steps_to_90", "minutes_to_90", "return", "return_best",
    ),
)  # fmt: skip
_UNKNOWN = float("nan")
_HALF, _MOST = 0.5, 0.9
_POINTS = 240  # of the grid, more than the picture can show


def agent_row(seed: int, run: Path) -> list[float]:
    """An agent's row of sweep.csv, from its run folder; NaN where there is nothing yet.

    Success is that of the best evaluation, which is the published policy's. The steps and minutes to a success are
    those of the first evaluation that had it, on falls of both sides: nothing is guessed between evaluations.
    """
    rows = np.array(PROGRESS.read(run)).reshape(-1, len(PROGRESS.columns))
    steps, minutes, returns = rows[:, :3].T
    tried = np.array(EVALUATIONS.read(run)).reshape(-1, len(EVALUATIONS.columns))
    chosen = tried[tried[:, -1] == 1.0]
    best = chosen[-1] if len(chosen) else np.full(len(EVALUATIONS.columns), _UNKNOWN)
    success = (best[3] + best[4]) / 2.0
    returns = returns[np.isfinite(returns)]
    row = [seed, _last(steps), _last(minutes), best[3], best[4], success, best[5], best[0], best[1]]
    row += [*_first(tried, _HALF), *_first(tried, _MOST), _last(returns), returns.max() if len(returns) else _UNKNOWN]
    return [float(one) for one in row]


def _last(values: Floats) -> float:
    return float(values[-1]) if len(values) else _UNKNOWN


def _first(tried: Floats, share: float) -> tuple[float, float]:
    """Steps and minutes of the first evaluation in which a share of the falls ended standing; NaN without one."""
    reached = np.flatnonzero((tried[:, 3] + tried[:, 4]) / 2.0 >= share - 1e-9)
    return (float(tried[reached[0], 0]), float(tried[reached[0], 1])) if len(reached) else (_UNKNOWN, _UNKNOWN)


def by_merit(rows: Sequence[Sequence[float]]) -> list[int]:
    """Seeds, best first: by success on held-out falls, of equals the faster; those never evaluated are left out."""
    known = [dict(zip(AGENTS.columns, row, strict=True)) for row in rows]
    known = [one for one in known if np.isfinite(one["success"])]
    known.sort(key=lambda one: (-one["success"], one["time_s"] if np.isfinite(one["time_s"]) else np.inf, one["seed"]))
    return [int(one["seed"]) for one in known]


def curve(run: Path, what: str, against: str) -> Curve:
    """A run's `return`, or `success` on held-out falls, against `steps` or `minutes`: two arrays, shape (rows,)."""
    table = PROGRESS if what == "return" else EVALUATIONS
    rows = np.array(table.read(run)).reshape(-1, len(table.columns))
    columns = dict(zip(table.columns, rows.T, strict=True))
    y = columns["return"] if what == "return" else (columns["success_prone"] + columns["success_supine"]) / 2.0
    known = np.isfinite(y)
    return columns[against][known], y[known]


@dataclass(frozen=True)
class Spread:
    """Many curves on one grid, each only where it has been.

    Attributes:
        x: the grid, shape (points,).
        count: curves there, shape (points,).
        levels: least, lower quartile, median, upper quartile, most of these, shape (5, points); NaN without any.
    """

    x: Floats
    count: npt.NDArray[np.int64]
    levels: Floats


def spread(curves: Sequence[Curve], points: int = _POINTS) -> Spread:
    """The spread of some curves, none of them continued beyond its ends.

    Args:
        curves: each against increasing numbers; those without any are left out.
        points: of the grid, from the first beginning to the last end.
    """
    curves = [one for one in curves if len(one[0])]
    if not curves:
        return Spread(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((5, 0)))
    grid = np.linspace(min(x[0] for x, _ in curves), max(x[-1] for x, _ in curves), points)
    each = np.array([np.interp(grid, x, y, left=np.nan, right=np.nan) for x, y in curves])
    count = np.isfinite(each).sum(axis=0)
    levels = np.full((5, points), np.nan)
    levels[:, count > 0] = np.nanquantile(each[:, count > 0], (0.0, 0.25, 0.5, 0.75, 1.0), axis=0)
    return Spread(grid, count, levels)

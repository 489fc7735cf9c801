"""What a run's evaluations came to: a table, the best of them, and whether success holds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl.snapshots import Arrays
from frasa_rl.tables import EVALUATIONS

_STEPS, _SET, _PRONE, _SUPINE, _TIME, _BEST = 0, 2, 3, 4, 5, 6


class Evaluations:
    """The evaluations of a run on held-out falls, in order.

    Success has to hold twice: after it was reached on the first set of falls, the next evaluation has other ones.

    Attributes:
        rows: numbers by `tables.EVALUATIONS`; time is NaN where nobody stood up.

    Args:
        run: the run folder.
        enough: share of falls that is asked for; None where nothing is.
    """

    def __init__(self, run: Path, enough: float | None) -> None:
        self._run, self._enough = run, enough
        self.rows: list[list[float]] = []

    @property
    def last(self) -> list[float] | None:
        """The newest row."""
        return self.rows[-1] if self.rows else None

    @property
    def best(self) -> list[float] | None:
        """The row of the best policy: most falls ended standing; of equals the faster one, then the newer one."""
        best = [row for row in self.rows if row[_BEST]]
        return best[-1] if best else None

    @property
    def evaluated_steps(self) -> int:
        """Transitions at the newest evaluation; 0 before the first."""
        return int(self.rows[-1][_STEPS]) if self.rows else 0

    @property
    def next_set(self) -> int:
        """Which set of falls is next."""
        return int(self._reached(-1) and self.rows[-1][_SET] == 0)

    @property
    def holds(self) -> bool:
        """Whether success was reached on one set, and then on the other."""
        return self._reached(-1) and self._reached(-2) and self.rows[-1][_SET] == 1

    def _reached(self, index: int) -> bool:
        return self._enough is not None and len(self.rows) >= -index and _success(self.rows[index]) >= self._enough

    def add(self, steps: int, minutes: float, prone: float, supine: float, time_s: float) -> bool:
        """Append an evaluation: whether it is the best so far."""
        row = [float(steps), round(minutes, 4), float(self.next_set), prone, supine, time_s, 0.0]
        best = self.best
        row[_BEST] = float(best is None or _merit(row) >= _merit(best))
        self.rows.append(row)
        self.write()
        return bool(row[_BEST])

    def drop_early(self, each: int) -> bool:
        """Forget the newest row where it was made only because the run ended, and now it goes on.

        Args:
            each: transitions between two evaluations.

        Returns:
            Whether its policy was the best.
        """
        before = int(self.rows[-2][_STEPS]) if len(self.rows) > 1 else 0
        if not self.rows or self.evaluated_steps // each > before // each:
            return False
        dropped = self.rows.pop()
        self.write()
        return bool(dropped[_BEST])

    def write(self) -> None:
        """The table as evaluations.csv."""
        EVALUATIONS.write(self._run, self.rows)

    def snapshot(self) -> Arrays:
        """For a checkpoint."""
        return {"rows": np.array(self.rows).reshape(-1, len(EVALUATIONS.columns))}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        self.rows = [[float(one) for one in row] for row in kept["rows"]]
        self.write()


def _success(row: list[float]) -> float:
    return (row[_PRONE] + row[_SUPINE]) / 2.0


def _merit(row: list[float]) -> tuple[float, float]:
    return _success(row), -row[_TIME] if np.isfinite(row[_TIME]) else -np.inf


def shown(row: list[float]) -> str:
    """An evaluation for the progress line."""
    return f"held-out {100.0 * row[_PRONE]:.0f} % prone {100.0 * row[_SUPINE]:.0f} % supine"

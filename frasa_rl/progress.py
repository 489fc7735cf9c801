"""What a run shows and keeps of how it goes: a line on standard error, progress.csv, TensorBoard."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl.bars import Line, clock
from frasa_rl.collector import Round
from frasa_rl.snapshots import Arrays
from frasa_rl.stopping import Ends
from frasa_rl.tables import PROGRESS

_EPISODES = 100  # that means are of
_ROW_STEPS, _ROW_SHARE = 1_000, 0.005  # a long run has longer rows: the table is written anew with each
_RECENT_S = 20.0  # that the rates in the line are of

Record = Callable[[str, float], None]


class Progress:
    """Counts and reports.

    Attributes:
        rows: of progress.csv, by `tables.PROGRESS`; NaN before the first episode is over.
        remark: what else the line says, such as the last evaluation.

    Args:
        run: the run folder.
        ends: of the run, for the time left.
        record: takes a number for TensorBoard by name.
        dump: writes them for a step.
    """

    def __init__(self, run: Path, ends: Ends, record: Record, dump: Callable[[int], None]) -> None:
        self._run, self._ends, self._record, self._dump = run, ends, record, dump
        self.rows: list[list[float]] = []
        self.remark = ""
        self._episodes: deque[tuple[float, float, float]] = deque(maxlen=_EPISODES)  # return, length, success
        self._posture: list[float] = []
        self._diverged = self._steps = self._updates = self._row_at = 0
        self._line = Line()
        self.start(0.0)

    def start(self, elapsed_s: float) -> None:
        """Training begins, or goes on after so long [s]."""
        self._begun = time.monotonic() - elapsed_s
        self._row_s = elapsed_s
        self._row_from = (self._steps, self._updates)
        self._recent: deque[tuple[float, int, int]] = deque([(elapsed_s, self._steps, self._updates)])

    @property
    def elapsed_s(self) -> float:
        """Training time of all parts of the run [s]."""
        return time.monotonic() - self._begun

    @property
    def success(self) -> float:
        """Share of the last hundred episodes that ended standing; NaN before the first is over."""
        return _mean([one[2] for one in self._episodes])

    def note(self, steps: int, updates: int, got: Round) -> None:
        """A round is over."""
        self._steps, self._updates = steps, updates
        self._episodes.extend(zip(got.returned.tolist(), got.lasted.tolist(), got.success.tolist(), strict=True))
        self._posture.append(got.posture)
        self._diverged += got.diverged
        now = self.elapsed_s
        self._recent.append((now, steps, updates))
        while now - self._recent[0][0] > _RECENT_S and len(self._recent) > 2:
            self._recent.popleft()
        if steps - self._row_at >= max(_ROW_STEPS, _ROW_SHARE * steps):
            self.add_row()
        if self._line.due:
            self.show()

    def add_row(self) -> None:
        """One row of progress.csv about the last hundred episodes; none where nothing has happened since the last."""
        if self._steps == self._row_at:
            return
        spent = max(self.elapsed_s - self._row_s, 1e-9)
        rates = [(now - then) / spent for now, then in zip((self._steps, self._updates), self._row_from, strict=True)]
        row = [
            self._steps,
            round(self.elapsed_s / 60.0, 4),
            _mean([one[0] for one in self._episodes]),
            _mean([one[1] for one in self._episodes]),
            self.success,
            _mean(self._posture),
            self._diverged,
            self._updates,
            *(round(one, 1) for one in rates),
        ]
        self.rows.append([float(one) for one in row])
        self._row_at, self._row_s, self._posture = self._steps, self.elapsed_s, []
        self._row_from = (self._steps, self._updates)
        for name, value in zip(PROGRESS.columns[2:], row[2:], strict=True):
            if np.isfinite(value):
                self._record(f"run/{name}", value)
        self._dump(self._steps)
        self.write()

    def write(self) -> None:
        """The rows as progress.csv; what is not known before the first finished episode is left out."""
        PROGRESS.write(self._run, self.rows)

    def show(self) -> None:
        """The progress line."""
        (then_s, steps, updates), now_s = self._recent[0], self.elapsed_s
        spent = max(now_s - then_s, 1e-9)
        rates = (self._steps - steps) / spent, (self._updates - updates) / spent
        left = self._ends.left_s(self._steps, now_s, rates[0])
        line = (
            f"{self._steps:>9,} steps  {clock(now_s)}"
            f"  return {_shown(_mean([one[0] for one in self._episodes]), '6.1f')}"
            f"  standing {_shown(100.0 * self.success, '3.0f')} %  {self.remark}"
            f"{'  ' if self.remark else ''}{rates[0]:5.0f} steps/s  {rates[1]:4.0f} updates/s"
            f"  left {clock(left) if np.isfinite(left) else '-'}"
        )
        self._line.show(line)

    def snapshot(self) -> Arrays:
        """For a checkpoint."""
        return {
            "rows": np.array(self.rows).reshape(-1, len(PROGRESS.columns)),
            "episodes": np.array(self._episodes, dtype=np.float64).reshape(-1, 3),
            "posture": np.array(self._posture, dtype=np.float64),
            "counts": np.array([self._diverged, self._steps, self._updates, self._row_at]),
            "elapsed_s": np.array(self.elapsed_s),
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round; the file is as it was then: later rows belong to a past that is no more."""
        self.rows = [[float(one) for one in row] for row in kept["rows"]]
        self._episodes = deque([(float(a), float(b), float(c)) for a, b, c in kept["episodes"]], maxlen=_EPISODES)
        self._posture = [float(one) for one in kept["posture"]]
        self._diverged, self._steps, self._updates, self._row_at = (int(one) for one in kept["counts"])
        self.start(float(kept["elapsed_s"]))
        self.write()


def _shown(value: float, form: str) -> str:
    """A number for the progress line; a dash until there is one."""
    return format(value, form) if np.isfinite(value) else "-".rjust(int(form.split(".")[0]))


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")

"""What a run shows and keeps while it trains: a line on standard error, progress.csv, checkpoints, its end."""

import csv
import io
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from frasa_sysid.calibration import say, write_atomic

CSV_FILE = "progress.csv"
COLUMNS = ("steps", "minutes", "return", "length", "success", "posture", "diverged", "updates", "steps_per_s")
_ROW_STEPS = 1_000
_LINE_S = {True: 1.0, False: 30.0}  # a terminal's line is rewritten, a log's lines add up


class Progress(BaseCallback):
    """Counts, reports, and ends the run.

    Args:
        run: the run folder.
        steps: the run ends at this many transitions; None for no limit.
        minutes: the run ends after this long, earlier parts of a resumed run included; None for no limit.
        elapsed_s: time the earlier parts took [s].
        checkpoint_steps: transitions between two checkpoints.
        checkpoint: saves one, given the elapsed time [s].
    """

    def __init__(
        self,
        run: Path,
        steps: int | None,
        minutes: float | None,
        elapsed_s: float,
        checkpoint_steps: int,
        checkpoint: Callable[[float], None],
    ) -> None:
        super().__init__()
        self.stopped: str | None = None
        self._path, self._steps, self._minutes = run / CSV_FILE, steps, minutes
        self._checkpoint_steps, self._checkpoint = checkpoint_steps, checkpoint
        self._begun = time.monotonic() - elapsed_s
        self._posture: list[float] = []
        self._diverged = 0
        self.rows: list[list[float]] = []
        self._line_at = 0.0

    @property
    def elapsed_s(self) -> float:
        """Training time of all parts of the run [s]."""
        return time.monotonic() - self._begun

    def _on_training_start(self) -> None:
        # Rows after the checkpoint a run resumes from belong to a past that is no more.
        self.rows = [row for row in read_progress(self._path) if row[0] <= self.num_timesteps]
        self._row_at = self._saved_at = self._first = self.num_timesteps
        self._first_s = self.elapsed_s

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            self._posture.append(info["posture"])
            self._diverged += info.get("diverged", False)
        if self.num_timesteps - self._row_at >= _ROW_STEPS:
            self.add_row()
        if self.num_timesteps - self._saved_at >= self._checkpoint_steps:
            self._saved_at = self.num_timesteps
            self._checkpoint(self.elapsed_s)
        if time.monotonic() - self._line_at > _LINE_S[sys.stderr.isatty()]:
            self._line_at = time.monotonic()
            self.show()
        if self.stopped is None and self._minutes is not None and self.elapsed_s >= 60.0 * self._minutes:
            self.stopped = "minutes"
        if self.stopped is None and self._steps is not None and self.num_timesteps >= self._steps:
            self.stopped = "steps"
        return self.stopped is None

    def add_row(self) -> None:
        """One row of progress.csv about the last hundred episodes."""
        self._row_at = self.num_timesteps
        episodes = self._episodes()
        row = [
            self.num_timesteps,
            round(self.elapsed_s / 60.0, 4),
            _mean([one["r"] for one in episodes]),
            _mean([one["l"] for one in episodes]),
            self._success(),
            _mean(self._posture),
            self._diverged,
            self.model._n_updates,
            round(self._rate(), 1),
        ]
        self._posture = []
        self.rows.append([float(one) for one in row])
        self.logger.record("standup/posture", row[5])
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows(
            [COLUMNS, *([f"{one:g}" if one % 1 else int(one) for one in row] for row in _known(self.rows))]
        )
        write_atomic(self._path, text.getvalue())

    def show(self) -> None:
        """The progress line."""
        returned = _shown(_mean([one["r"] for one in self._episodes()]), "6.1f")
        line = (
            f"{self.num_timesteps:>9,} steps  {_clock(self.elapsed_s)}  return {returned}"
            f"  standing {_shown(100.0 * self._success(), '3.0f')} %"
            f"  {self._rate():5.0f} steps/s  left {_clock(self._left_s())}"
        )
        if sys.stderr.isatty():
            print(f"\r{line}", end="", file=sys.stderr, flush=True)
        else:
            say(line)

    def _episodes(self) -> list[dict[str, float]]:
        """Return `r` and length `l` of the last hundred episodes."""
        return list(self.model.ep_info_buffer or [])

    def _success(self) -> float:
        """Share of the last hundred episodes that ended standing."""
        return _mean([float(one) for one in self.model.ep_success_buffer or []])

    def _rate(self) -> float:
        return (self.num_timesteps - self._first) / max(self.elapsed_s - self._first_s, 1e-9)

    def _left_s(self) -> float:
        by_steps = (self._steps - self.num_timesteps) / max(self._rate(), 1e-9) if self._steps is not None else np.inf
        by_time = 60.0 * self._minutes - self.elapsed_s if self._minutes is not None else np.inf
        return float(max(0.0, min(by_steps, by_time)))


@contextmanager
def stop_on_signals(progress: Progress) -> Iterator[None]:
    """The first Ctrl-C (or termination) ends the run after the current round, with all saved; a second one at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if progress.stopped == "interrupted":
            raise KeyboardInterrupt
        progress.stopped = "interrupted"
        say("\nstopping after this round; everything is saved (again to stop at once)")

    kept = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def read_progress(path: Path) -> list[list[float]]:
    """The rows of a progress.csv, in the order of `COLUMNS`; none when there is no file."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [[float(one) if one else np.nan for one in row] for row in list(csv.reader(file))[1:]]


def _known(rows: list[list[float]]) -> list[list[float]]:
    """Rows without those before the first finished episode."""
    return [row for row in rows if np.isfinite(row).all()]


def _shown(value: float, form: str) -> str:
    """A number for the progress line; a dash until there is one."""
    return format(value, form) if np.isfinite(value) else "-".rjust(int(form.split(".")[0]))


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _clock(seconds: float) -> str:
    whole = int(seconds) if np.isfinite(seconds) else 0
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"

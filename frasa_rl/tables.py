"""The tables of a run folder: progress.csv and evaluations.csv, numbers in named columns."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frasa_sysid.calibration import write_atomic


@dataclass(frozen=True)
class Table:
    """A file of rows of numbers.

    Attributes:
        file: its name in the run folder.
        columns: names, in order.
    """

    file: str
    columns: tuple[str, ...]

    def write(self, run: Path, rows: Sequence[Sequence[float]]) -> None:
        """The whole table; an unknown number (NaN) is left out."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([self.columns, *([f"{one:.10g}" if np.isfinite(one) else "" for one in row] for row in rows)])
        write_atomic(run / self.file, text.getvalue())

    def read(self, run: Path) -> list[list[float]]:
        """The rows; none when there is no file."""
        path = run / self.file
        if not path.is_file():
            return []
        with path.open(newline="", encoding="utf-8") as file:
            return [[float(one) if one else float("nan") for one in row] for row in list(csv.reader(file))[1:]]


PROGRESS = Table(
    "progress.csv",
    (
        "steps", "minutes", "return", "length", "success", "posture", "diverged", "updates", "steps_per_s",
        "updates_per_s",
    ),
)  # fmt: skip
EVALUATIONS = Table("evaluations.csv", ("steps", "minutes", "set", "success_prone", "success_supine", "time_s", "best"))

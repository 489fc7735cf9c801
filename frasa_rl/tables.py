"""The tables of a run folder: progress.csv and evaluations.csv, numbers in named columns."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frasa_sysid.calibration import InputError, read_limited, write_atomic

_LARGEST = 2**26  # [bytes]


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
        """The rows; none when there is no file.

        Raises:
            InputError: it is damaged.
        """
        path = run / self.file
        try:
            text = read_limited(path, _LARGEST, InputError).decode("utf-8")
            lines = list(csv.reader(io.StringIO(text, newline="")))[1:]
            rows = [[float(one) if one else float("nan") for one in line] for line in lines]
        except FileNotFoundError:
            return []
        except (ValueError, csv.Error) as error:
            raise InputError(f"{path} is no table of numbers: {error}") from error
        if any(len(row) != len(self.columns) for row in rows):
            raise InputError(f"{path}: a row has not the {len(self.columns)} numbers that its head names")
        return rows


PROGRESS = Table(
    "progress.csv",
    (
        "steps", "minutes", "return", "length", "success", "posture", "diverged", "updates", "steps_per_s",
        "updates_per_s",
    ),
)  # fmt: skip
EVALUATIONS = Table("evaluations.csv", ("steps", "minutes", "set", "success_prone", "success_supine", "time_s", "best"))

"""CSV tables with a header line, read column by column and checked."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import FloatArray


class Table:
    """The columns of a CSV file as text; numbers are made where they are asked for.

    Attributes:
        path: the file, for messages.
        rows: number of rows below the header.
    """

    def __init__(self, path: Path, columns: Mapping[str, Sequence[str]], rows: int) -> None:
        self.path = path
        self.rows = rows
        self._columns = columns

    @property
    def names(self) -> tuple[str, ...]:
        """The columns that were read."""
        return tuple(self._columns)

    def text(self, name: str) -> Sequence[str]:
        """A column as it stands."""
        return self._columns[name]

    def numbers(self, name: str) -> FloatArray:
        """A column of numbers; NaN where a field is empty.

        Raises:
            LogError: a field that is neither.
        """
        values = np.empty(self.rows)
        for i, field in enumerate(self._columns[name]):
            try:
                values[i] = float(field) if field.strip() else math.nan
            except ValueError:
                raise LogError(f"{self.path}: line {i + 2}: {name} = {field[:40]!r} is not a number") from None
        return values

    def integers(self, name: str) -> npt.NDArray[np.int64]:
        """A column of whole numbers, such as stamps in ns, which a float cannot hold.

        Raises:
            LogError: a field that is none, or needs more than 64 bits.
        """
        values = np.empty(self.rows, dtype=np.int64)
        for i, field in enumerate(self._columns[name]):
            try:
                values[i] = int(field)
            except (ValueError, OverflowError):
                raise LogError(f"{self.path}: line {i + 2}: {name} = {field[:40]!r} is not a whole number") from None
        return values


def read_table(path: Path, needed: Sequence[str], everything: bool = False) -> Table:
    """A CSV file, which may be gzipped.

    Args:
        path: the file.
        needed: names of the columns it must have.
        everything: read all columns; otherwise others are not looked at.

    Raises:
        LogError: not such a file, a column is missing, or a row has not as many fields as the header.
    """
    try:
        lines = csv.reader(io.StringIO(read_bytes(path).decode("utf-8-sig"), newline=""), strict=True)
        header = [name.strip() for name in next(lines, [])]
        places = _places(path, header, needed)
        if everything:
            places |= {name: header.index(name) for name in header if name}
        columns: dict[str, list[str]] = {name: [] for name in places}
        for row in lines:
            if len(row) != len(header):
                raise LogError(
                    f"{path}: line {lines.line_num} has {len(row)} fields, expected {len(header)}; was it cut off?"
                )
            for name, place in places.items():
                columns[name].append(row[place])
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path} is not a CSV table: {error}") from error
    rows = len(columns[needed[0]])
    if rows == 0:
        raise LogError(f"{path} has a header and no rows")
    return Table(path, columns, rows)


def _places(path: Path, header: Sequence[str], needed: Sequence[str]) -> dict[str, int]:
    missing = [name for name in needed if name not in header]
    if missing:
        there = ", ".join(header)[:200] or "nothing"
        raise LogError(f"{path}: no column {', '.join(missing)}; its first line holds {there}")
    return {name: header.index(name) for name in needed}

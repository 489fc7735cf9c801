"""CSV with a header line, read row by row: only the columns that a map names are kept, as numbers."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.columns import Loaded, Values
from frasa_sysid.readers.sampling import BoolArray
from frasa_sysid.readers.sources import DAMAGED, check_source, open_unpacked
from frasa_sysid.recording import Fault

BLOCK = 4_000  # rows that are text at a time
DELIMITERS = ",;\t"
LONGEST_LINE = 2**20  # characters
MOST_COLUMNS = 10_000


class CsvFile:
    """A CSV table, which may be gzipped; fields stand between commas, semicolons or tabs, as the header says."""

    def __init__(self, path: Path) -> None:
        """Look at the header.

        Raises:
            LogError: no usable file, or without a header line.
        """
        check_source(path)
        self.path = path
        with self._lines() as lines:
            first = next(lines, "")
            self._delimiter = max(DELIMITERS, key=first.count)
            self._names = [name.strip() for name in next(self._fields([first.lstrip("#")]), [])]
        if len(self._names) > MOST_COLUMNS:
            raise LogError(f"{path}: {len(self._names)} columns, expected at most {MOST_COLUMNS}")
        if not any(self._names):
            raise LogError(f"{path}: its first line is empty, expected the names of the columns")

    def names(self) -> Sequence[str]:
        """The columns that there are."""
        return [name for name in self._names if name]

    def load(self, wanted: Sequence[str], times: Sequence[str]) -> Loaded:
        """Some columns.

        Raises:
            LogError: a row with another number of fields, a field that is no number, or a name that stands there twice.
        """
        places = {name: self._place(name) for name in (*wanted, *times)}
        blocks: dict[str, list[Values]] = {name: [] for name in places}
        blanks: dict[str, list[BoolArray]] = {name: [] for name in wanted}
        faults: list[Fault] = []
        with self._lines() as lines:
            for start, columns in self._blocks(lines, list(places.values()), faults):
                for name, fields in zip(places, columns, strict=True):
                    blocks[name].append(_block(self, name, start, fields, name in times))
                    if name in blanks:
                        blanks[name].append(_blanks(blocks[name][-1], fields))
        if not next(iter(blocks.values())):
            raise LogError(f"{self.path} has a header and no rows")
        blank = {name: np.concatenate(several) for name, several in blanks.items()}
        whole = {name: np.concatenate(several) for name, several in blocks.items()}
        return Loaded(whole, faults, {name: one for name, one in blank.items() if one.any()})

    @contextmanager
    def _lines(self) -> Iterator[Iterator[str]]:
        try:
            with io.TextIOWrapper(open_unpacked(self.path), encoding="utf-8-sig", newline="") as text:
                yield _lines_of(text)
        except DAMAGED as error:
            raise LogError(f"{self.path} is a damaged gzip file: {error}") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise LogError(f"{self.path} is not a CSV table: {error}") from error

    def _blocks(
        self, lines: Iterator[str], places: Sequence[int], faults: list[Fault]
    ) -> Iterator[tuple[int, list[list[str]]]]:
        """The fields at some places, column by column, with the line of the first; some thousands at a time."""
        reader = self._fields(lines)
        next(reader)
        columns: list[list[str]] = [[] for _ in places]
        short, start = 0, 2
        for row in reader:
            if short:
                raise LogError(f"{self.path}: line {short} has not {len(self._names)} fields, as the header has")
            if len(row) == len(self._names):
                for fields, place in zip(columns, places, strict=True):
                    fields.append(row[place])
            elif row:
                short = reader.line_num  # the last row of a log that was cut off may be so, no other
            if len(columns[0]) == BLOCK:
                yield start, columns
                columns, start = [[] for _ in places], reader.line_num + 1
        if short:
            faults.append(Fault("truncated", 1, f"the last row, line {short}, is cut off; dropped"))
        if columns[0]:
            yield start, columns

    def _fields(self, lines: Iterable[str]) -> Any:  # noqa: ANN401 - of csv, whose type has no public name
        return csv.reader(lines, delimiter=self._delimiter, strict=True)

    def _place(self, name: str) -> int:
        if self._names.count(name) > 1:
            raise LogError(f"{self.path}: {self._names.count(name)} columns are called {name}")
        return self._names.index(name)


def _lines_of(text: io.TextIOWrapper) -> Iterator[str]:
    """The lines of a text, none of them longer than a table's can be."""
    while line := text.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise csv.Error(f"a line of more than {LONGEST_LINE - 1} characters")
        yield line


def _block(file: CsvFile, name: str, start: int, fields: list[str], time: bool) -> Values:
    """A column's next rows: numbers, NaN where empty; of times whole numbers or text where they are."""
    if time:
        for kind in (np.int64, np.float64):
            try:
                return np.array(fields, dtype=kind)
            except (ValueError, OverflowError):
                continue
        return _with_gaps(fields)
    try:
        return np.array(fields, dtype=np.float64)
    except ValueError:
        pass
    values = np.full(len(fields), np.nan)
    for i, text in enumerate(fields):
        try:
            values[i] = float(text) if text.strip() else np.nan
        except ValueError:
            # Blank lines are not counted: near enough to find it.
            raise LogError(f"{file.path}: line {start + i}: {name} = {text[:40]!r} is not a number") from None
    return values


def _blanks(values: Values, fields: list[str]) -> BoolArray:
    """Which fields of a column's next rows are empty."""
    if np.isfinite(values).all():
        return np.zeros(len(fields), dtype=np.bool_)
    return np.fromiter((not text.strip() for text in fields), np.bool_, len(fields))


def _with_gaps(fields: list[str]) -> Values:
    """Times some of which are empty as numbers, or else as text."""
    try:
        return np.array([text.strip() or "nan" for text in fields], dtype=np.float64)
    except ValueError:
        return np.array(fields, dtype=object)

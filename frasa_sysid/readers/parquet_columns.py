"""Parquet, read group by group: only the columns that a map names. Lists of one length are columns side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.columns import Loaded, Values
from frasa_sysid.readers.sampling import BoolArray
from frasa_sysid.readers.sources import check_source

ROWS = 65_536  # at a time


class ParquetFile:
    """A Parquet table."""

    def __init__(self, path: Path) -> None:
        """Look at the schema.

        Raises:
            LogError: pyarrow is not installed, or no Parquet file.
        """
        check_source(path)
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError:
            raise LogError(
                f"{path}: Parquet needs the package pyarrow; install it with: pip install 'frasa[formats]'"
            ) from None
        self.path = path
        # Names that are no text come as errors of the decoding.
        self._error: Any = (pa.ArrowException, OSError, UnicodeDecodeError)
        try:
            self._file = pq.ParquetFile(path)
        except self._error as error:
            raise LogError(f"{path} is not a Parquet file, or cut off: {_one_line(error)}") from error

    def names(self) -> Sequence[str]:
        """The columns that there are.

        Raises:
            LogError: damaged.
        """
        try:
            return list(self._file.schema_arrow.names)
        except self._error as error:
            raise LogError(f"{self.path} is damaged: {_one_line(error)}") from error

    def load(self, wanted: Sequence[str], times: Sequence[str]) -> Loaded:
        """Some columns.

        Raises:
            LogError: damaged, empty, or a column that holds no numbers.
        """
        names = list(dict.fromkeys((*wanted, *times)))
        blocks: dict[str, list[Values]] = {name: [] for name in names}
        blanks: dict[str, list[BoolArray]] = {name: [] for name in wanted}
        try:
            for batch in self._file.iter_batches(batch_size=ROWS, columns=names):
                for name in names:
                    blocks[name].append(self._block(name, batch.column(name), name in times))
                for name in wanted:
                    blanks[name].append(np.asarray(batch.column(name).is_null().to_numpy(zero_copy_only=False)))
        except self._error as error:
            raise LogError(f"{self.path} is damaged: {_one_line(error)}") from error
        if not blocks[names[0]]:
            raise LogError(f"{self.path} holds no rows")
        blank = {name: np.concatenate(several) for name, several in blanks.items()}
        columns = {name: np.concatenate(several) for name, several in blocks.items()}
        return Loaded(columns, blank={name: one for name, one in blank.items() if one.any()})

    def _block(self, name: str, column: Any, time: bool) -> Values:  # noqa: ANN401 - an arrow array
        import pyarrow as pa

        kind = column.type
        if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
            return self._lists(name, column)
        if time and not (pa.types.is_integer(kind) and column.null_count):
            values: Values = column.to_numpy(zero_copy_only=False)
            return values
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
            raise LogError(f"{self.path}: column {name} holds {kind}, expected numbers")
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)

    def _lists(self, name: str, column: Any) -> Values:  # noqa: ANN401 - an arrow array
        rows = column.to_pylist()
        widths = {len(row) for row in rows if row is not None}
        if len(widths) != 1:
            raise LogError(
                f"{self.path}: column {name} holds lists of {sorted(widths)[:3]} numbers, expected one length"
            )
        width = widths.pop()
        try:
            return np.array([[np.nan] * width if row is None else row for row in rows], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise LogError(
                f"{self.path}: column {name} holds lists of {column.type.value_type}, expected numbers"
            ) from error


def _one_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]

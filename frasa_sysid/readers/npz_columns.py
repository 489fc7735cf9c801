"""NumPy's .npz: arrays by name, shape (T,) or (T, k); nothing is unpickled."""

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.columns import Loaded, Values
from frasa_sysid.readers.sources import TEXT_LIMIT, check_source


class NpzFile:
    """Arrays of one length."""

    def __init__(self, path: Path) -> None:
        """Look at what it holds.

        Raises:
            LogError: no .npz file.
        """
        check_source(path)
        self.path = path
        try:
            with zipfile.ZipFile(path) as archive:
                self._sizes = {one.filename.removesuffix(".npy"): one.file_size for one in archive.infolist()}
        except (zipfile.BadZipFile, OSError) as error:
            raise LogError(f"{path} is not an .npz file, or cut off: {error}") from error

    def names(self) -> Sequence[str]:
        """The arrays that there are."""
        return list(self._sizes)

    def load(self, wanted: Sequence[str], times: Sequence[str]) -> Loaded:
        """Some arrays.

        Raises:
            LogError: damaged, of objects, or not of one length.
        """
        names = list(dict.fromkeys((*times, *wanted)))
        arrays: dict[str, Values] = {}
        for name in names:
            if self._sizes[name] > TEXT_LIMIT:
                raise LogError(f"{self.path}: {name} unpacks to {self._sizes[name]} bytes, the limit is {TEXT_LIMIT}")
            arrays[name] = self._array(name)
        lengths = {name: one.shape[0] for name, one in arrays.items()}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise LogError(f"{self.path}: its arrays differ in length ({found}), expected one time line")
        if not lengths[names[0]]:
            raise LogError(f"{self.path}: {names[0]} is empty")
        return Loaded(arrays)

    def _array(self, name: str) -> Values:
        try:
            with np.load(self.path, allow_pickle=False) as archive:
                array: Values = archive[name]
        except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile, zlib.error) as error:
            raise LogError(f"{self.path}: array {name} cannot be read, nothing is unpickled: {error}") from error
        if array.ndim == 0 or array.dtype.kind not in "fiubMU":
            raise LogError(f"{self.path}: {name} is {array.dtype} of shape {array.shape}, expected numbers in a row")
        return array

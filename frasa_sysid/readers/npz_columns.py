"""NumPy's .npz: arrays by name, shape (T,) or (T, k); nothing is unpickled."""

from collections.abc import Sequence
from pathlib import Path

from frasa_sysid.calibration.plain_arrays import array_sizes, read_arrays
from frasa_sysid.errors import LogError
from frasa_sysid.readers.columns import Loaded, Values
from frasa_sysid.readers.sources import check_source

LIMIT = 2**28  # bytes of the arrays that a map names, unpacked


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
            self._sizes = array_sizes(path)
        except ValueError as error:
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
        try:
            arrays: dict[str, Values] = read_arrays(self.path, LIMIT, names)
        except ValueError as error:
            raise LogError(f"{self.path} cannot be read: {error}") from error
        for name, array in arrays.items():
            if array.ndim == 0 or array.dtype.kind not in ("fiubMU" if name in times else "fiub"):
                raise LogError(
                    f"{self.path}: {name} is {array.dtype} of shape {array.shape}, expected numbers in a row"
                )
        lengths = {name: one.shape[0] for name, one in arrays.items()}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise LogError(f"{self.path}: its arrays differ in length ({found}), expected one time line")
        if not lengths[names[0]]:
            raise LogError(f"{self.path}: {names[0]} is empty")
        return Loaded(arrays)

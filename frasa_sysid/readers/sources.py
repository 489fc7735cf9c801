"""What every reader asks of a file before it reads, and how it opens one that may be gzipped."""

import gzip
import io
import zlib
from pathlib import Path
from typing import Any, Literal

from frasa_sysid.errors import LogError

Unit = Literal["auto", "rad", "deg"]  # of joint angles, as the user declares it; auto: radians, checked
ANGLE_UNIT = "angle_unit"  # in a recording's `extra`: who declared the unit of its angles; they are not doubted then
TEXT_LIMIT = 2**25  # bytes, unpacked; as lists of numbers they take twenty times as many
MOST_TIMES = 200  # as many bytes as it has may a packed file have unpacked; logs come to five or ten
SMALL = 2**20  # bytes that it may have in any case
GZIP_MAGIC = b"\x1f\x8b"
DAMAGED = (EOFError, zlib.error, gzip.BadGzipFile)


def check_source(path: Path) -> None:
    """Refuse what cannot be a log.

    Raises:
        LogError: missing, a directory, no plain file, or empty.
    """
    if path.is_dir():
        raise LogError(f"{path} is a directory, expected a log file: name the files in it")
    if not path.exists():
        raise LogError(
            f"{path} does not exist, expected a log file: check its name, and the folder the command runs in"
        )
    if not path.is_file():
        raise LogError(f"{path} is not a plain file")
    if path.stat().st_size == 0:
        raise LogError(f"{path} is empty, expected a log: was anything recorded, or copied whole?")


def open_unpacked(path: Path) -> io.BufferedReader:
    """A file's content, unpacked if it is gzipped; reading it raises one of `DAMAGED` where that cannot be."""
    with path.open("rb") as plain:
        packed = plain.read(len(GZIP_MAGIC)) == GZIP_MAGIC
    if not packed:
        return path.open("rb")
    most = max(SMALL, MOST_TIMES * path.stat().st_size)
    return io.BufferedReader(_Bounded(gzip.open(path, "rb"), most), 2**16)


class _Bounded(io.RawIOBase):
    """What a packed file unpacks to, up to a limit."""

    def __init__(self, file: gzip.GzipFile, most: int) -> None:
        self._file, self._left = file, most

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:  # noqa: ANN401 - any writable buffer
        count = self._file.readinto(buffer)
        self._left -= count
        if self._left < 0:
            raise gzip.BadGzipFile(f"it unpacks to more than {MOST_TIMES} times its size")
        return count

    def close(self) -> None:
        self._file.close()
        super().close()


def read_bytes(path: Path) -> bytes:
    """The content of a text log, unpacked if it is gzipped.

    Raises:
        LogError: not a usable file, damaged, or absurdly large.
    """
    check_source(path)
    try:
        with open_unpacked(path) as file:
            data: bytes = file.read(TEXT_LIMIT + 1)
    except DAMAGED as error:
        raise LogError(f"{path} is a damaged gzip file: {error}") from error
    if len(data) > TEXT_LIMIT:
        raise LogError(f"{path} unpacks to more than {TEXT_LIMIT} bytes")
    return data

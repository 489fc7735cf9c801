"""What every reader asks of a file before it reads, and how it opens one that may be gzipped."""

import gzip
import zlib
from pathlib import Path
from typing import Literal

from frasa_sysid.errors import LogError

Unit = Literal["auto", "rad", "deg"]  # of joint angles, as the user declares it; auto: radians, checked
TEXT_LIMIT = 2**26  # bytes, unpacked; as lists of numbers they take twenty times as many
GZIP_MAGIC = b"\x1f\x8b"


def check_source(path: Path) -> None:
    """Refuse what cannot be a log.

    Raises:
        LogError: missing, a directory, no plain file, or empty.
    """
    if path.is_dir():
        raise LogError(f"{path} is a directory, expected a log file")
    if not path.exists():
        raise LogError(f"{path} does not exist")
    if not path.is_file():
        raise LogError(f"{path} is not a plain file")
    if path.stat().st_size == 0:
        raise LogError(f"{path} is empty")


def read_bytes(path: Path) -> bytes:
    """The content of a text log, unpacked if it is gzipped.

    Raises:
        LogError: not a usable file, damaged, or absurdly large.
    """
    check_source(path)
    try:
        with path.open("rb") as plain:
            packed = plain.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            data: bytes = file.read(TEXT_LIMIT + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path} is a damaged gzip file: {error}") from error
    if len(data) > TEXT_LIMIT:
        raise LogError(f"{path} unpacks to more than {TEXT_LIMIT} bytes")
    return data

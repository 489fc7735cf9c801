"""Arrays of a MATLAB 5 file, with a bound on what is unpacked.

SciPy does the parsing, of the variables that are asked for and nothing else. It would unpack
whatever a file claims, so the packed parts are unpacked here first, as far as the limit
allows.
"""

import io
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sources import check_source
from frasa_sysid.recording import FloatArray

LIMIT = 2**28  # bytes, unpacked
HEADER = 128  # bytes
VERSION = slice(124, 128)  # of the header: version and the order of bytes
ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
PACKED = 15  # element type of a zlib stream
load: Any = scipy.io.loadmat  # its own types leave out open files


def read_matlab(path: Path, names: Sequence[str]) -> dict[str, FloatArray]:
    """Real arrays by name.

    Args:
        path: a MATLAB 5 file (`save -v6` or `-v7`).
        names: of the variables; all must be there.

    Raises:
        LogError: not such a file, damaged, too large, or a variable is missing or no array of real numbers.
    """
    check_source(path)
    if path.stat().st_size > LIMIT:
        raise LogError(f"{path} has more than {LIMIT} bytes")
    data = _unpack(path, path.read_bytes())
    try:
        found = load(io.BytesIO(data), variable_names=list(names), chars_as_strings=False)
    except Exception as error:  # the parser runs on the file's own lengths and types: anything may come out
        raise LogError(f"{path} is a damaged MATLAB file: {str(error)[:120] or type(error).__name__}") from error
    missing = [name for name in names if name not in found]
    if missing:
        raise LogError(f"{path}: no variable {', '.join(missing)}")
    return {name: _real(path, name, found[name]) for name in names}


def _unpack(path: Path, data: bytes) -> bytes:
    """The same file with its zlib streams unpacked."""
    order = ORDERS.get(data[VERSION])
    if order is None:
        what = "a MATLAB 7.3 file; save it with -v7" if b"MATLAB 7.3" in data[:HEADER] else "not a MATLAB 5 file"
        raise LogError(f"{path} is {what}")
    parts = [data[:HEADER]]
    left = LIMIT
    at = HEADER
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        end = at + 8 + length
        if end > len(data):
            raise LogError(f"{path} is cut off: a variable of {length} bytes where {len(data) - at - 8} are left")
        part = _inflate(path, data[at + 8 : end], left) if kind == PACKED else data[at:end]
        parts.append(part)
        left -= len(part)
        # Packed variables stand side by side, plain ones begin at a multiple of eight.
        at = end if kind == PACKED else end + -end % 8
        parts.append(b"\0" * (-len(part) % 8))
    return b"".join(parts)


def _inflate(path: Path, packed: bytes, limit: int) -> bytes:
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(packed, max(limit, 1))
    except zlib.error as error:
        raise LogError(f"{path} is a damaged MATLAB file: {error}") from error
    if not stream.eof:
        why = f"unpacks to more than {LIMIT} bytes" if stream.unconsumed_tail else "is cut off within a variable"
        raise LogError(f"{path} {why}")
    return data


def _real(path: Path, name: str, value: object) -> FloatArray:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise LogError(f"{path}: '{name}' is not an array of real numbers")
    return np.asarray(value, dtype=np.float64)

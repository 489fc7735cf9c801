"""Arrays of a MATLAB 5 file, with a bound on what is unpacked.

The format is that of "MAT-File Format" (MathWorks), of which this reads full arrays of real
numbers. SciPy's reader is not used: it unpacks whatever a file claims, and (1.17) a wrong type
or class in a damaged file takes the whole process down.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sources import check_source
from frasa_sysid.recording import FloatArray

LIMIT = 2**28  # bytes, unpacked
HEADER = 128  # bytes
VERSION = slice(124, 128)  # of the header: version and the order of bytes
ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
PACKED = 15  # element type of a zlib stream
ARRAY = 14  # element type of an array; in it stand its flags, dimensions, name and numbers
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}  # element types
REAL_CLASSES = range(6, 16)  # of arrays: double, single and integers; below are cells, structs, text and sparse ones
COMPLEX = 0x08  # of the flags


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
    found: dict[str, FloatArray] = {}
    for order, array in _arrays(path, path.read_bytes()):
        parts = list(_elements(path, array, order))
        if len(parts) < 3:
            raise LogError(f"{path} is a damaged MATLAB file: an array without flags, size or name")
        name = parts[2][1].decode("latin-1")
        if name in names:
            found[name] = _real(path, name, parts, order)
    missing = [name for name in names if name not in found]
    if missing:
        raise LogError(f"{path}: no variable {', '.join(missing)}")
    return found


def _arrays(path: Path, data: bytes) -> Iterator[tuple[str, bytes]]:
    """The content of every array of a file, unpacked, with the order of its bytes."""
    order = ORDERS.get(data[VERSION])
    if order is None:
        what = "a MATLAB 7.3 file; save it with -v7" if b"MATLAB 7.3" in data[:HEADER] else "not a MATLAB 5 file"
        raise LogError(f"{path} is {what}")
    left = LIMIT
    at = HEADER
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        end = at + 8 + length
        if end > len(data):
            raise LogError(f"{path} is cut off: a variable of {length} bytes where {len(data) - at - 8} are left")
        part = _inflate(path, data[at + 8 : end], left) if kind == PACKED else data[at:end]
        left -= len(part)
        for inner, content in _elements(path, part, order):
            if inner == ARRAY:
                yield order, content
        # Packed variables stand side by side, plain ones begin at a multiple of eight.
        at = end if kind == PACKED else end + -end % 8


def _elements(path: Path, data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of each element of a row of them."""
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        start = at + 8
        if kind >> 16:
            # Up to four bytes stand in the tag itself, with their number in the upper half of the type.
            kind, length, start = kind & 0xFFFF, kind >> 16, at + 4
        end = start + length
        if end > len(data) or (start == at + 4 and length > 4):
            raise LogError(f"{path} is a damaged MATLAB file: {length} bytes where {len(data) - start} are left")
        yield kind, data[start:end]
        at = at + 8 if start == at + 4 else end + -end % 8


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


def _real(path: Path, name: str, parts: Sequence[tuple[int, bytes]], order: str) -> FloatArray:
    """The numbers of an array from its elements: flags, size, name and values."""
    flags, size = parts[0][1], parts[1][1]
    if len(flags) != 8 or len(size) % 4 or len(size) < 8:
        raise LogError(f"{path} is a damaged MATLAB file: '{name}' has no flags or no size")
    word = struct.unpack_from(f"{order}I", flags)[0]
    if word & 0xFF not in REAL_CLASSES or word >> 8 & COMPLEX or len(parts) < 4 or parts[3][0] not in NUMBERS:
        raise LogError(f"{path}: '{name}' is not an array of real numbers")
    shape = struct.unpack(f"{order}{len(size) // 4}i", size)
    kind, content = parts[3]
    dtype = np.dtype(order + NUMBERS[kind])
    # Exact whole numbers, for sizes that a stranger chose.
    if min(shape) < 0 or math.prod(shape) * dtype.itemsize != len(content):
        raise LogError(f"{path} is a damaged MATLAB file: '{name}' has {len(content)} bytes for a shape of {shape}")
    with np.errstate(invalid="ignore"):  # any bits may stand for a number, those of a signalling NaN too
        return np.frombuffer(content, dtype).astype(np.float64).reshape(shape, order="F")

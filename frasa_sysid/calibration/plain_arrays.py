"""The one way that NumPy's .npz files are read: plain arrays, sizes checked before memory is taken, nothing unpickled.

NumPy's own reader takes the memory that a header claims before it looks whether the numbers are there, and parses
headers as Python. Here a header must be the one line that NumPy writes, and a member as long as that line says.
"""

import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

MAGIC = b"\x93NUMPY"
LONGEST_HEADER = 2**16  # bytes
MOST_MEMBERS = 10_000
_HEADER = re.compile(
    rb"\{'descr': '([<>|=]?[a-zA-Z]\d{0,9}(?:\[\w{1,4}\])?)', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,20}, ?)*\d{0,20})\), \} *\n"
)
_KINDS = "fiubUM"  # numbers, flags, texts, times
# What zipfile raises of a damaged file; some of it is not of its own kind.
_BROKEN = (
    zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, KeyError, IndexError, NotImplementedError,
    RuntimeError, struct.error, OverflowError, UnicodeError,
)  # fmt: skip
Array = np.ndarray[Any, Any]


def array_sizes(path: Path) -> dict[str, int]:
    """The arrays of a file and how many bytes each says it unpacks to.

    Raises:
        ValueError: not such a file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except _BROKEN as error:
        raise ValueError(_line(error)) from error
    if len(members) > MOST_MEMBERS:
        raise ValueError(f"{len(members)} arrays, expected at most {MOST_MEMBERS}")
    return {one.filename.removesuffix(".npy"): one.file_size for one in members if one.filename.endswith(".npy")}


def read_arrays(path: Path, largest: int, names: Iterable[str] | None = None) -> dict[str, Array]:
    """Arrays by name.

    Args:
        path: a .npz file, packed or not.
        largest: bytes that they may have together.
        names: which; all by default.

    Raises:
        ValueError: not such a file, damaged, too large, an array of objects, or one is missing.
    """
    sizes = array_sizes(path)
    wanted = list(sizes if names is None else names)
    missing = [name for name in wanted if name not in sizes]
    if missing:
        raise ValueError(f"no array {missing[0][:60]}")
    total = sum(sizes[name] for name in wanted)
    if total > largest:
        raise ValueError(f"its arrays unpack to {total} bytes, expected at most {largest}")
    found = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for name in wanted:
                member = f"{name}.npy"
                check_packing(archive, member)
                with archive.open(member) as file:
                    # What a member says of its size bounds what is unpacked; one byte more shows that it lied.
                    found[name] = _array(file.read(sizes[name] + 1))
    except _BROKEN as error:
        raise ValueError(f"array {name[:60]}: {_line(error)}") from error
    return found


def check_packing(archive: zipfile.ZipFile, name: str) -> None:
    """See that a member of a zip file is kept as it is or deflated, as NumPy and SB3 write them.

    What the other ways raise for damage is of no kind that all Pythons have.

    Raises:
        KeyError: no such member.
        ValueError: another way.
    """
    if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{name[:60]} is packed in another way than deflate")


def _array(content: bytes) -> Array:
    if content[:6] != MAGIC or len(content) < 12:
        raise ValueError("no array of NumPy; nothing is unpickled")
    wide = content[6] > 1
    start = 12 if wide else 10
    length = int.from_bytes(content[8:start], "little")
    header = _HEADER.fullmatch(content[start : start + min(length, LONGEST_HEADER)])
    if header is None:
        raise ValueError("neither numbers nor texts; nothing is unpickled")
    descr, fortran, shape_text = (one.decode() for one in header.groups())
    try:
        dtype = np.dtype(descr)
    except TypeError:
        raise ValueError(f"{descr[:20]!r} is no type of numbers; nothing is unpickled") from None
    if dtype.kind not in _KINDS:
        raise ValueError(f"{dtype}, expected numbers; nothing is unpickled")
    shape = tuple(int(one) for one in shape_text.replace(" ", "").split(",") if one)
    data = memoryview(content)[start + length :]
    # Exact whole numbers, for sizes that a stranger chose.
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"{len(data)} bytes for {dtype} of shape {shape}")
    if not len(data):
        return np.empty(shape, dtype)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran == "True" else "C").copy()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__

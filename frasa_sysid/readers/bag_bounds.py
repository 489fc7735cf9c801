"""Bounds for what the `rosbags` package unpacks and makes of a bag: it takes whatever size a stranger's file comes to.

Its tables of decompressors are given ones that stop; definitions of messages are looked at before code is made of them.
"""

import bz2
import io
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from frasa_sysid.readers.mcap_chunks import CHUNK_LIMIT

MOST_IN_ARRAY = 100_000  # elements of an array of fixed size
MOST_TIMES = 500  # as many bytes as it has may a packed file have unpacked; logs come to five or ten
SMALL = 2**24  # bytes that it may have in any case


def bind() -> None:
    """Put the bounds in place, once for a process."""
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap

    tables: list[Any] = [ros1.decompressors]
    tables[0] |= {"bz2": unpack_bz2, "lz4": unpack_lz4}
    storage_mcap.DECOMPRESSORS.update({"lz4": lambda x, _: unpack_lz4(x), "zstd": lambda x, _: unpack_zstd(x)})
    ros2.zstd = Zstd  # type: ignore[assignment,attr-defined]


def unpack_bz2(data: bytes) -> bytes:
    """The content of a chunk, up to a limit."""
    packer = bz2.BZ2Decompressor()
    return _whole(packer.decompress(data, CHUNK_LIMIT + 1))


def unpack_lz4(data: bytes) -> bytes:
    """The content of a chunk, up to a limit."""
    return _whole(bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=CHUNK_LIMIT + 1)))


def unpack_zstd(data: bytes) -> bytes:
    """The content of a chunk or message, up to a limit."""
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        return _whole(bytes(reader.read(CHUNK_LIMIT + 1)))


def _whole(data: bytes) -> bytes:
    if len(data) > CHUNK_LIMIT:
        raise ValueError(f"a chunk unpacks to more than {CHUNK_LIMIT} bytes")
    return data


class Zstd:
    """What `rosbags` uses of a module of this name."""

    decompress = staticmethod(unpack_zstd)

    @staticmethod
    def open(file: Any, _mode: str) -> "_Bounded":  # noqa: ANN401 - a file
        """A reader of a packed file."""
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        return _Bounded(zstandard.ZstdDecompressor().stream_reader(file), max(SMALL, MOST_TIMES * size))


class _Bounded:
    """A reader that gives up rather than fill the disk."""

    def __init__(self, reader: Any, most: int) -> None:  # noqa: ANN401 - of zstandard
        self._reader, self._left = reader, most

    def __enter__(self) -> "_Bounded":
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def read(self, size: int = -1) -> bytes:
        """The next bytes."""
        data = bytes(self._reader.read(size))
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"the packed bag unpacks to more than {MOST_TIMES} times its size")
        return data


def check_definitions(types: Any) -> None:  # noqa: ANN401 - of rosbags: fields by name of type
    """See that no message has an array that takes memory without taking bytes.

    Raises:
        ValueError: one has.
    """
    from rosbags.interfaces import Nodetype

    empty = {name for name, (_, fields) in types.items() if not fields}
    for name, (_, fields) in types.items():
        for field, (kind, of) in fields:
            if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                continue
            (inner, what), size = of
            if inner == Nodetype.NAME and what in empty:
                raise ValueError(f"{name}: {field} is an array of empty messages")
            if kind == Nodetype.ARRAY and size > MOST_IN_ARRAY:
                raise ValueError(f"{name}: {field} is an array of {size} elements")

"""Content that is small on disk and large in memory, and content that does something when it is unpickled."""

import bz2
import gzip
import io
import pickle
import struct
import zipfile
import zlib
from functools import cache

import numpy as np

CANARY = "frasa-fuzz-was-here"


class Executes:
    """Leaves a file behind when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.system, (f"touch {CANARY}",)


def pickled() -> bytes:
    """A pickle that runs a command."""
    return pickle.dumps(Executes())


@cache
def gzip_bomb(unit: bytes = b"[", megabytes: int = 600) -> bytes:
    """Some hundred MB of one text: one packed member again and again."""
    return gzip_of(unit * (2**24 // len(unit))) * (megabytes // 16)


@cache
def gzip_of(content: bytes) -> bytes:
    """Packed."""
    return gzip.compress(content, 1, mtime=0)


@cache
def many(head: bytes, unit: bytes, megabytes: int) -> bytes:
    """A head and a text again and again, packed: one packed member again and again."""
    return gzip_of(head) + gzip_of(unit * (2**24 // len(unit))) * (megabytes // 16)


def npy(header: str, data: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    """A .npy file with any header."""
    text = header.encode() + b"\n"
    size = len(text).to_bytes(2 if version == (1, 0) else 4, "little")
    return b"\x93NUMPY" + bytes(version) + size + text + data


def objects() -> bytes:
    """A .npy file with an object that runs a command."""
    file = io.BytesIO()
    np.save(file, np.array([Executes()], dtype=object), allow_pickle=True)
    return file.getvalue()


def packed(members: dict[str, bytes]) -> bytes:
    """A zip file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


@cache
def zip_bomb(name: str, head: bytes, gigabytes: int = 3) -> bytes:
    """A zip file with a member of zeros behind a head; put together from one packed block, for it is the same again."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**26)) + packer.flush(zlib.Z_FULL_FLUSH)
    data = first + block * (16 * gigabytes) + packer.flush()
    size = len(head) + gigabytes * 2**30
    sizes = struct.pack("<QQ", size, len(data))
    common = struct.pack("<HHHHHI", 45, 0, 8, 0, 33, 0) + b"\xff" * 8
    extra = struct.pack("<HH", 1, 16) + sizes
    local = b"PK\x03\x04" + common + struct.pack("<HH", len(name), len(extra)) + name.encode() + extra
    entry = b"PK\x01\x02" + struct.pack("<H", 45) + common
    entry += struct.pack("<HHHHHII", len(name), len(extra), 0, 0, 0, 0, 0) + name.encode() + extra
    end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(entry), len(local) + len(data), 0)
    return local + data + entry + end


def arrays_bombs(name: str, beside: dict[str, bytes]) -> dict[str, bytes]:
    """Files of arrays that claim, unpack to or execute what they should not."""
    claim = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }"
    huge = claim % (3 * 2**27)
    return {
        "claims 8 EB": packed({**beside, f"{name}.npy": npy(claim % 10**18, bytes(80))}),
        "claims 3 GB": packed({**beside, f"{name}.npy": npy(huge, bytes(80))}),
        "negative": packed({**beside, f"{name}.npy": npy(claim % -5, bytes(80))}),
        "object array": packed({**beside, f"{name}.npy": objects()}),
        "pickle": packed({**beside, f"{name}.npy": pickled()}),
        "whole file is a pickle": pickled(),
        "header runs code": packed(
            {**beside, f"{name}.npy": npy(f"__import__('os').system('touch {CANARY}')", bytes(80))}
        ),
        "deep header": packed({**beside, f"{name}.npy": npy("(" * 9000 + ")" * 9000, b"", (2, 0))}),
        "zip bomb": zip_bomb(f"{name}.npy", npy(huge)),
    }


@cache
def bz2_bomb(gigabytes: int = 3) -> bytes:
    """Zeros: one packed block again and again."""
    return bz2.compress(bytes(2**26)) * (16 * gigabytes)

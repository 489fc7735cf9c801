"""The chunks of an MCAP file: unpacked within bounds, held against their checksum, taken apart."""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from frasa_sysid.errors import LogError

HEAD = struct.Struct("<BQ")
# A message record from its opcode on: one row of this, then the message itself.
RECORD_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
MESSAGE_HEAD = RECORD_HEAD.itemsize - HEAD.size  # bytes of a record before the message itself
COMPRESSIONS = ("", "lz4", "zstd")
MOST_OTHERS = 10_000  # records of a chunk that are neither messages nor describe any
CHUNK_LIMIT = 2**28  # bytes after decompression; recorders write chunks of 1 to 16 MB
PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError, RuntimeError, EOFError)


@dataclass(frozen=True)
class Frame:
    """One record as it stands in the file; `whole` is False when the file ends inside it."""

    offset: int
    opcode: int
    body: bytes
    whole: bool = True


@dataclass(frozen=True)
class Messages:
    """n message records that stand one after the other, not taken apart yet: there may be millions.

    Attributes:
        data: bytes that they stand in.
        heads: channel, log and publish time [ns] of each, shape (n,), see `RECORD_HEAD`.
        starts: where the message itself begins in `data`, shape (n,).
        sizes: its bytes, shape (n,).
    """

    data: bytes
    heads: npt.NDArray[np.void]
    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]


def stream_of(body: bytes) -> ReadDataStream:
    """A record's body as the library wants it."""
    return ReadDataStream(io.BytesIO(body))


def parse(frame: Frame) -> Schema | Channel | Messages:
    """One of the three records that matter, parsed."""
    record: Schema | Channel
    if frame.opcode == Opcode.SCHEMA:
        record = Schema.read(stream_of(frame.body))
    elif frame.opcode == Opcode.CHANNEL:
        record = Channel.read(stream_of(frame.body))
    else:
        return messages_at(HEAD.pack(frame.opcode, len(frame.body)) + frame.body, [0])
    return record


def messages_at(data: bytes, offsets: list[int]) -> Messages:
    """The message records that begin at some offsets, one at least.

    Raises:
        ValueError: a record that is too short for a message.
    """
    begins = np.array(offsets, dtype=np.int64)
    size = RECORD_HEAD.itemsize
    if len(data) < int(begins[-1]) + size:
        raise ValueError("a message record is too short")
    windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), size)
    heads = np.ascontiguousarray(windows[begins]).view(RECORD_HEAD)[:, 0]
    sizes = heads["length"].astype(np.int64) - MESSAGE_HEAD
    if (sizes < 0).any():
        raise ValueError("a message record is too short")
    return Messages(data, heads, begins + size, sizes)


def chunk_records(path: Path, frame: Frame) -> Iterator[Schema | Channel | Messages]:
    """The records inside a chunk; of one that is cut short, those that came before the cut.

    Raises:
        LogError: a compression that is not known, or an absurd size.
        ValueError: it does not match its checksum or cannot be unpacked.
    """
    if not frame.whole and len(frame.body) < 40:
        return
    chunk = Chunk.read(stream_of(frame.body))
    if chunk.compression not in COMPRESSIONS:
        known = ", ".join(repr(one) for one in COMPRESSIONS)
        raise LogError(
            f"{path}: the chunk at byte {frame.offset} is compressed with '{chunk.compression}', known are {known}"
        )
    if chunk.uncompressed_size > CHUNK_LIMIT:
        raise LogError(
            f"{path}: the chunk at byte {frame.offset} claims {chunk.uncompressed_size} bytes, "
            f"the limit is {CHUNK_LIMIT}"
        )
    data = _unpack(chunk) if frame.whole else _unpack_start(chunk)
    if frame.whole and chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("the chunk does not match its checksum (CRC)")
    yield from _inner_records(data, frame.whole)


def _inner_records(data: bytes, whole: bool) -> Iterator[Schema | Channel | Messages]:
    """The records of a chunk, messages that follow one another together."""
    offset, end, others = 0, len(data), 0
    offsets: list[int] = []
    message, head, unpack = int(Opcode.MESSAGE), HEAD.size, HEAD.unpack_from  # looked up once, not a million times
    while offset < end:
        after = offset + head
        if after <= end:
            opcode, length = unpack(data, offset)
        if after > end or length > end - after:
            if whole:
                raise ValueError("a record inside the chunk is longer than the chunk")
            break
        if opcode == message:
            offsets.append(offset)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            # What describes a channel counts from here on.
            if offsets:
                yield messages_at(data, offsets)
                offsets = []
            yield parse(Frame(offset, opcode, data[after : after + length]))
        else:
            # Kinds that are not known are passed over, but a chunk of nothing else is no log.
            others += 1
            if opcode == 0 or others > MOST_OTHERS:
                raise ValueError(f"{others} records inside the chunk that are no messages")
        offset = after + length
    if offsets:
        yield messages_at(data, offsets)


def _unpack(chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "lz4":
        # One byte more than is claimed shows a false claim, and no more than that is unpacked.
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size + 1))
    else:
        # The frame's own claim decides how much memory is taken: look at it first.
        if zstandard.frame_content_size(chunk.data) > CHUNK_LIMIT:
            raise ValueError("the compressed frame claims an absurd size")
        data = zstandard.decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"the chunk unpacks to {len(data)} bytes, it claims {chunk.uncompressed_size}")
    return data


def _unpack_start(chunk: Chunk) -> bytes:
    """What the first bytes of a cut-off chunk unpack to; its checksum cannot be compared."""
    if chunk.compression == "":
        return chunk.data
    try:
        if chunk.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=CHUNK_LIMIT))
        if len(chunk.data) < 18 or zstandard.frame_content_size(chunk.data) > CHUNK_LIMIT:
            return b""
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            return bytes(reader.read(min(chunk.uncompressed_size, CHUNK_LIMIT)))
    except PARSE_ERRORS:
        return b""

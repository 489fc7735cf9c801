"""The chunks of an MCAP file: unpacked within bounds, held against their checksum, taken apart."""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

from frasa_sysid.errors import LogError

HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
COMPRESSIONS = ("", "lz4", "zstd")
CHUNK_LIMIT = 2**28  # bytes after decompression; recorders write chunks of 1 to 16 MB
PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError, RuntimeError, EOFError)


@dataclass(frozen=True)
class Frame:
    """One record as it stands in the file; `whole` is False when the file ends inside it."""

    offset: int
    opcode: int
    body: bytes
    whole: bool = True


def stream_of(body: bytes) -> ReadDataStream:
    """A record's body as the library wants it."""
    return ReadDataStream(io.BytesIO(body))


def parse(frame: Frame) -> Schema | Channel | Message:
    """One of the three records that matter, parsed."""
    record: Schema | Channel | Message
    if frame.opcode == Opcode.SCHEMA:
        record = Schema.read(stream_of(frame.body))
    elif frame.opcode == Opcode.CHANNEL:
        record = Channel.read(stream_of(frame.body))
    else:
        channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(frame.body)
        record = Message(channel, log_time, frame.body[MESSAGE_HEAD.size :], publish_time, sequence)
    return record


def chunk_records(path: Path, frame: Frame) -> Iterator[Schema | Channel | Message]:
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


def _inner_records(data: bytes, whole: bool) -> Iterator[Schema | Channel | Message]:
    offset = 0
    while offset < len(data):
        end_of_head = offset + HEAD.size
        if end_of_head <= len(data):
            opcode, length = HEAD.unpack_from(data, offset)
        if end_of_head > len(data) or length > len(data) - end_of_head:
            if whole:
                raise ValueError("a record inside the chunk is longer than the chunk")
            return
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            yield parse(Frame(offset, opcode, data[end_of_head : end_of_head + length]))
        offset = end_of_head + length


def _unpack(chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "lz4":
        data: bytes = lz4.frame.decompress(chunk.data)
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
        return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
    except PARSE_ERRORS:
        return b""

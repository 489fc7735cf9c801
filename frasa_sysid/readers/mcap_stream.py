"""The messages of an MCAP file, read front to back and checked.

The official reader goes by the index at the end of the file: a file that was cut off
gives it nothing, a flipped byte goes unseen unless asked for, and not even then when
there is no chunk index. Here every record is framed against the bytes that are really
there, every checksum that the file holds is compared, and a file that ends early gives
what it has. Records and chunks are parsed by the `mcap` library.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata, MetadataIndex, Schema, Statistics

from frasa_sysid.errors import LogError
from frasa_sysid.readers.mcap_chunks import HEAD, PARSE_ERRORS, Frame, Messages, chunk_records, parse, stream_of

MAGIC = b"\x89MCAP0\r\n"
RECORD_LIMIT = 2**28  # bytes; a bench log's largest record is a few MB, an attached original 64 MiB


@dataclass
class StreamReport:
    """What was met besides the messages; filled while the stream is read.

    Attributes:
        metadata: metadata records in file order.
        messages: messages handed out.
        declared: number of messages according to the file's statistics.
        indexed_metadata: names of metadata records according to the file's index.
        cut_at: byte at which the file ends too early, or None.
        strays: messages of channels that the file does not describe.
        summary_damaged: the index at the end does not match its checksum.
    """

    metadata: list[Metadata] = field(default_factory=list)
    messages: int = 0
    declared: int | None = None
    indexed_metadata: list[str] = field(default_factory=list)
    cut_at: int | None = None
    strays: int = 0
    summary_damaged: bool = False


@dataclass(frozen=True)
class Batch:
    """n messages of one channel in the order they were written.

    Attributes:
        channel: theirs.
        schema: of the channel; None when it has none.
        data: bytes that they stand in.
        starts, sizes: where each begins in `data` and its bytes, shape (n,).
        log, publish: when each was recorded and sent [ns], shape (n,).
        places: how many messages of the file came before each, shape (n,).
    """

    channel: Channel
    schema: Schema | None
    data: bytes
    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    log: npt.NDArray[np.uint64]
    publish: npt.NDArray[np.uint64]
    places: npt.NDArray[np.int64]


def read_batches(path: Path, report: StreamReport) -> Iterator[Batch]:
    """The messages of a file, those of one channel that stand in one chunk together.

    Args:
        path: the file.
        report: filled on the way; complete when the iteration is.

    Raises:
        LogError: no MCAP file, damaged, or a compression that is not known.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{path} is not an MCAP file: it does not begin with the MCAP magic bytes")
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in _records(path, file, size, report):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            else:
                yield from _batches(record, channels, schemas, report)


def _batches(
    found: Messages, channels: dict[int, Channel], schemas: dict[int, Schema], report: StreamReport
) -> Iterator[Batch]:
    numbers = found.heads["channel"]
    first = report.messages + report.strays
    for number in np.unique(numbers).tolist():
        rows = np.flatnonzero(numbers == number)
        if number not in channels:
            report.strays += rows.size
            continue
        report.messages += rows.size
        channel, heads = channels[number], found.heads[rows]
        yield Batch(
            channel,
            schemas.get(channel.schema_id),
            found.data,
            found.starts[rows],
            found.sizes[rows],
            heads["log"].astype(np.uint64),
            heads["publish"].astype(np.uint64),
            first + rows,
        )


def _records(path: Path, file: BinaryIO, size: int, report: StreamReport) -> Iterator[Schema | Channel | Messages]:
    crc = zlib.crc32(MAGIC)
    for frame in _frames(path, file, size, report):
        try:
            if frame.opcode == Opcode.CHUNK:
                yield from chunk_records(path, frame)
            elif not frame.whole:
                return
            elif frame.opcode == Opcode.DATA_END:
                _check_data(path, frame, crc)
                _read_summary(path, file, size, report)
                return
            elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                yield parse(frame)
            elif frame.opcode == Opcode.METADATA:
                report.metadata.append(Metadata.read(stream_of(frame.body)))
            elif frame.opcode == Opcode.ATTACHMENT:
                _check_attachment(path, frame)
        except PARSE_ERRORS as error:
            raise LogError(
                f"{path} is damaged in the record at byte {frame.offset}: {error or 'it is cut short'}"
            ) from error
        crc = zlib.crc32(frame.body, zlib.crc32(HEAD.pack(frame.opcode, len(frame.body)), crc))


def _frames(path: Path, file: BinaryIO, size: int, report: StreamReport) -> Iterator[Frame]:
    # A recorder that crashed leaves no magic bytes at the end; if they are there and
    # the records still do not fit, then a length was damaged.
    closed = _ends_with_magic(file, size)
    offset = len(MAGIC)
    while True:
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, size)
        left = size - offset - HEAD.size
        if opcode == 0 and len(head) == HEAD.size:
            raise LogError(f"{path} is damaged at byte {offset}: a record of no kind")
        if length > left:
            if closed:
                raise LogError(f"{path} is damaged at byte {offset}: a record of {length} bytes where {left} are left")
            report.cut_at = offset
            body = file.read(min(max(left, 0), RECORD_LIMIT))
            if opcode:
                yield Frame(offset, opcode, body, whole=False)
            return
        if length > RECORD_LIMIT:
            raise LogError(f"{path}: a record of {length} bytes at byte {offset}, the limit is {RECORD_LIMIT}")
        yield Frame(offset, opcode, file.read(length))
        offset += HEAD.size + length


def _ends_with_magic(file: BinaryIO, size: int) -> bool:
    here = file.tell()
    file.seek(max(size - len(MAGIC), here))
    end = file.read()
    file.seek(here)
    return end == MAGIC


def _check_data(path: Path, frame: Frame, crc: int) -> None:
    expected = DataEnd.read(stream_of(frame.body)).data_section_crc
    if expected not in (0, crc):
        raise LogError(f"{path} is damaged: its data do not match their checksum (CRC)")


def _check_attachment(path: Path, frame: Frame) -> None:
    expected = struct.unpack("<I", frame.body[-4:])[0]
    if expected not in (0, zlib.crc32(frame.body[:-4])):
        raise LogError(f"{path} is damaged: the attachment at byte {frame.offset} does not match its checksum (CRC)")


def _read_summary(path: Path, file: BinaryIO, size: int, report: StreamReport) -> None:
    """The statistics at the end; the data are whole without them, so damage here is only reported."""
    summary = file.read(min(size, RECORD_LIMIT))
    if not summary.endswith(MAGIC):
        report.cut_at = size
        return
    try:
        offset = 0
        while offset + HEAD.size <= len(summary) - len(MAGIC):
            opcode, length = HEAD.unpack_from(summary, offset)
            body = summary[offset + HEAD.size : offset + HEAD.size + length]
            if opcode == Opcode.STATISTICS:
                report.declared = Statistics.read(stream_of(body)).message_count
            if opcode == Opcode.METADATA_INDEX:
                report.indexed_metadata.append(MetadataIndex.read(stream_of(body)).name)
            if opcode == Opcode.FOOTER:
                footer = Footer.read(stream_of(body))
                crc = zlib.crc32(summary[: offset + HEAD.size + 16])
                report.summary_damaged = footer.summary_crc not in (0, crc)
                return
            offset += HEAD.size + length
        report.summary_damaged = True
    except PARSE_ERRORS:
        report.summary_damaged = True

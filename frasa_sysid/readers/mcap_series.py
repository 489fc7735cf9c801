"""The readings of a file of messages, quantity by quantity, before a clock is chosen and runs are cut.

A reading takes eight bytes a number and four words beside them, however long the file is.
"""

from array import array
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.errors import LogError
from frasa_sysid.readers.decoders import Decode, Decoded, Reading, decoder_for
from frasa_sysid.readers.fields import ReadingError
from frasa_sysid.readers.mapped import extractor_of
from frasa_sysid.readers.mcap_stream import StreamReport, read_messages
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.recording import Clock, Fault, FloatArray

Stamps = npt.NDArray[np.uint64]
CLOCKS: tuple[Clock, ...] = ("header", "publish", "log")
MISSING_STAMPS = 0.01  # share (and one: simulated time begins at 0) that a stamped channel may lack
LATEST = 2**63  # ns; the year 2262
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass
class Series:
    """The readings of one quantity on one topic, in file order; stamps [ns], 0 where there is none."""

    topic: str
    name: str
    unit: str | None
    stamps: dict[Clock, "array[int]"] = field(default_factory=lambda: {clock: array("Q") for clock in CLOCKS})
    columns: list[tuple[str, ...]] = field(default_factory=list)
    _numbers: "array[float]" = field(default_factory=lambda: array("d"))
    _ends: "array[int]" = field(default_factory=lambda: array("Q", [0]))
    _seen: dict[tuple[str, ...], tuple[str, ...]] = field(default_factory=dict)
    _times: dict[Clock, Stamps] = field(default_factory=dict)

    def add(self, reading: Reading, stamp: int | None, publish: int, log: int) -> None:
        """Append one reading with its stamps [ns]."""
        values = array("d", [float(value) for value in reading.values])  # may fail: before anything is kept
        for clock, time in zip(CLOCKS, (stamp or 0, publish, log), strict=True):
            self.stamps[clock].append(time if 0 < time < LATEST else 0)
        # Every message names its joints anew: the same names are kept once.
        self.columns.append(self._seen.setdefault(reading.columns, reading.columns))
        self._numbers.extend(values)
        self._ends.append(len(self._numbers))

    @property
    def size(self) -> int:
        """Number of readings."""
        return len(self.columns)

    def values(self, i: int) -> FloatArray:
        """The numbers of one reading, shape (k,)."""
        return np.array(self._numbers[self._ends[i] : self._ends[i + 1]])

    def table(self) -> FloatArray | None:
        """All readings, shape (T, k), where all have the same columns; else None. The last thing to ask for."""
        if len(self._seen) != 1:
            return None
        return np.frombuffer(self._numbers).reshape(self.size, -1)

    def has(self, clock: Clock) -> bool:
        """Whether (nearly) all readings carry that clock's stamp."""
        lacking = int((self.times(clock) == 0).sum())
        return lacking <= max(1, MISSING_STAMPS * self.size) and lacking < self.size

    def times(self, clock: Clock) -> Stamps:
        """All stamps of one clock [ns], shape (T,); made once, for many runs ask."""
        if clock not in self._times:
            self._times[clock] = np.array(self.stamps[clock], dtype=np.uint64)
        return self._times[clock]


@dataclass
class Collected:
    """Everything of use in one file."""

    series: dict[tuple[str, str], Series] = field(default_factory=dict)
    report: StreamReport = field(default_factory=StreamReport)
    skipped: Counter[str] = field(default_factory=Counter)
    unused: set[str] = field(default_factory=set)


def collect(path: Path, mapping: SignalMap | None = None) -> Collected:
    """Decode all messages of a file that frasa understands.

    Args:
        path: an MCAP file.
        mapping: which topics are which signals; by default the message types say it.

    Raises:
        LogError: no MCAP file, a damaged one, or a package for its encoding is not installed.
    """
    collected = Collected()
    ros2 = DecoderFactory()
    decoders: dict[int, Decode | None] = {}
    for channel, schema, message in read_messages(path, collected.report):
        if channel.id not in decoders:
            decoders[channel.id] = _find_decoder(channel, schema, ros2, collected, mapping)
        decode = decoders[channel.id]
        if decode is not None:
            take(collected, channel.topic, decode, message.data, message.publish_time, message.log_time)
    return collected


def _find_decoder(
    channel: Channel, schema: Schema | None, ros2: DecoderFactory, collected: Collected, mapping: SignalMap | None
) -> Decode | None:
    kind = schema.name if schema else "no schema"
    chosen = None if mapping is None else extractor_of(mapping, channel.topic)
    try:
        decode = decoder_for(channel, schema, ros2, chosen, by_type=mapping is None)
    except LogError:
        raise
    except Exception:  # the parser runs on a definition from the file: anything may come out
        collected.skipped[f"{channel.topic} ({kind}: its definition cannot be parsed)"] += 1
        return None
    if decode is None:
        collected.unused.add(f"{channel.topic} ({kind}, {channel.message_encoding or 'no encoding'})")
    return decode


def take(collected: Collected, topic: str, decode: Decode, data: bytes, publish: int, log: int) -> None:
    """Decode one message and keep its readings, or count it as skipped.

    Args:
        collected: where they are kept.
        topic: of the message.
        decode: of its channel.
        data: its bytes.
        publish: when it was sent [ns].
        log: when it was recorded [ns].
    """
    try:
        _keep(collected, topic, decode(data), publish, log)
    except ReadingError as error:
        collected.skipped[f"{topic} (messages: {error})"] += 1
    except Exception:  # generated from the file's own definition: anything may come out
        packed = data.startswith(ZSTD_MAGIC)
        why = "compressed one by one, convert the bag with compression mode FILE" if packed else "cannot be decoded"
        collected.skipped[f"{topic} (messages: {why})"] += 1


def _keep(collected: Collected, topic: str, decoded: Decoded, publish: int, log: int) -> None:
    for reading in decoded.readings:
        key = (topic, reading.name)
        series = collected.series.get(key) or Series(topic, reading.name, reading.unit)
        series.add(reading, decoded.stamp, publish, log)
        collected.series[key] = series


def nothing_found(collected: Collected, mapping: SignalMap | None = None) -> str:
    """Why a file gave no series, with what it holds instead."""
    if collected.report.messages == 0:
        cut = collected.report.cut_at
        return "it holds no messages" if cut is None else f"it is cut off at byte {cut}, before its first message"
    seen = ", ".join(sorted([*collected.skipped, *collected.unused])) or "only empty messages"
    if mapping is not None:
        return f"nothing that map {mapping.name} names; it holds {seen}"
    return f"nothing that frasa can read; expected JointState, DynamicJointState or Imu (or --map), found {seen}"


def file_faults(collected: Collected) -> list[Fault]:
    """What was wrong with the file as a whole."""
    report = collected.report
    faults = [
        Fault("channel_skipped", count, f"{count} of {what}; skipped")
        for what, count in sorted(collected.skipped.items())
    ]
    if report.cut_at is not None:
        text = f"the file is cut off after byte {report.cut_at}; {report.messages} messages were recovered"
        faults.append(Fault("truncated", report.messages, text))
    if report.strays:
        text = f"{report.strays} messages belong to channels that the file does not describe; dropped"
        faults.append(Fault("unknown_channel", report.strays, text))
    if report.summary_damaged:
        text = "the index at the end does not match its checksum; it was not used, the data are whole"
        faults.append(Fault("summary_damaged", 1, text))
    elif report.declared not in (None, report.messages + report.strays):
        text = f"the file's statistics declare {report.declared} messages, it holds {report.messages + report.strays}"
        faults.append(Fault("lost_messages", abs((report.declared or 0) - report.messages), text))
    return faults

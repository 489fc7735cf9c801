"""The readings of an MCAP file, quantity by quantity, before a clock is chosen and runs are cut."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, Message, Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.readers.decoders import Decode, Reading, decoder_for
from frasa_sysid.readers.mcap_stream import StreamReport, read_messages
from frasa_sysid.recording import Clock, Fault

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
    stamps: dict[Clock, list[int]] = field(default_factory=lambda: {clock: [] for clock in CLOCKS})
    columns: list[tuple[str, ...]] = field(default_factory=list)
    values: list[Sequence[float]] = field(default_factory=list)
    _times: dict[Clock, Stamps] = field(default_factory=dict)

    def add(self, reading: Reading, stamp: int | None, message: Message) -> None:
        """Append one reading."""
        values = [float(value) for value in reading.values]  # may fail: before anything is kept
        for clock, time in zip(CLOCKS, (stamp or 0, message.publish_time, message.log_time), strict=True):
            self.stamps[clock].append(time if 0 < time < LATEST else 0)
        self.columns.append(reading.columns)
        self.values.append(values)

    def has(self, clock: Clock) -> bool:
        """Whether (nearly) all readings carry that clock's stamp."""
        lacking = int((self.times(clock) == 0).sum())
        return lacking <= max(1, MISSING_STAMPS * len(self.values)) and lacking < len(self.values)

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


def collect(path: Path) -> Collected:
    """Decode all messages of a file that frasa understands.

    Raises:
        LogError: no MCAP file, or a damaged one.
    """
    collected = Collected()
    ros2 = DecoderFactory()
    decoders: dict[int, Decode | None] = {}
    for channel, schema, message in read_messages(path, collected.report):
        if channel.id not in decoders:
            decoders[channel.id] = _find_decoder(channel, schema, ros2, collected)
        decode = decoders[channel.id]
        if decode is not None:
            _decode_into(collected, channel, decode, message)
    return collected


def _find_decoder(channel: Channel, schema: Schema | None, ros2: DecoderFactory, collected: Collected) -> Decode | None:
    kind = schema.name if schema else "no schema"
    try:
        decode = decoder_for(channel, schema, ros2)
    except Exception:  # the parser runs on a definition from the file: anything may come out
        collected.skipped[f"{channel.topic} ({kind}: its definition cannot be parsed)"] += 1
        return None
    if decode is None:
        collected.unused.add(f"{channel.topic} ({kind}, {channel.message_encoding or 'no encoding'})")
    return decode


def _decode_into(collected: Collected, channel: Channel, decode: Decode, message: Message) -> None:
    try:
        decoded = decode(message.data)
        for reading in decoded.readings:
            key = (channel.topic, reading.name)
            if key not in collected.series:
                collected.series[key] = Series(channel.topic, reading.name, reading.unit)
            collected.series[key].add(reading, decoded.stamp, message)
    except Exception:  # generated from the file's own definition: anything may come out
        packed = message.data.startswith(ZSTD_MAGIC)
        why = "compressed one by one, convert the bag with compression mode FILE" if packed else "cannot be decoded"
        collected.skipped[f"{channel.topic} (messages: {why})"] += 1


def nothing_found(collected: Collected) -> str:
    """Why a file gave no series, with what it holds instead."""
    if collected.report.messages == 0:
        cut = collected.report.cut_at
        return "it holds no messages" if cut is None else f"it is cut off at byte {cut}, before its first message"
    seen = ", ".join(sorted([*collected.skipped, *collected.unused])) or "only empty messages"
    return f"nothing that frasa can read; expected JointState, DynamicJointState or Imu, found {seen}"


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

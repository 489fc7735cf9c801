"""The readings of a file of messages, quantity by quantity, before a clock is chosen and runs are cut.

Messages that are alike are read many at once, at the places that their decoder showed (`message_layout`); all others
one by one. What is kept of a long log is bounded (`kept_windows`).
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.errors import LogError
from frasa_sysid.readers.decoders import Decode, Decoded, decoder_for
from frasa_sysid.readers.fields import ReadingError
from frasa_sysid.readers.kept_windows import KeptWindows, Limit
from frasa_sysid.readers.mapped import extractor_of
from frasa_sysid.readers.mcap_stream import Batch, StreamReport, read_batches
from frasa_sysid.readers.message_layout import Layout, learn
from frasa_sysid.readers.series import Block, Series
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.recording import Fault

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ALIKE = 24  # messages of one size in a batch from which on their layout is worth learning
LAYOUTS = 6  # of one channel and size at most: where more differs than numbers, the decoder is as fast
CHECKED = 1024  # messages that are taken one by one between two looks at the room that is left

Rows = npt.NDArray[np.int64]


@dataclass
class Collected:
    """Everything of use in one file."""

    series: dict[tuple[str, str], Series] = field(default_factory=dict)
    report: StreamReport = field(default_factory=StreamReport)
    skipped: Counter[str] = field(default_factory=Counter)
    unused: set[str] = field(default_factory=set)
    windows: KeptWindows = field(default_factory=KeptWindows)
    taken: int = 0

    def of(self, topic: str, name: str, unit: str | None) -> Series:
        """The series of one quantity on one topic; a new one where there was none."""
        return self.series.setdefault((topic, name), Series(topic, name, unit))

    def make_room(self, final: bool = False) -> None:
        """Keep no more than the limit allows."""
        self.windows.make_room(self.series.values(), final)


def collect(path: Path, mapping: SignalMap | None = None, limit: Limit | None = None) -> Collected:
    """Decode all messages of a file that frasa understands.

    Args:
        path: an MCAP file.
        mapping: which topics are which signals; by default the message types say it.
        limit: how much of it is kept; by default as much as usual.

    Raises:
        LogError: no MCAP file, a damaged one, or a package for its encoding is not installed.
    """
    collected = Collected(windows=KeptWindows(limit or Limit()))
    ros2 = DecoderFactory()
    takers: dict[int, _Taker | None] = {}
    for batch in read_batches(path, collected.report):
        channel = batch.channel
        if channel.id not in takers:
            decode = _find_decoder(channel, batch.schema, ros2, collected, mapping)
            takers[channel.id] = None if decode is None else _Taker(collected, decode)
        taker = takers[channel.id]
        if taker is not None:
            taker.take(batch)
            collected.make_room()
    collected.make_room(final=True)
    # Alike messages were taken together: what came first in the file comes first again.
    collected.series = dict(sorted(collected.series.items(), key=lambda item: item[1].first))
    return collected


class _Taker:
    """Takes the messages of one channel, alike ones together."""

    def __init__(self, collected: Collected, decode: Decode) -> None:
        self._collected, self._decode = collected, decode
        self._layouts: dict[int, list[Layout]] = {}
        self._full: set[int] = set()  # sizes of which no further layout is learned

    def take(self, batch: Batch) -> None:
        """Keep the readings of a batch."""
        windows = self._collected.windows.of(batch.log)
        left = np.ones(batch.starts.size, dtype=bool)
        sizes, counts = np.unique(batch.sizes, return_counts=True)
        for size, count in zip(sizes.tolist(), counts.tolist(), strict=True):
            if size in self._layouts or (count >= ALIKE and size not in self._full):
                rows = np.flatnonzero(batch.sizes == size)
                left[rows] = self._together(batch, windows, rows, size)
        for i in np.flatnonzero(left).tolist():
            start = int(batch.starts[i])
            data = batch.data[start : start + int(batch.sizes[i])]
            times = (int(batch.publish[i]), int(batch.log[i]))
            _take(
                self._collected, batch.channel.topic, self._decode, data, int(windows[i]), int(batch.places[i]), times
            )

    def _together(self, batch: Batch, windows: Rows, rows: Rows, size: int) -> npt.NDArray[np.bool_]:
        """Read the messages of one size that have a known layout; which of them have none."""
        every = np.lib.stride_tricks.sliding_window_view(np.frombuffer(batch.data, np.uint8), size)[batch.starts[rows]]
        left = np.ones(rows.size, dtype=bool)
        known = self._layouts.setdefault(size, [])
        for layout in known:
            self._read(layout, batch, windows, rows, every, left)
        while left.sum() >= ALIKE and size not in self._full:
            layout_or_none = learn(self._decode, every[int(np.argmax(left))].tobytes())
            if layout_or_none is None or len(known) + 1 >= LAYOUTS:
                self._full.add(size)
            if layout_or_none is None:
                break
            known.append(layout_or_none)
            self._read(layout_or_none, batch, windows, rows, every, left)
        return left

    def _read(
        self,
        layout: Layout,
        batch: Batch,
        windows: Rows,
        rows: Rows,
        every: npt.NDArray[np.uint8],
        left: npt.NDArray[np.bool_],
    ) -> None:
        fitting = left & layout.matches(every)
        if not fitting.any():
            return
        left &= ~fitting
        messages, chosen = (every if fitting.all() else every[fitting]), rows[fitting]
        stamps = np.column_stack([layout.stamps(messages), batch.publish[chosen], batch.log[chosen]])
        inside = windows[chosen]
        numbers = np.unique(inside).tolist()
        for place in layout.places:
            reading = place.reading
            values = layout.values(messages, place)
            series = self._collected.of(batch.channel.topic, reading.name, reading.unit)
            for window in numbers:
                part = slice(None) if len(numbers) == 1 else inside == window
                block = Block(reading.columns, batch.places[chosen][part], stamps[part], values[part])
                series.add_rows(window, block)
                self._collected.windows.count(window, len(block.places), block.values.size)


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
    collected.taken += 1
    window = int(collected.windows.of(np.array([log], np.uint64))[0])
    _take(collected, topic, decode, data, window, collected.taken, (publish, log))
    if collected.taken % CHECKED == 0:
        collected.make_room()


def _take(
    collected: Collected, topic: str, decode: Decode, data: bytes, window: int, place: int, times: tuple[int, int]
) -> None:
    try:
        _keep(collected, topic, decode(data), window, place, times)
    except ReadingError as error:
        collected.skipped[f"{topic} (messages: {error})"] += 1
    except Exception:  # generated from the file's own definition: anything may come out
        packed = data.startswith(ZSTD_MAGIC)
        why = "compressed one by one, convert the bag with compression mode FILE" if packed else "cannot be decoded"
        collected.skipped[f"{topic} (messages: {why})"] += 1


def _keep(collected: Collected, topic: str, decoded: Decoded, window: int, place: int, times: tuple[int, int]) -> None:
    for reading in decoded.readings:
        known = collected.series.get((topic, reading.name))
        series = known or Series(topic, reading.name, reading.unit)
        numbers = series.add(window, reading, place, (decoded.stamp or 0, *times))
        collected.windows.count(window, 1, numbers)
        if known is None:
            collected.series[topic, reading.name] = series


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

"""MCAP -> recordings: ROS 2 (CDR) and JSON, one run or many in a file.

Channels are decoded one by one: an odd one is skipped and reported. The times are
those of one clock, chosen for the whole file and declared (design law 8): the header
stamp if every signal has one, else the publish time, else the log time.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, Message, Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid import bench_record
from frasa_sysid.bench_record import BenchRecord
from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.decoders import Decode, Reading, decoder_for
from frasa_sysid.readers.mcap_stream import StreamReport, read_messages
from frasa_sysid.readers.sources import check_source
from frasa_sysid.recording import UNITS, Clock, Fault, Recording, RigFacts, Signal

Unit = Literal["auto", "rad", "deg"]
Stamps = npt.NDArray[np.uint64]
CLOCKS: tuple[Clock, ...] = ("header", "publish", "log")
MISSING_STAMPS = 0.01  # share (and one: simulated time begins at 0) that a stamped channel may lack
FROM_DEGREES = {"deg": "rad", "deg/s": "rad/s"}
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAIN_TOPICS = ("/joint_states", "/joint_command", "/imu/data")


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
            self.stamps[clock].append(max(time, 0))
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


def read_mcap(path: Path, clock: Clock | Literal["auto"] = "auto", unit: Unit = "auto") -> list[Recording]:
    """The recordings of an MCAP file.

    Args:
        path: the file.
        clock: which stamps to use; `auto` takes the best that all signals have.
        unit: of joint angles; `deg` converts, `auto` refuses goals that can only be degrees.

    Returns:
        One recording for each `frasa.bench` record with a time window, named
        `<file>#<run>`; or one, named after the file, without such records.

    Raises:
        LogError: no such file, no MCAP, damaged, or nothing in it that frasa can use.
    """
    check_source(path)
    collected = _collect(path)
    faults = _file_faults(path, collected)
    if not collected.series:
        raise LogError(f"{path}: {_nothing_found(collected)}")
    chosen = _choose_clock(path, collected, clock, faults)
    named = _name_signals(collected, chosen, faults)
    runs = _bench_records(path, collected.report)
    faults += _outside_faults(runs, named, chosen)
    sha256 = sha256_of_file(path)
    recordings = []
    for run in runs:
        recording = _make_recording(path, run, named, chosen, unit, sha256)
        if recording is not None:
            recordings.append(recording)
    if not recordings:
        raise LogError(f"{path}: none of its messages lies in the time window of a run")
    if len(recordings) < len(runs):
        lost = len(runs) - len(recordings)
        faults.append(Fault("lost_run", lost, f"{lost} of {len(runs)} runs have no sample left"))
    recordings[-1] = replace(recordings[-1], faults=(*recordings[-1].faults, *faults))
    return recordings


# Reading the stream


def _collect(path: Path) -> Collected:
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


def _nothing_found(collected: Collected) -> str:
    if collected.report.messages == 0:
        cut = collected.report.cut_at
        return "it holds no messages" if cut is None else f"it is cut off at byte {cut}, before its first message"
    seen = ", ".join(sorted([*collected.skipped, *collected.unused])) or "only empty messages"
    return f"nothing that frasa can read; expected JointState, DynamicJointState or Imu, found {seen}"


def _file_faults(path: Path, collected: Collected) -> list[Fault]:
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


# Clock and names


def _choose_clock(path: Path, collected: Collected, asked: Clock | Literal["auto"], faults: list[Fault]) -> Clock:
    series = collected.series
    if asked == "file":
        raise LogError(f"{path}: an MCAP file has the clocks {', '.join(CLOCKS)}")
    stamped = {one.name for one in series.values() if one.has("header")}
    for key, one in list(series.items()):
        # A topic without stamps must not cost the others theirs, if it adds nothing.
        redundant = one.name in stamped and not one.has("header")
        if redundant and asked in ("auto", "header"):
            faults.append(Fault("no_stamp", len(one.values), f"{one.topic}: no header stamps; left out"))
            del series[key]
    if asked != "auto":
        lacking = sorted({one.topic for one in series.values() if not one.has(asked)})
        if lacking:
            raise LogError(f"{path}: no {asked} stamps on {', '.join(lacking)}; use --clock log or auto")
        return asked
    if all(one.has("header") for one in series.values()):
        return "header"
    if stamped:
        lacking = sorted({one.topic for one in series.values() if not one.has("header")})
        text = f"{', '.join(lacking)}: no header stamps, so none are used; one recording has one clock"
        faults.append(Fault("clock_fallback", len(lacking), text))
    # Where the publish time is unknown it repeats the log time: then it says nothing more.
    if all(one.has("publish") for one in series.values()) and any(
        one.stamps["publish"] != one.stamps["log"] for one in series.values()
    ):
        return "publish"
    return "log"


def _name_signals(collected: Collected, clock: Clock, faults: list[Fault]) -> dict[str, Series]:
    """Signals by name: the main topic's keep the plain name, others carry their topic's."""
    by_name: dict[str, list[Series]] = defaultdict(list)
    for one in collected.series.values():
        by_name[one.name].append(one)
    named = {}
    for name, several in by_name.items():
        several.sort(key=_rank)
        for i, one in enumerate(several):
            # DynamicJointState repeats what JointState says better: units and names.
            if i > 0 and one.unit is None and several[0].unit is not None:
                continue
            named[name if i == 0 else f"{name}@{one.topic}"] = one
    return named


def _rank(series: Series) -> tuple[bool, bool, int, str]:
    return series.unit is None, series.topic not in MAIN_TOPICS, -len(series.values), series.topic


# Runs


def _bench_records(path: Path, report: StreamReport) -> list[BenchRecord]:
    found = [one.metadata for one in report.metadata if one.name == bench_record.NAME]
    indexed = report.indexed_metadata.count(bench_record.NAME)
    if indexed > len(found) and not report.summary_damaged:
        raise LogError(
            f"{path} is damaged: its index names {indexed} {bench_record.NAME} records, {len(found)} were found"
        )
    records = [bench_record.from_fields(str(path), one) for one in found]
    if not records:
        return [BenchRecord("", None, RigFacts(), "real", {}, {}, {}, ())]
    if len(records) > 1 and any(one.window is None for one in records):
        raise LogError(f"{path}: {len(records)} {bench_record.NAME} records, but not all have start_ns and end_ns")
    return records


def _outside_faults(runs: Sequence[BenchRecord], named: Mapping[str, Series], clock: Clock) -> list[Fault]:
    windows = [run.window for run in runs if run.window is not None]
    if not windows:
        return []
    outside = 0
    for series in named.values():
        stamps = series.times(clock)
        inside = np.zeros(stamps.size, dtype=bool)
        for start, end in windows:
            inside |= (stamps >= start) & (stamps <= end)
        outside += int((~inside & (stamps > 0)).sum())
    text = f"{known_faults.plural(outside, 'sample')} outside the time windows of all runs; left out"
    return [Fault("outside_runs", outside, text)] if outside else []


def _make_recording(
    path: Path, run: BenchRecord, named: Mapping[str, Series], clock: Clock, unit: Unit, sha256: str
) -> Recording | None:
    window = run.window or _whole(named, clock)
    signals: dict[str, Signal] = {}
    found: list[Fault] = []
    for name, series in named.items():
        signal = _make_signal(name, series, clock, window, run.units, found)
        if signal is not None:
            signals[name] = _in_radians(signal, unit)
    if not signals:
        return None
    if unit == "auto":
        known_faults.check_radians(signals, run.rig, str(path))
    signals, handled = known_faults.clean(signals, run.rig)
    last = max(signal.t[-1] for signal in signals.values())
    missing = (window[1] - window[0]) / 1e9 - last
    if run.window is not None and missing > 1e-6:
        found.append(Fault("incomplete_run", 1, f"the run's last {missing:.3f} s are missing"))
    return Recording(
        name=f"{path.name}#{run.run}" if run.window is not None else path.name,
        signals=signals,
        rig=run.rig,
        origin=run.origin,
        source=str(path),
        sha256=sha256,
        clock=clock,
        faults=known_faults.unique([*run.faults, *found, *handled]),
        truth=run.truth,
        extra=run.extra,
    )


def _whole(named: Mapping[str, Series], clock: Clock) -> tuple[int, int]:
    filled = np.concatenate([one.times(clock) for one in named.values()])
    filled = filled[filled > 0]
    return int(filled.min()), int(filled.max())


def _make_signal(
    name: str, series: Series, clock: Clock, window: tuple[int, int], units: Mapping[str, str], found: list[Fault]
) -> Signal | None:
    stamps = series.times(clock)
    inside = np.flatnonzero((stamps >= window[0]) & (stamps <= window[1]) & (stamps > 0))
    lacking = int((stamps == 0).sum())
    if lacking:
        found.append(Fault("no_stamp", lacking, f"{name}: {lacking} messages without a {clock} stamp; dropped"))
    if inside.size == 0:
        return None
    kept, columns, y = _matrix(name, series, inside, found)
    # Subtracted as whole nanoseconds: a float cannot hold an epoch time to the nanosecond.
    t = (stamps[kept] - np.uint64(window[0])).astype(np.float64) / 1e9
    unit = series.unit if series.unit not in (None, "raw") else units.get(name, UNITS.get(name, "raw"))
    signal, faults = known_faults.make_signal(name, unit or "raw", t, y, columns)
    found += faults
    return signal


def _matrix(
    name: str, series: Series, inside: npt.NDArray[np.intp], found: list[Fault]
) -> tuple[npt.NDArray[np.intp], tuple[str, ...], npt.NDArray[np.float64]]:
    """Values in the columns that most messages have; the same joints in another order are sorted in."""
    usual = Counter(series.columns[i] for i in inside).most_common(1)[0][0]
    same = frozenset(usual)
    kept = np.array([i for i in inside if series.columns[i] == usual or _permuted(series.columns[i], same, usual)])
    rows = []
    for i in kept:
        names, values = series.columns[i], series.values[i]
        if names != usual:
            by_name = dict(zip(names, values, strict=True))
            values = [by_name[column] for column in usual]
        rows.append(values)
    if kept.size < inside.size:
        other = int(inside.size - kept.size)
        found.append(Fault("other_joints", other, f"{name}: {other} messages name other joints than most; dropped"))
    y = np.array(rows, dtype=np.float64)
    return (kept, (), y[:, 0]) if len(usual) == 1 else (kept, usual, y)


def _permuted(columns: tuple[str, ...], same: frozenset[str], usual: tuple[str, ...]) -> bool:
    return len(columns) == len(usual) and frozenset(columns) == same


def _in_radians(signal: Signal, unit: Unit) -> Signal:
    if unit != "deg" or signal.name.split("@")[0] not in ("position", "velocity", "goal", "goal_velocity"):
        return signal
    return replace(signal, y=np.deg2rad(signal.y))

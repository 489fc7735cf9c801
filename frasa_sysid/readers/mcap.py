"""MCAP -> recordings: ROS 2 (CDR) and JSON, one run or many in a file.

Channels are decoded one by one: an odd one is skipped and reported. The times are
those of one clock, chosen for the whole file and declared (design law 8): the header
stamp if every signal has one, else the publish time, else the log time.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from frasa_sysid import bench_record
from frasa_sysid.bench_record import BenchRecord
from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.clocks import compare_clocks
from frasa_sysid.errors import LogError
from frasa_sysid.message_definitions import SIMULATED
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.excerpts import excerpt_faults, nothing_inside, whole_log
from frasa_sysid.readers.kept_windows import Limit
from frasa_sysid.readers.mapped import rank_in, unused_entries
from frasa_sysid.readers.mcap_series import Collected, collect, file_faults, nothing_found
from frasa_sysid.readers.mcap_signals import in_radians, signal_of, whole_span
from frasa_sysid.readers.mcap_stream import StreamReport
from frasa_sysid.readers.sampling import plural
from frasa_sysid.readers.series import CLOCKS, Block, Series
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.readers.sources import ANGLE_UNIT, Unit, check_source
from frasa_sysid.recording import Clock, Fault, Recording, RigFacts, Signal

COMPARED: tuple[tuple[Clock, Clock], ...] = (("log", "header"), ("log", "publish"), ("publish", "header"))
MOST_RUNS = 5000  # of a file; each is looked for in all messages
MAIN_TOPICS = ("/joint_states", "/joint_command", "/imu/data")


def read_mcap(
    path: Path,
    clock: Clock | Literal["auto"] = "auto",
    unit: Unit = "auto",
    mapping: SignalMap | None = None,
    limit: Limit | None = None,
) -> list[Recording]:
    """The recordings of an MCAP file.

    Args:
        path: the file.
        clock: which stamps to use; `auto` takes the best that all signals have.
        unit: of joint angles; `deg` converts, `auto` refuses goals that can only be degrees, unless the file says
            that somebody declared their unit when it was made.
        mapping: which topics are which signals; by default the message types say it.
        limit: how much of it is kept in memory; by default as much as usual.

    Returns:
        One recording for each `frasa.bench` record with a time window, named
        `<file>#<run>`; or one, named after the file, without such records.
        Of a log that is kept in part: one for each stretch of it, with `@<seconds>s` behind
        the name, and a fault that says what was let go.

    Raises:
        LogError: no such file, no MCAP, damaged, or nothing in it that frasa can use.
    """
    check_source(path)
    return recordings_of(path, collect(path, mapping, limit), clock, unit, mapping)


def recordings_of(
    path: Path,
    collected: Collected,
    clock: Clock | Literal["auto"] = "auto",
    unit: Unit = "auto",
    mapping: SignalMap | None = None,
) -> list[Recording]:
    """The recordings of messages that were read already; see `read_mcap`."""
    faults = file_faults(collected)
    if not collected.series:
        raise LogError(f"{path}: {nothing_found(collected, mapping)}")
    faults += [] if mapping is None else unused_entries(mapping, collected.series)
    chosen = _choose_clock(path, collected, clock, faults)
    named = _name_signals(collected, mapping)
    runs = _bench_records(path, collected.report)
    stretches = collected.windows.stretches()
    faults += [*_outside_faults(runs, named, chosen, stretches), *excerpt_faults(collected, named, stretches, chosen)]
    sha256 = sha256_of_file(path)
    clocks = _compare_clocks(collected, stretches)
    whole = whole_log(named, stretches, chosen) if collected.windows.gone else {}
    recordings = []
    for stretch in stretches:
        taken = {name: series.take(stretch) for name, series in named.items()}
        for run in runs:
            recording = _make_recording(path, run, named, taken, chosen, unit, sha256)
            if recording is not None:
                recordings.append(_of_stretch(recording, stretch, collected) if whole else recording)
    if not recordings:
        raise LogError(f"{path}: {nothing_inside(collected)}")
    if len(recordings) < len(runs) and not whole:
        lost = len(runs) - len(recordings)
        faults.append(Fault("lost_run", lost, f"{lost} of {len(runs)} runs have no sample left"))
    recordings[-1] = replace(recordings[-1], faults=(*recordings[-1].faults, *faults))
    recordings[0] = replace(recordings[0], extra={**recordings[0].extra, **whole})
    return [_with_clocks(recording, clocks) for recording in recordings] if clocks else recordings


def _of_stretch(recording: Recording, stretch: Sequence[int], collected: Collected) -> Recording:
    """A recording of one stretch of a log, named by when it begins."""
    begin, end = collected.windows.span(stretch)
    excerpt = {"from_s": begin, "to_s": end, "log_s": collected.windows.seconds}
    return replace(recording, name=f"{recording.name}@{begin:.0f}s", extra={**recording.extra, "excerpt": excerpt})


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
            faults.append(Fault("no_stamp", one.size, f"{one.topic}: no header stamps; left out"))
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
    if all(one.has("publish") for one in series.values()) and any(one.published for one in series.values()):
        return "publish"
    return "log"


def _compare_clocks(collected: Collected, stretches: Sequence[Sequence[int]]) -> list[dict[str, Any]]:
    """The file's stamps against each other, on the topic with the most messages that has two that differ."""
    longest = sorted(collected.series.values(), key=lambda one: (-one.size, one.topic, one.name))
    windows = sorted({*collected.windows.gone, *(window for stretch in stretches for window in stretch)})
    found = []
    for of, against in COMPARED:
        for one in longest:
            later, earlier = one.stamps(windows)[:, [CLOCKS.index(of), CLOCKS.index(against)]].T
            both = (later > 0) & (earlier > 0)
            if both.sum() < 2 or (later[both] == earlier[both]).all():
                continue
            zero = int(earlier[both].min())
            seconds = [(stamps[both].astype(np.int64) - zero) / 1e9 for stamps in (later, earlier)]
            found.append({**compare_clocks(of, seconds[0], against, seconds[1]), "topic": one.topic})
            break
    return found


def _with_clocks(recording: Recording, clocks: list[dict[str, Any]]) -> Recording:
    # What was known when the file was made stays: a bag that is brought in again has all stamps equal.
    return replace(recording, extra={**recording.extra, "clocks": [*recording.extra.get("clocks", []), *clocks]})


def _name_signals(collected: Collected, mapping: SignalMap | None) -> dict[str, Series]:
    """Signals by name: the main topic's (the map's first) keep the plain name, others carry their topic's."""
    by_name: dict[str, list[Series]] = defaultdict(list)
    for one in collected.series.values():
        by_name[one.name].append(one)
    named = {}
    for name, several in by_name.items():
        several.sort(key=lambda one: (0 if mapping is None else rank_in(mapping, one.topic, one.name), *_rank(one)))
        for i, one in enumerate(several):
            # DynamicJointState repeats what JointState says better: units and names.
            if i > 0 and one.unit is None and several[0].unit is not None:
                continue
            plain = i == 0 and not one.topic.startswith(SIMULATED)
            named[name if plain else f"{name}@{one.topic}"] = one
    return named


def _rank(series: Series) -> tuple[bool, bool, int, str]:
    return series.unit is None, series.topic not in MAIN_TOPICS, -series.size, series.topic


# Runs


def _bench_records(path: Path, report: StreamReport) -> list[BenchRecord]:
    found = [one.metadata for one in report.metadata if one.name == bench_record.NAME]
    indexed = report.indexed_metadata.count(bench_record.NAME)
    if indexed > len(found) and not report.summary_damaged:
        raise LogError(
            f"{path} is damaged: its index names {indexed} {bench_record.NAME} records, {len(found)} were found"
        )
    if len(found) > MOST_RUNS:
        raise LogError(f"{path}: {len(found)} {bench_record.NAME} records, expected at most {MOST_RUNS}; split the log")
    records = [bench_record.from_fields(str(path), one) for one in found]
    if not records:
        return [BenchRecord("", None, RigFacts(), "real", {}, {}, {}, ())]
    if len(records) > 1 and any(one.window is None for one in records):
        raise LogError(f"{path}: {len(records)} {bench_record.NAME} records, but not all have start_ns and end_ns")
    return records


def _outside_faults(
    runs: Sequence[BenchRecord], named: Mapping[str, Series], clock: Clock, stretches: Sequence[Sequence[int]]
) -> list[Fault]:
    windows = [run.window for run in runs if run.window is not None]
    if not windows:
        return []
    outside, kept = 0, [window for stretch in stretches for window in stretch]
    for series in named.values():
        stamps = series.stamps(kept)[:, CLOCKS.index(clock)]
        inside = np.zeros(stamps.size, dtype=bool)
        for start, end in windows:
            inside |= (stamps >= start) & (stamps <= end)
        outside += int((~inside & (stamps > 0)).sum())
    text = f"{plural(outside, 'sample')} outside the time windows of all runs; left out"
    return [Fault("outside_runs", outside, text)] if outside else []


def _make_recording(
    path: Path,
    run: BenchRecord,
    named: Mapping[str, Series],
    taken: Mapping[str, Sequence[Block]],
    clock: Clock,
    unit: Unit,
    sha256: str,
) -> Recording | None:
    window = run.window or whole_span(taken, clock)
    signals: dict[str, Signal] = {}
    found: list[Fault] = []
    for name, series in named.items():
        signal = signal_of(name, series, taken[name], clock, window, run.units, found)
        if signal is not None:
            signals[name] = in_radians(signal, unit)
    if not signals:
        return None
    if unit == "auto" and ANGLE_UNIT not in run.extra:
        known_faults.check_radians(signals, run.rig, str(path), "mcap" if path.suffix == ".mcap" else "rosbag")
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

"""Recordings -> one MCAP file that PlotJuggler, Foxglove and frasa open alike.

ROS 2 profile, CDR with its definitions, compressed chunks, index and statistics. Runs
follow one another on the time line, one second apart, each described by a `frasa.bench`
record at the head of the file, so that a file cut short still knows its rig. What made
the file is in a `frasa.made` record. The same recordings and versions give the same bytes.
"""

import heapq
import io
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer

from frasa_sysid import bench_record
from frasa_sysid.calibration.files import write_atomic
from frasa_sysid.calibration.provenance import versions
from frasa_sysid.errors import LogError
from frasa_sysid.message_definitions import DEFINITIONS, SIMULATED
from frasa_sysid.recording import FloatArray, Recording, Signal

MADE = "frasa.made"  # the metadata record of versions, inputs and seed
EPOCH = 1_577_836_800 * 10**9  # ns; 2020-01-01T00:00:00Z, so that the bytes depend on the data alone
SECOND = 10**9
NAN = float("nan")
BLOCK = 2048  # messages of a topic that are made at once
CHUNK_SIZE = 2**17  # bytes; small, so that a file cut short loses little

JOINT_STATE = "sensor_msgs/msg/JointState"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
IMU = "sensor_msgs/msg/Imu"
BATTERY_STATE = "sensor_msgs/msg/BatteryState"

# Signals with a place in a message of their own; every other is an interface of DynamicJointState.
JOINT_FIELDS = {
    "position": ("/joint_states", "position"),
    "velocity": ("/joint_states", "velocity"),
    "goal": ("/joint_command", "position"),
    "goal_velocity": ("/joint_command", "velocity"),
}
IMU_FIELDS = {
    "gyro": ("angular_velocity", "rad/s", ("x", "y", "z")),
    "acceleration": ("linear_acceleration", "m/s^2", ("x", "y", "z")),
    "orientation": ("orientation", "1", ("w", "x", "y", "z")),
}


@dataclass(frozen=True)
class _Field:
    """One signal as a field of messages: its stamps [ns] (T,), values (T, k), and how a row of them is written."""

    name: str
    stamps: np.ndarray[tuple[int], np.dtype[np.int64]]
    y: FloatArray
    form: Callable[[list[float]], Any]


def write_mcap(
    path: Path,
    recordings: Sequence[Recording],
    attachments: Mapping[str, bytes] | None = None,
    start_ns: int = EPOCH,
    made: Mapping[str, Any] | None = None,
) -> None:
    """Write recordings to an MCAP file, through a temporary file and a rename.

    Reading it back gives the same signals (values exactly, times to 1 ns), facts,
    truth and faults; the clock is then `header`. A signal of one column comes back
    with shape (T,), and one without columns as that of the rig's only joint.

    Args:
        path: the file to make or replace.
        recordings: the runs, in order.
        attachments: files to carry along, by name, such as the original log.
        start_ns: time of the first run's zero [ns since 1970].
        made: what the file depends on, such as hashes of inputs and a seed, as JSON would
            have it; versions are added. Readers of recordings do not need it.

    Raises:
        LogError: nothing to write, or a signal that begins before time zero.
        OSError: the file cannot be written; it is then as it was.
    """
    if not recordings:
        raise LogError(f"{path}: no recording to write")
    windows = _windows(recordings, start_ns)
    width = max(2, len(str(len(recordings) - 1)))
    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=CHUNK_SIZE)
    for i, (recording, window) in enumerate(zip(recordings, windows, strict=True)):
        writer.add_metadata(bench_record.NAME, bench_record.to_fields(f"{i:0{width}d}", window, recording))
    record = {"versions": versions("mcap", "mcap-ros2-support"), **(made or {})}
    writer.add_metadata(MADE, {name: json.dumps(value, sort_keys=True) for name, value in record.items()})
    schemas = {name: writer.register_msgdef(name, text) for name, text in _used_definitions(recordings).items()}
    for recording, window in zip(recordings, windows, strict=True):
        for stamp, topic, schema, message in _messages(recording, window[0]):
            writer.write_message(topic, schemas[schema], message, log_time=stamp, publish_time=stamp)
    for name, data in (attachments or {}).items():
        writer.add_attachment(start_ns, start_ns, name, "application/octet-stream", data)
    writer.finish()  # type: ignore[no-untyped-call]
    write_atomic(path, buffer.getvalue())


def _windows(recordings: Sequence[Recording], start_ns: int) -> list[tuple[int, int]]:
    windows = []
    start = start_ns
    for recording in recordings:
        times = [signal.t for signal in recording.signals.values()]
        if not times:
            raise LogError(f"recording '{recording.name}' has no signals")
        if min(t[0] for t in times) < 0:
            raise LogError(f"recording '{recording.name}' begins before its time zero")
        end = start + max(int(_nanoseconds(t)[-1]) for t in times)
        windows.append((start, end))
        # Runs begin at whole seconds: easier to find on a time line.
        start = -(-(end + SECOND) // SECOND) * SECOND
    return windows


def _nanoseconds(t: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    stamps = np.round(t * 1e9).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise LogError("samples less than a nanosecond apart cannot be written")
    return stamps


def _used_definitions(recordings: Sequence[Recording]) -> dict[str, str]:
    used = {_schema(signal) for recording in recordings for signal in recording.signals.values()}
    return {name: text for name, text in DEFINITIONS.items() if name in used}


def _schema(signal: Signal) -> str:
    if _is_imu(signal):
        return IMU
    if _is_battery(signal):
        return BATTERY_STATE
    return JOINT_STATE if _base(signal) in JOINT_FIELDS else DYNAMIC_JOINT_STATE


def _base(signal: Signal) -> str:
    """The plain name of a simulated signal, which has its topic behind it; any other name as it is."""
    name, _, topic = signal.name.partition("@")
    return name if topic.startswith(SIMULATED) else signal.name


def _topic(signal: Signal, usual: str) -> str:
    return usual if _base(signal) == signal.name else signal.name.partition("@")[2]


def _is_imu(signal: Signal) -> bool:
    base = _base(signal)
    return base in IMU_FIELDS and (signal.unit, signal.columns) == IMU_FIELDS[base][1:]


def _is_battery(signal: Signal) -> bool:
    """Whether it is the robot's own supply and survives the single precision of a BatteryState."""
    whole = bool((signal.y == signal.y.astype(np.float32)).all())
    return signal.name == "supply_voltage" and signal.columns == ("battery",) and whole


def _messages(recording: Recording, start: int) -> Iterator[tuple[int, str, str, dict[str, Any]]]:
    """Stamp, topic, message type and content, in order of time; never more than a few thousand at once."""
    groups: dict[tuple[str, str, tuple[str, ...]], list[_Field]] = defaultdict(list)
    for _, signal in sorted(recording.signals.items()):
        topic, schema, joints, field = _place(signal, start, recording.rig.servo or "joint")
        groups[topic, schema, joints].append(field)
    streams = [_stream(*key, fields) for key, fields in groups.items()]
    for (stamp, topic, schema, joints), content in heapq.merge(*streams, key=itemgetter(0)):
        yield stamp, topic, schema, _finish(schema, stamp, joints, content)


def _place(signal: Signal, start: int, joint: str) -> tuple[str, str, tuple[str, ...], "_Field"]:
    """Topic, message type and joints that a signal stands under, and itself as a field there."""
    schema, joints = _schema(signal), signal.columns or (joint,)
    stamps, y = start + _nanoseconds(signal.t), signal.y.reshape(signal.t.size, -1)
    if schema == JOINT_STATE:
        usual, quantity = JOINT_FIELDS[_base(signal)]
        return _topic(signal, usual), schema, joints, _Field(quantity, stamps, y, list)
    if schema == IMU:
        quantity, _, axes = IMU_FIELDS[_base(signal)]
        field = _Field(quantity, stamps, y, lambda row: dict(zip(axes, row, strict=True)))
        return _topic(signal, "/imu/data"), schema, (), field
    if schema == BATTERY_STATE:
        return "/battery_state", schema, (), _Field("voltage", stamps, y, itemgetter(0))
    return "/dynamic_joint_states", schema, joints, _Field(signal.name, stamps, y, list)


def _stream(
    topic: str, schema: str, joints: tuple[str, ...], fields: Sequence["_Field"]
) -> Iterator[tuple[tuple[int, str, str, tuple[str, ...]], dict[str, Any]]]:
    """The messages of one topic in order of time: what stands at one stamp goes into one of them."""
    stamps = np.unique(np.concatenate([one.stamps for one in fields]))
    for begin in range(0, stamps.size, BLOCK):
        block = stamps[begin : begin + BLOCK]
        contents: list[dict[str, Any]] = [{} for _ in range(block.size)]
        for one in fields:
            low, high = np.searchsorted(one.stamps, (block[0], block[-1] + 1))
            places = np.searchsorted(block, one.stamps[low:high])
            for place, row in zip(places.tolist(), one.y[low:high].tolist(), strict=True):
                contents[place][one.name] = one.form(row)
        for stamp, content in zip(block.tolist(), contents, strict=True):
            yield (stamp, topic, schema, joints), content


def _finish(schema: str, stamp: int, joints: tuple[str, ...], content: dict[str, Any]) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp, SECOND)
    header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "imu" if schema == IMU else ""}
    if schema == JOINT_STATE:
        return {"header": header, "name": list(joints), **content}
    if schema == BATTERY_STATE:
        # By the message's definition NaN marks what is not measured.
        unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage", "temperature"), NAN)
        return {"header": header, **unknown, "present": True, **content}
    if schema == DYNAMIC_JOINT_STATE:
        names = list(content)
        values = [
            {"interface_names": names, "values": [content[name][i] for name in names]} for i in range(len(joints))
        ]
        return {"header": header, "joint_names": list(joints), "interface_values": values}
    # By the message's definition a covariance of -1 marks what the sensor does not give.
    absent = {f"{one}_covariance": [-1.0] + [0.0] * 8 for one, _, _ in IMU_FIELDS.values() if one not in content}
    return {"header": header, **content, **absent}

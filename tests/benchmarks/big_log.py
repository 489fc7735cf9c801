"""A long log of a simulated robot, written fast and in chunks: what it does for some seconds, then stillness, again.

The robot of the package's own simulation is held by the trunk and follows an excitation for half a minute, joints read
at the full rate; that part is repeated with its times shifted, one time in ten, and in between the robot keeps still
(its readings flicker by a count). There are three clocks: the header's, and publish and log time, which jitter and
drift.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from frasa_sysid.excitation_hung import SHORTEST, design
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.holds import UPRIGHT
from frasa_sysid.message_definitions import DEFINITIONS
from frasa_sysid.recording import FloatArray, Recording
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_truth import draw, held
from frasa_sysid.simulate_robot import Wiring, simulate_robot

MODEL = Path("robot_model/nominal.xml")
EPOCH = 1_700_000_000 * 10**9  # ns
GAIN = 4.0  # of the servos' firmware
LIVELY = 10  # one repetition in so many
IMU_RATE = 200.0  # Hz
JITTER = 0.0004  # [s] mean of what a message takes to the recorder
DRIFT = 20e-6  # of the recorder's clock against the header's
COUNT = 2 * np.pi / 4096
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
Bytes = npt.NDArray[np.uint8]


def robot(rate: float, seconds: float, seed: int = 3) -> Recording:
    """The part that is repeated."""
    joints = joints_of(MODEL)
    length = max(seconds, SHORTEST)
    sizes, _ = fitted_sizes(MODEL, joints, length, lambda share: None, hold=UPRIGHT, firmware_gain=GAIN)
    excitation = design(joints, sizes, length, hold=UPRIGHT, firmware_gain=GAIN)
    truth = held(draw("fixed", seed, joints.classes, joints.names), UPRIGHT, GAIN)
    wiring = Wiring(period=1.0 / rate, read_jitter=0.05 / rate, stamp_jitter=0.02 / rate, imu_period=1.0 / IMU_RATE)
    return simulate_robot(MODEL, joints, truth, excitation, seconds, "robot", wiring)


@dataclass(frozen=True)
class Channel:
    """Messages of one topic over one repetition, as bytes.

    Attributes:
        topic, kind: of the messages.
        t: stamps [s], shape (T,).
        lively, still: the messages while the robot moves and while it does not, shape (T, size).
    """

    topic: str
    kind: str
    t: FloatArray
    lively: Bytes
    still: Bytes


def messages(kind: str, content: dict[str, object], values: FloatArray, marks: FloatArray) -> Bytes:
    """T messages in CDR, (T, size): one is serialised by the library, the others get their numbers where its are.

    Args:
        kind: of the messages.
        content: of one of them, with `marks` as its numbers.
        values: numbers of all, shape (T, k).
        marks: k numbers that are nowhere else in the message.
    """
    sample = serialize_dynamic(kind, DEFINITIONS[kind])[kind](content)
    rows = np.tile(np.frombuffer(sample, np.uint8), (len(values), 1))
    for i, mark in enumerate(marks):
        place = sample.index(np.float64(mark).tobytes())
        rows[:, place : place + 8] = np.ascontiguousarray(values[:, i]).view(np.uint8).reshape(-1, 8)
    return rows


def channels(recording: Recording, joints: int, seed: int = 1) -> list[Channel]:
    """What is repeated, ready to be written."""
    rng = np.random.default_rng(seed)
    found = []
    for topic, names in (("/joint_states", ("position", "velocity")), ("/joint_command", ("goal",))):
        signals = [recording.signal(name) for name in names]
        columns = [*signals[0].columns, *(f"extra_{i}" for i in range(joints - len(signals[0].columns)))][:joints]
        width = len(signals[0].columns)
        parts = [signal.y[:, [i % width for i in range(joints)]] for signal in signals]
        calm = [np.repeat(parts[0][-1:], len(parts[0]), axis=0)]
        if topic == "/joint_states":
            calm[0] = calm[0] + COUNT * rng.integers(-1, 2, parts[0].shape)
        calm += [COUNT * rng.integers(-2, 3, part.shape) for part in parts[1:]]
        marks = np.pi + np.arange(joints * len(parts)) / 7.0
        fields = {"goal": "position"}
        arrays = {fields.get(name, name): marks[i * joints : (i + 1) * joints].tolist() for i, name in enumerate(names)}
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        content = {"header": header, "name": columns, **arrays}
        both = [messages(JOINT_STATE, content, np.hstack(one), marks) for one in (parts, calm)]
        found.append(Channel(topic, JOINT_STATE, signals[0].t, *both))
    gyro, turn, force = (
        (recording.signal(name) for name in ("gyro", "orientation", "acceleration"))
        if ("acceleration" in recording.signals)
        else (recording.signal("gyro"), recording.signal("orientation"), None)
    )
    values = np.hstack([gyro.y, turn.y] + ([force.y] if force else []))
    marks = np.pi + np.arange(values.shape[1]) / 7.0
    content = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "imu"},
        "angular_velocity": dict(zip("xyz", marks[:3].tolist(), strict=True)),
        "orientation": dict(zip("wxyz", marks[3:7].tolist(), strict=True)),
    }
    if force:
        content["linear_acceleration"] = dict(zip("xyz", marks[7:].tolist(), strict=True))
    else:
        content["linear_acceleration_covariance"] = [-1.0] + [0.0] * 8
    calm_imu = values[-1] + np.concatenate([rng.normal(0.0, 0.005, (len(values), 3)), 0.0 * values[:, 3:]], axis=1)
    both = [messages(IMU, content, one, marks) for one in (values, calm_imu)]
    found.append(Channel("/imu/data", IMU, gyro.t, *both))
    return found


def write(path: Path, seconds: float, rate: float, joints: int, part: float = 30.0) -> int:
    """Write the log; how many messages it has.

    Args:
        path: the file.
        seconds: its length.
        rate: of joint states and goals [Hz].
        joints: beyond those of the model they are copies.
        part: length of what is repeated [s].
    """
    part = min(part, seconds)
    several = channels(robot(rate, part), joints)
    rng = np.random.default_rng(0)
    count = 0
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**20, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="frasa big log")
        schemas = {
            kind: writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode()) for kind in (JOINT_STATE, IMU)
        }
        ids = [writer.register_channel(one.topic, "cdr", schemas[one.kind]) for one in several]
        for number in range(round(seconds / part)):
            for channel, log, publish, data in _part(several, number, part, rng):
                writer.add_message(ids[channel], log, data, publish)
                count += 1
        writer.finish()
    return count


def _part(
    several: list[Channel], number: int, part: float, rng: np.random.Generator
) -> Iterator[tuple[int, int, int, bytes]]:
    """Messages of one repetition in the order they are recorded: channel, log and publish time [ns], bytes."""
    rows, logs, places = [], [], []
    for i, one in enumerate(several):
        stamps = EPOCH + round(number * part * 1e9) + np.round(one.t * 1e9).astype(np.int64)
        data = (one.lively if number % LIVELY == LIVELY // 2 else one.still).copy()
        stamp = np.stack([stamps // 10**9, stamps % 10**9], axis=1).astype("<u4")
        data[:, 4:12] = stamp.view(np.uint8).reshape(-1, 8)
        took = JITTER + rng.exponential(JITTER, one.t.size)
        log = stamps + np.round(1e9 * (took + DRIFT * (number * part + one.t))).astype(np.int64)
        logs.append(np.maximum.accumulate(log))  # messages of one topic do not overtake each other
        rows.append(data)
        places.append(np.stack([np.full(one.t.size, i), np.arange(one.t.size)], axis=1))
    log, place = np.concatenate(logs), np.concatenate(places)
    order = np.argsort(log, kind="stable")
    for time, (channel, row) in zip(log[order].tolist(), place[order].tolist(), strict=True):
        yield channel, time, time - 300_000, rows[channel][row].tobytes()

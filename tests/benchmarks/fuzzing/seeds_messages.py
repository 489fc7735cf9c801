"""Good logs of messages, as small as they can be: MCAP in four encodings and three packings, ROS bags."""

import io
import json
import sqlite3
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap
from fuzzing.case import Case, case_in, single

S = 10**9
EPOCH = 1_700_000_000 * S
N = 12


@cache
def written() -> list[Case]:
    """What frasa writes itself: two benches, a robot with its IMU, an excitation."""
    t = np.arange(N) / 100
    bench = {
        name: Signal(name, unit, t, 0.1 * np.sin(9 * t) + shift)
        for name, unit, shift in (("position", "rad", 0), ("goal", "rad", 0.1), ("supply_voltage", "V", 12))
    }
    joints = ("left_knee", "right_knee")
    two = np.stack([np.sin(t), np.cos(t)], axis=1)
    robot = {
        "position": Signal("position", "rad", t, two, joints),
        "goal": Signal("goal", "rad", t, two, joints),
        "gyro": Signal("gyro", "rad/s", t, np.stack([t, t, t], axis=1), ("x", "y", "z")),
        "orientation": Signal("orientation", "1", t, np.tile([1.0, 0, 0, 0], (N, 1)), ("w", "x", "y", "z")),
    }
    rig = RigFacts(servo="mx106", mass=0.5, length=0.15, firmware_gain=16.0)
    extra = {"note": "x", "hold": "upright", "parts": [["a", 0.0, 0.1, "why"]], "clocks": [], "joint": "k"}
    runs = [Recording(f"a#{i}", bench, rig, "simulated", "a", "0" * 64, "header", extra=extra) for i in range(2)]
    whole = Recording("b", robot, RigFacts(base="fixed"), "real", "b", "0" * 64, "header", extra=extra)
    found = []
    for name, recordings in (("bench", runs), ("robot", [whole])):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.mcap"
            write_mcap(path, recordings)
            found.append(single(path.read_bytes(), "a.mcap", name))
    return found


def plain_ros2(compression: CompressionType = CompressionType.NONE, extra: dict[str, str] | None = None) -> bytes:
    """The messages of a bench without checksums, so that what is damaged reaches the decoders."""
    from mcap.reader import make_reader

    source = make_reader(io.BytesIO(next(iter(written()[0].files.values())) or b""))
    file = io.BytesIO()
    writer = Writer(file, compression=compression, enable_crcs=False, chunk_size=2**10)
    writer.start()
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    if extra is not None:
        writer.add_metadata("frasa.bench", extra)
    for schema, channel, message in source.iter_messages():
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(channel.topic, "cdr", schemas[channel.schema_id])
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return file.getvalue()


RECORD = {
    "run": "0", "start_ns": str(1_577_836_800 * S), "end_ns": str(1_577_836_900 * S), "servo": "mx106", "mass": "0.5",
    "length": "0.15", "firmware_gain": "16", "truth": '{"kp": 20.0}', "extra": '{"note": "x", "clocks": []}',
    "units": '{"position": "rad"}', "faults": '[["gap", 1, "text"]]',
}  # fmt: skip


def ros2() -> list[Case]:
    """CDR: checked as frasa writes it; without checksums, packed in every way; with a record made by hand."""
    kinds = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
    return [
        *written(),
        *(single(plain_ros2(kind), "a.mcap", kind.name) for kind in kinds),
        single(plain_ros2(extra=RECORD), "a.mcap", "by hand"),
    ]


def encoded(encoding: str, pack: Callable[[Any], bytes]) -> Case:
    """JointState and a nested message without a schema."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    state = writer.register_channel("/joint_states", encoding, 0)
    body = writer.register_channel("Control.main_outputs.sensor_data", encoding, 0)
    for i in range(N):
        at = EPOCH + i * S // 50
        stamp = {"stamp": {"sec": at // S, "nanosec": at % S}}
        writer.add_message(state, at, pack({"header": stamp, "name": ["a", "b"], "position": [0.1, 0.01 * i]}), at)
        writer.add_message(body, at, pack({"positions": {"leg": {"knee": 0.01 * i}, "head": {"yaw": 0.0}}}), at)
    writer.finish()
    return single(file.getvalue(), "a.mcap", encoding)


def as_json() -> list[Case]:
    """JSON without a schema."""
    return [encoded("json", lambda value: json.dumps(value).encode())]


def as_msgpack() -> list[Case]:
    """MessagePack without a schema."""
    import msgpack

    return [encoded("msgpack", msgpack.packb)]


def as_protobuf() -> list[Case]:
    """A message of a type of its own, with its descriptors, and a JointState-like one of Foxglove."""
    from google.protobuf import descriptor_pb2, timestamp_pb2
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from mcap_protobuf.writer import Writer as ProtobufWriter

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="f.proto", package="foxglove", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    joint = file.message_type.add(name="JointState")
    joint.field.add(name="name", number=1, type=kinds.TYPE_STRING, label=kinds.LABEL_OPTIONAL)
    joint.field.add(name="position", number=2, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    whole = file.message_type.add(name="JointStates")
    stamp, name = ".google.protobuf.Timestamp", ".foxglove.JointState"
    whole.field.add(name="timestamp", number=1, type=kinds.TYPE_MESSAGE, label=kinds.LABEL_OPTIONAL, type_name=stamp)
    whole.field.add(name="joints", number=2, type=kinds.TYPE_MESSAGE, label=kinds.LABEL_REPEATED, type_name=name)
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    states = GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    buffer = io.BytesIO()
    with ProtobufWriter(buffer, compression=CompressionType.NONE, enable_crcs=False) as writer:
        for i in range(N):
            message = states()
            message.timestamp.seconds, message.timestamp.nanos = EPOCH // S, i * 10**7
            for joint_name in ("a", "b"):
                one = message.joints.add()
                one.name, one.position = joint_name, 0.01 * i
            writer.write_message("/joint_states", message, EPOCH + i * 10**7, EPOCH + i * 10**7)
    return [single(buffer.getvalue(), "a.mcap", "protobuf")]


@cache
def bags() -> dict[str, list[Case]]:
    """ROS 1 bags (plain and packed), .db3 files (with definitions and without), folders of .db3 and of MCAP."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, list[Case]] = {"bag": [], "db3": [], "bag_folder": []}
    one, two = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)

    def messages(store: Any, ros: int) -> Any:
        for i in range(N):
            time = store.types["builtin_interfaces/msg/Time"](sec=EPOCH // S, nanosec=i * 10**7)
            head = store.types["std_msgs/msg/Header"](stamp=time, frame_id="", **({"seq": i} if ros == 1 else {}))
            y = np.array([0.01 * i, 0.1])
            kind = store.types["sensor_msgs/msg/JointState"]
            yield EPOCH + i * 10**7, kind(header=head, name=["a", "b"], position=y, velocity=y, effort=np.array([]))

    topic, kind = "/joint_states", "sensor_msgs/msg/JointState"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for packing in (None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4):
            path = folder / f"{packing}.bag"
            writer = Writer1(path)
            if packing is not None:
                writer.set_compression(packing)
            with writer:
                to = writer.add_connection(topic, kind, typestore=one)
                for at, message in messages(one, 1):
                    writer.write(to, at, one.serialize_ros1(message, kind))
            found["bag"].append(single(path.read_bytes(), "a.bag", str(packing)))
        for label, plugin, mode in (
            ("db3", StoragePlugin.SQLITE3, None),
            ("mcap", StoragePlugin.MCAP, None),
            ("file", StoragePlugin.SQLITE3, CompressionMode.FILE),
            ("message", StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        ):
            writer2 = Writer2(folder / label, version=9, storage_plugin=plugin)
            if mode is not None:
                writer2.set_compression(mode, CompressionFormat.ZSTD)
            with writer2:
                to2 = writer2.add_connection(topic, kind, typestore=two)
                for at, message in messages(two, 2):
                    writer2.write(to2, at, bytes(two.serialize_cdr(message, kind)))
            found["bag_folder"].append(case_in(folder / label, "metadata.yaml", label))
        base = next((folder / "db3").glob("*.db3"))
        found["db3"].append(single(base.read_bytes(), "a.db3", "definitions"))
        with sqlite3.connect(base) as opened:
            opened.execute("DROP TABLE schema")
            opened.execute("DROP TABLE message_definitions")
        opened.close()
        found["db3"].append(single(base.read_bytes(), "a.db3", "Humble"))
    return found

import json

import msgpack
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter

from frasa_sysid.errors import LogError
from frasa_sysid.readers import read_mcap
from frasa_sysid.readers.fields import ReadingError, read_field
from frasa_sysid.readers.signal_map import load_map, parse_map
from frasa_sysid.readers.stamps import nanoseconds

S = 10**9
EPOCH = 1_700_000_000 * S
N = 60
Field = descriptor_pb2.FieldDescriptorProto


def write(path, encoding, topics, pack):
    """topics: name -> function of the sample's number that gives a message."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {topic: writer.register_channel(topic, encoding, 0) for topic in topics}
        for i in range(N):
            for topic, make in topics.items():
                at = EPOCH + i * S // 50
                writer.add_message(channels[topic], at, pack(make(i)), at)
        writer.finish()
    return path


def hulk(i):
    return {"positions": {"left_leg": {"knee_pitch": 0.01 * i, "hip_yaw": 0.0}, "head": {"yaw": -0.01 * i}}}


PACKS = {"json": lambda value: json.dumps(value).encode(), "msgpack": msgpack.packb, "MessagePack": msgpack.packb}


@pytest.mark.parametrize("encoding", sorted(PACKS))
def test_schemaless_messages_by_a_map(tmp_path, encoding):
    """As HULKs write: nested objects without a schema, an empty message now and then; joints are the names in them."""
    topics = {
        "Control.main_outputs.sensor_data": lambda i: hulk(i) if i != 5 else None,
        "Control.main_outputs.actuated_motor_commands": lambda i: hulk(i + 10),
        "Control.main_outputs.other": lambda i: {"a": [1, 2]},
    }
    path = write(tmp_path / "a.mcap", encoding, topics, PACKS[encoding])
    recording = read_mcap(path, mapping=load_map("robocup"))[0]
    assert recording.signal("position").columns == ("left_leg.knee_pitch", "left_leg.hip_yaw", "head.yaw")
    assert recording.signal("position").t.size == N - 1
    np.testing.assert_allclose(recording.signal("goal").y[:, 0], 0.01 * (np.arange(N) + 10))
    assert recording.clock == "log"
    skipped = [fault.message for fault in recording.faults if fault.code == "channel_skipped"]
    assert skipped == ["1 of Control.main_outputs.sensor_data (messages: without positions); skipped"]


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_schemaless_joint_states_need_no_map(tmp_path, encoding):
    """What looks like a JointState is taken for one."""
    make = lambda i: {"name": ["a", "b"], "position": [0.1, 0.01 * i]}  # noqa: E731
    recording = read_mcap(write(tmp_path / "a.mcap", encoding, {"/joint_states": make}, PACKS[encoding]))[0]
    np.testing.assert_allclose(recording.signal("position").y[:, 1], 0.01 * np.arange(N))


TEXT = """
[time]
field = "t"
unit = "{unit}"
[[signal]]
topic = "/robot"
field = "joints[].q"
joints = "joints[].name"
signal = "position"
unit = "deg"
[[signal]]
topic = "/robot"
field = "motors.*.current"
signal = "current"
unit = "mA"
[[signal]]
topic = "/robot"
field = "imu.quaternion"
joints = ["x", "y", "z", "w"]
signal = "orientation"
unit = "1"
[joints]
k = "left_knee"
"""


def robot(i):
    return {
        "t": (EPOCH + i * S // 50) // 10**6,
        "joints": [{"name": "k", "q": 1.8 * i}, {"name": "h", "q": None if i == 7 else 90.0}],
        "motors": {"k": {"current": 100}, "h": {"current": 200 + i}},
        "imu": {"quaternion": [0.0, 0.0, 0.6, 0.8]},
    }


def test_paths_units_and_stamps(tmp_path):
    """Lists of objects, objects of objects, plain lists: by their path, in SI, on the stamps that the map declares."""
    path = write(tmp_path / "a.mcap", "json", {"/robot": robot}, PACKS["json"])
    recording = read_mcap(path, mapping=parse_map("m", TEXT.format(unit="ms").encode(), False))[0]
    assert recording.clock == "header"
    position = recording.signal("position")
    assert position.columns == ("left_knee", "h")
    assert position.t.size == N - 1
    np.testing.assert_allclose(position.y[1], [np.deg2rad(1.8), np.pi / 2])
    np.testing.assert_allclose(recording.signal("current").y[3], [0.1, 0.203])
    np.testing.assert_allclose(recording.signal("current").t, np.arange(N) / 50, atol=1e-9)
    np.testing.assert_allclose(recording.signal("orientation").y[0], [0.8, 0.0, 0.0, 0.6])
    assert {fault.code: fault.count for fault in recording.faults}["not_finite"] == 1


def test_a_number_is_no_stamp_before_its_unit_is_declared(tmp_path):
    """`timestamp: 1.7e9` may be anything: the messages are left out, and the line says what to declare."""
    make = lambda i: {"name": ["a"], "position": [0.1 * i], "timestamp": 1.5 + i}  # noqa: E731
    path = write(tmp_path / "a.mcap", "json", {"/joint_states": make}, PACKS["json"])
    with pytest.raises(LogError, match="a stamp without a unit: declare it as"):
        read_mcap(path)


def test_a_map_that_names_nothing_lists_the_topics(tmp_path):
    """The line holds what there is; an entry of a user's map that met nothing is named."""
    path = write(tmp_path / "a.mcap", "json", {"/robot": robot, "/other": robot}, PACKS["json"])
    text = TEXT.format(unit="ms")
    with pytest.raises(LogError, match=r"nothing that map m names; it holds /other \(no schema, json\), /robot"):
        read_mcap(path, mapping=parse_map("m", text.replace('"/robot"', '"/robo"').encode(), False))
    recording = read_mcap(path, mapping=parse_map("m", text.replace("motors.*.current", "motor").encode(), False))[0]
    assert [one.message for one in recording.faults if one.code == "map_unused"] == [
        "map m: [[signal]] 2: nothing of 'current' on /robot"
    ]


def protobuf_class():
    """robot.State: Timestamp stamp, repeated Joint joints (name, q, optional tau), map<string, double> volts."""
    file = descriptor_pb2.FileDescriptorProto(name="robot.proto", package="robot", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    joint = file.message_type.add(name="Joint")
    joint.field.add(name="name", number=1, type=Field.TYPE_STRING, label=Field.LABEL_OPTIONAL)
    joint.field.add(name="q", number=2, type=Field.TYPE_DOUBLE, label=Field.LABEL_OPTIONAL)
    joint.field.add(
        name="tau", number=3, type=Field.TYPE_DOUBLE, label=Field.LABEL_OPTIONAL, proto3_optional=True, oneof_index=0
    )
    joint.oneof_decl.add(name="_tau")
    state = file.message_type.add(name="State")
    state.field.add(
        name="stamp",
        number=1,
        type=Field.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=Field.LABEL_OPTIONAL,
    )
    state.field.add(
        name="joints", number=2, type=Field.TYPE_MESSAGE, type_name=".robot.Joint", label=Field.LABEL_REPEATED
    )
    entry = state.nested_type.add(name="VoltsEntry")
    entry.options.map_entry = True
    entry.field.add(name="key", number=1, type=Field.TYPE_STRING, label=Field.LABEL_OPTIONAL)
    entry.field.add(name="value", number=2, type=Field.TYPE_DOUBLE, label=Field.LABEL_OPTIONAL)
    state.field.add(
        name="volts", number=3, type=Field.TYPE_MESSAGE, type_name=".robot.State.VoltsEntry", label=Field.LABEL_REPEATED
    )
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("robot.State"))


def test_protobuf_by_the_descriptors_in_its_schema(tmp_path):
    """Repeated messages, maps and stamps are read; a field that was not set is none, not zero."""
    kind = protobuf_class()
    path = tmp_path / "a.mcap"
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for i in range(N):
            at = EPOCH + i * S // 50
            message = kind(joints=[{"name": "a", "q": 0.01 * i}, {"name": "b", "q": 0.0}], volts={"a": 12.0, "b": 11.0})
            message.stamp.seconds, message.stamp.nanos = divmod(at, S)
            if i % 2:
                message.joints[0].tau, message.joints[1].tau = 1.0, 2.0
            writer.write_message("/state", message, log_time=at + 10**6, publish_time=at + 10**6)
    text = """
[time]
field = "stamp"
unit = "ns"
[[signal]]
topic = "/state"
field = "joints[].q"
joints = "joints[].name"
signal = "position"
unit = "rad"
[[signal]]
topic = "/state"
field = "joints[].tau"
joints = "joints[].name"
signal = "torque"
unit = "N m"
[[signal]]
topic = "/state"
field = "volts"
signal = "supply_voltage"
unit = "V"
"""
    recording = read_mcap(path, mapping=parse_map("m", text.encode(), False))[0]
    assert recording.clock == "header"
    np.testing.assert_allclose(recording.signal("position").y[:, 0], 0.01 * np.arange(N))
    assert recording.signal("position").columns == ("a", "b")
    assert recording.signal("torque").t.size == N // 2
    np.testing.assert_allclose(
        dict(zip(recording.signal("supply_voltage").columns, recording.signal("supply_voltage").y[0], strict=True))[
            "a"
        ],
        12.0,
    )
    with pytest.raises(LogError, match=r"\(or --map\), found /state \(robot.State, protobuf\)"):
        read_mcap(path)


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("a.b", ((("k", "h")), [1.0, 2.0])),
        ("list", (None, [1.0, 2.0, 3.0])),
        ("list[1]", (None, [2.0])),
        ("list[9]", None),
        ("none", None),
        ("a.c", None),
        ("objects[].v", (None, [4.0, 5.0])),
        ("deep.*.v", (("p", "q"), [6.0, 7.0])),
        ("flag", (None, [1.0])),
        ("__class__", None),
        ("list.append", None),
    ],
)
def test_paths(path, found):
    """What a path finds, and that it never leads out of the message."""
    message = {
        "a": {"b": {"k": 1, "h": 2}},
        "list": [1, 2, 3],
        "objects": [{"v": 4}, {"v": 5}],
        "deep": {"p": {"v": 6}, "q": {"v": 7}},
        "none": None,
        "flag": True,
    }
    assert read_field(message, path) == found
    with pytest.raises(ReadingError, match="holds str, expected numbers"):
        read_field({"a": "text"}, "a")


@pytest.mark.parametrize(
    ("value", "unit", "ns"),
    [
        (1_700_000_000_123_456_789, "ns", 1_700_000_000_123_456_789),
        (1_700_000_000_123, "ms", 1_700_000_000_123_000_000),
        (1.5, "s", 1_500_000_000),
        ("2025-03-17T17:36:26.25+01:00", "iso", 1_742_229_386_250_000_000),
        ("2025-03-17 16:36:26.25", "iso", 1_742_229_386_250_000_000),
    ],
)
def test_stamps(value, unit, ns):
    """Whole numbers stay whole; dates without a zone are UTC."""
    assert nanoseconds(value, unit) == ns

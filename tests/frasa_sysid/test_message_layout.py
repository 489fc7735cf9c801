"""Messages read many at once are read as the library's own decoder reads them one by one."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Channel, Schema
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer

from frasa_sysid.message_definitions import DEFINITIONS
from frasa_sysid.readers import mcap_series, read_mcap
from frasa_sysid.readers.decoders import decoder_for
from frasa_sysid.readers.message_layout import learn

S = 10**9
EPOCH = 1_700_000_000 * S
JOINTS = "sensor_msgs/msg/JointState"
DYNAMIC = "control_msgs/msg/DynamicJointState"
IMU = "sensor_msgs/msg/Imu"
TOPICS = {JOINTS: "/joint_states", DYNAMIC: "/dynamic_joint_states", IMU: "/imu/data"}
ANY = st.floats(width=64)


def header(ns, frame):
    return {"stamp": {"sec": ns // S, "nanosec": ns % S}, "frame_id": frame}


@st.composite
def joint_states(draw):
    names = draw(st.sampled_from([("a", "b"), ("b", "a"), ("left", "b", "c"), ("a",), ("日本", "é")]))
    arrays = {
        name: draw(st.lists(ANY, min_size=len(names), max_size=len(names)) | st.just([]))
        for name in ("position", "velocity", "effort")
    }
    return JOINTS, {"name": list(names), **arrays}


@st.composite
def dynamic_states(draw):
    joints = draw(st.sampled_from([("a",), ("a", "b")]))
    names = draw(st.sampled_from([("duty",), ("duty", "current"), ("x",)]))
    row = st.lists(ANY, min_size=len(names), max_size=len(names))
    values = [{"interface_names": list(names), "values": draw(row)} for _ in joints]
    return DYNAMIC, {"joint_names": list(joints), "interface_values": values}


@st.composite
def imus(draw):
    content = {}
    for name, axes in (("orientation", "xyzw"), ("angular_velocity", "xyz"), ("linear_acceleration", "xyz")):
        content[name] = {axis: draw(ANY) for axis in axes}
        content[f"{name}_covariance"] = [draw(st.sampled_from([0.0, -1.0, 0.5]))] + [draw(ANY)] * 8
    return IMU, content


MESSAGES = st.lists(
    st.tuples(joint_states() | dynamic_states() | imus(), st.sampled_from(["", "base", "imu"])), min_size=1, max_size=3
)


def write(path, contents):
    with path.open("wb") as file, Ros2Writer(file, chunk_size=4000) as writer:
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items() if kind in TOPICS}
        for i, ((kind, content), frame) in enumerate(contents):
            ns = EPOCH + i * S // 100
            message = {"header": header(ns - 3 * 10**6, frame), **content}
            writer.write_message(TOPICS[kind], schemas[kind], message, log_time=ns, publish_time=ns - 10**6)
    return path


def everything(path):
    """All that is read of a file, to the last bit, in an order of its own; or why not."""
    try:
        recordings = read_mcap(path, unit="rad")
    except Exception as error:
        return str(error)
    return [(one.name, one.clock, sorted(map(str, one.faults)), one.extra, signals_of(one)) for one in recordings]


def signals_of(recording):
    found = recording.signals.values()
    return sorted((x.name, x.unit, x.columns, x.t.tobytes(), x.y.tobytes()) for x in found)


@settings(max_examples=12, deadline=None)
@given(kinds=MESSAGES, order=st.lists(st.integers(0, 3), min_size=1, max_size=30))
def test_as_the_decoder_one_by_one(kinds, order, tmp_path_factory):
    """Any mix of messages, any numbers: the same recordings with layouts and without."""
    path = tmp_path_factory.mktemp("mixed") / "a.mcap"
    write(path, [kinds[i % len(kinds)] for i in order])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_series, "ALIKE", 10**9)
        slow = everything(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_series, "ALIKE", 1)
        assert everything(path) == slow
        patch.setattr(mcap_series, "ALIKE", 4)
        assert everything(path) == slow


def packed(kind, content):
    """A message in CDR, and the function that decodes it."""
    data = serialize_dynamic(kind, DEFINITIONS[kind])[kind](content)
    schema = Schema(1, DEFINITIONS[kind].encode(), "ros2msg", kind)
    return data, decoder_for(Channel(1, TOPICS[kind], "cdr", {}, 1), schema, DecoderFactory())


def test_layout_of_a_joint_state():
    """Its fixed bytes are names and lengths; stamp, numbers and what CDR leaves empty are not."""
    content = {"header": header(EPOCH, ""), "name": ["a", "bcd"], "position": [1.0, 2.0], "velocity": [3.0, 4.0]}
    data, decode = packed(JOINTS, content)
    layout = learn(decode, data)
    assert layout is not None
    assert layout.stamped
    assert [place.reading.name for place in layout.places] == ["position", "velocity"]
    for place in layout.places:
        found = [struct.unpack_from("<d", data, offset)[0] for offset in place.offsets]
        assert found == list(place.reading.values)
    other, _ = packed(JOINTS, {**content, "header": header(EPOCH + 5, ""), "position": [np.nan, -7.5]})
    renamed, _ = packed(JOINTS, {**content, "name": ["b", "bcd"]})
    rows = np.array([np.frombuffer(one, np.uint8) for one in (data, other, renamed)])
    assert layout.matches(rows).tolist() == [True, True, False]
    assert layout.stamps(rows)[:2].tolist() == [EPOCH, EPOCH + 5]
    np.testing.assert_array_equal(layout.values(rows, layout.places[0])[1], [np.nan, -7.5])


def test_what_cdr_leaves_empty_means_nothing():
    """Some writers leave old bytes between the length of a list and its numbers, where CDR aligns them."""
    padded = []
    for name in ("bcd", "bcdefgh"):
        data, decode = packed(JOINTS, {"header": header(EPOCH, ""), "name": ["a", name], "position": [1.0, 2.0]})
        layout = learn(decode, data)
        before = int(layout.places[0].offsets[0]) - 4
        other = np.frombuffer(data[:before] + b"old!" + data[before + 4 :], np.uint8)
        padded.append(struct.unpack_from("<I", data, before)[0] != 2)
        # Where there is no gap the four bytes are the length itself.
        assert layout.matches(other[None]).tolist() == [padded[-1]]
    assert sorted(padded) == [False, True]


def test_what_an_imu_does_not_give_is_fixed():
    """A covariance of -1 says that there is no such quantity: messages with and without it are not alike."""
    content = {f"{one}_covariance": [0.0] * 9 for one in ("orientation", "angular_velocity", "linear_acceleration")}
    content |= {"header": header(EPOCH, "imu"), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    content |= {one: {"x": 1.0, "y": 2.0, "z": 3.0} for one in ("angular_velocity", "linear_acceleration")}
    data, decode = packed(IMU, content)
    without, _ = packed(IMU, {**content, "orientation_covariance": [-1.0] + [0.0] * 8})
    layout = learn(decode, data)
    assert layout is not None
    assert layout.matches(np.array([np.frombuffer(one, np.uint8) for one in (data, without)])).tolist() == [True, False]
    assert [place.reading.columns for place in layout.places][2] == ("w", "x", "y", "z")


def test_few_messages_are_decoded_one_by_one(tmp_path, monkeypatch):
    """Of a thousand alike messages the decoder sees those that a layout is learned from, and no others."""
    calls = []
    learned = mcap_series.learn

    def counted(decode, sample):
        return learned(lambda data: (calls.append(1), decode(data))[1], sample)

    monkeypatch.setattr(mcap_series, "learn", counted)
    monkeypatch.setattr(mcap_series, "_take", lambda *args: pytest.fail("decoded by itself"))
    contents = [((JOINTS, {"name": ["a"], "position": [0.001 * i]}), "") for i in range(1000)]
    assert read_mcap(write(tmp_path / "a.mcap", contents))[0].signal("position").t.size == 1000
    assert len(calls) < 100

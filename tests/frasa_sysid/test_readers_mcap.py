import contextlib
import json
import struct
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.writer import Writer as Ros2Writer

from frasa_sysid.errors import LogError
from frasa_sysid.message_definitions import DEFINITIONS, DYNAMIC_JOINT_STATE, IMU, JOINT_STATE
from frasa_sysid.readers import read_log, read_logs, read_mcap
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap

S = 10**9
EPOCH = 1_700_000_000 * S
KIND = "sensor_msgs/msg/JointState"


def header(ns):
    return {"stamp": {"sec": ns // S, "nanosec": ns % S}, "frame_id": ""}


def joint_state(ns, position=(), velocity=(), names=("joint",)):
    return {"header": header(ns), "name": list(names), "position": list(position), "velocity": list(velocity)}


def write_ros2(path, messages):
    """messages: (topic, type, definition, log time, publish time, content)."""
    with path.open("wb") as file, Ros2Writer(file) as writer:
        schemas = {}
        for topic, kind, text, log, publish, content in messages:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, text)
            writer.write_message(topic, schemas[kind], content, log_time=log, publish_time=publish)
    return path


def states(topic, contents, log=None):
    for i, content in enumerate(contents):
        ns = EPOCH + i * S // 100
        yield topic, KIND, JOINT_STATE, ns + 7 * 10**6 if log is None else log, ns + 10**6, content


def simple(n=20, topic="/joint_states", value=0.01):
    return list(states(topic, [joint_state(EPOCH + i * S // 100, [value * i]) for i in range(n)]))


def raw_file(path, n=200, chunked=True, compression=CompressionType.NONE, index=IndexType.ALL, **options):
    """A JSON log through the plain writer, all of whose options can be turned."""
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=1000, use_chunking=chunked, compression=compression, index_types=index, **options
        )
        writer.start()
        schema = writer.register_schema("JointState", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/joint_states", "json", schema)
        for i in range(n):
            data = json.dumps({"name": ["a"], "position": [0.001 * i]}).encode()
            writer.add_message(channel, EPOCH + i * S // 100, data, EPOCH + i * S // 100)
        writer.finish()
    return path


def codes(recording):
    return {fault.code: fault.count for fault in recording.faults}


# Files that are no log


def test_not_a_log(tmp_path):
    """Missing, directory, empty, foreign and truncated-to-nothing each get a sentence of their own."""
    cases = {
        "empty.mcap": (b"", "is empty"),
        "text.mcap": (b"hello", "not an MCAP"),
        "magic.mcap": (b"\x89MCAP0\r\n", "cut off"),
    }
    for name, (content, complaint) in cases.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(LogError, match=complaint):
            read_log(tmp_path / name)
    with pytest.raises(LogError, match="directory"):
        read_log(tmp_path)
    with pytest.raises(LogError, match="does not exist"):
        read_log(tmp_path / "none.mcap")


@pytest.mark.parametrize(
    ("content", "advice"),
    [
        (b'{"mass": 1, "entries": []}', "--format bam"),
        (b"StartOfNewTest 0\n", "--format dynaban"),
        (b"#ROSBAG V2.0\n", "--format rosbag"),
        (b"PAR1", "--format parquet --map"),
    ],
)
def test_foreign_logs_are_sent_to_import(tmp_path, content, advice):
    """A format that frasa can import is refused with the command that imports it."""
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(LogError, match=advice):
        read_log(tmp_path / "log")


def test_nothing_of_use_lists_what_there_is(tmp_path):
    """A log without joints or IMU is refused with the topics and types that it holds."""
    path = write_ros2(
        tmp_path / "a.mcap", [("/chat", "std_msgs/msg/String", "string data", EPOCH, EPOCH, {"data": "x"})]
    )
    with pytest.raises(LogError, match=r"/chat \(std_msgs/msg/String"):
        read_log(path)


# Damage


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6, 0.9, 0.999])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_truncated_gives_what_it_has(tmp_path, share, compression):
    """A file cut anywhere gives the messages before the cut, counted, with the place of the cut."""
    data = raw_file(tmp_path / "whole.mcap", compression=compression).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * share)])
    recording = read_log(cut)[0]
    y = recording.signal("position").y
    np.testing.assert_allclose(y, 0.001 * np.arange(y.size))
    assert codes(recording)["truncated"] == y.size
    assert "cut off" in str(recording.faults)
    assert y.size >= min(200, 200 * share - 40)


def test_cut_inside_its_only_chunk(tmp_path):
    """A cut inside a chunk still gives that chunk's first messages: short logs have no other."""
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 0.001
    y = rng.normal(scale=0.1, size=3000)
    recording = Recording("r", {"goal": Signal("goal", "rad", t, y)}, RigFacts(mass=1), "real", "", "", "file")
    write_mcap(tmp_path / "whole.mcap", [recording])
    data = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    back = read_log(tmp_path / "cut.mcap")[0]
    n = back.signal("goal").t.size
    assert 500 < n < 3000
    np.testing.assert_array_equal(back.signal("goal").y, y[:n])
    assert back.rig.mass == 1
    assert {"truncated", "incomplete_run"} <= set(codes(back))


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE], ids=["index", "no index"])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_flipped_byte_in_a_chunk(tmp_path, index, compression):
    """A chunk that does not match its checksum is refused, with or without a chunk index."""
    path = raw_file(tmp_path / "a.mcap", compression=compression, index=index)
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(LogError, match="damaged"):
        read_log(path)


def test_flipped_byte_without_chunks(tmp_path):
    """Without chunks the checksum of the whole data section is compared, if there is one."""
    path = raw_file(tmp_path / "a.mcap", chunked=False, enable_data_crcs=True)
    assert read_log(path)[0].signal("position").t.size == 200
    data = bytearray(path.read_bytes())
    at = data.index(b"0.1,") if b"0.1," in data else data.index(b"0.01")
    data[at] ^= 1
    path.write_bytes(data)
    with pytest.raises(LogError, match="CRC"):
        read_log(path)


def test_flipped_byte_in_the_facts(tmp_path):
    """The facts of the rig are as well guarded as the samples."""
    signal = Signal("goal", "rad", np.arange(3.0), np.zeros(3))
    write_mcap(tmp_path / "a.mcap", [Recording("r", {"goal": signal}, RigFacts(mass=0.535), "real", "", "", "file")])
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(data.replace(b"0.535", b"0.735"))
    with pytest.raises(LogError, match="checksum"):
        read_log(tmp_path / "a.mcap")


def test_no_flipped_bit_of_our_files_changes_the_data_unseen(small_file, tmp_path):
    """Wherever one bit of a file of ours flips: the same recordings, or a fault, or an error."""
    whole = bytearray(small_file[0])
    path = tmp_path / "a.mcap"
    path.write_bytes(whole)
    reference = [contents(recording) for recording in read_log(path)]
    for at in range(0, len(whole), 11):
        damaged = whole.copy()
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        with contextlib.suppress(LogError):
            back = read_log(path)
            assert [contents(one) for one in back] == reference or any(one.faults for one in back)


def contents(recording):
    signals = {name: (one.unit, one.t.tobytes(), one.y.tobytes()) for name, one in recording.signals.items()}
    return recording.name, recording.rig, signals, recording.extra


def test_damaged_index_is_not_needed(tmp_path):
    """Damage to the summary costs nothing: the data are read without it, and it is reported."""
    path = raw_file(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    data[-60] ^= 0xFF
    path.write_bytes(data)
    recording = read_log(path)[0]
    assert recording.signal("position").t.size == 200
    assert "summary_damaged" in codes(recording)


def test_unknown_compression(tmp_path):
    """A compression that is not known is an error, not an empty log."""
    path = raw_file(tmp_path / "a.mcap", compression=CompressionType.ZSTD)
    path.write_bytes(path.read_bytes().replace(b"\x04\x00\x00\x00zstd", b"\x04\x00\x00\x00brot"))
    with pytest.raises(LogError, match="'brot', known are"):
        read_log(path)


@pytest.mark.parametrize(
    "options",
    [
        {"chunked": False},
        {"index": IndexType.NONE},
        {
            "index": IndexType.NONE,
            "use_statistics": False,
            "use_summary_offsets": False,
            "repeat_channels": False,
            "repeat_schemas": False,
        },
        {"enable_crcs": False},
    ],
)
def test_bare_files(tmp_path, options):
    """Index, statistics, chunks and checksums are all optional."""
    recording = read_log(raw_file(tmp_path / "a.mcap", **options))[0]
    assert recording.signal("position").t.size == 200
    assert recording.faults == ()


def test_absurd_chunk_size(tmp_path):
    """A chunk that claims to unpack to more than memory holds is refused before it is unpacked."""
    data = struct.pack("<QQQI", 0, 0, 2**50, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", 0)
    body = b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 8) + bytes(8) + struct.pack("<BQ", 6, len(data)) + data
    (tmp_path / "a.mcap").write_bytes(body)
    with pytest.raises(LogError, match="limit"):
        read_log(tmp_path / "a.mcap")


@pytest.fixture(scope="module")
def small_file(tmp_path_factory):
    t = np.arange(30) * 0.01
    signals = {
        "position": Signal("position", "rad", t, np.sin(t)),
        "goal": Signal("goal", "rad", t, np.cos(t)),
        "load": Signal("load", "raw", t, np.round(20 * np.sin(t))),
    }
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    write_mcap(path, [Recording("r", signals, RigFacts(mass=1.0), "real", "", "", "file")] * 2, {"a": b"b" * 50})
    return path.read_bytes(), raw_file(path.with_name("raw.mcap"), n=30, chunked=False).read_bytes()


@settings(max_examples=500, deadline=None)
@given(data=st.data())
def test_any_damage_is_a_fault_or_an_error(small_file, tmp_path_factory, data):
    """Whatever is cut off or flipped, a log is read, perhaps with faults, or refused with LogError."""
    content = bytearray(data.draw(st.sampled_from(small_file)))
    for _ in range(data.draw(st.integers(0, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    content = content[: data.draw(st.integers(0, len(content)))]
    path = tmp_path_factory.getbasetemp() / "damaged.mcap"
    path.write_bytes(content)
    with contextlib.suppress(LogError):
        assert read_log(path)


# Clocks


def test_clock_prefers_header_then_publish_then_log(tmp_path):
    """The header stamp where all have one, else the publish time, else the log time; each declared."""
    path = write_ros2(tmp_path / "header.mcap", simple())
    assert read_log(path)[0].clock == "header"
    unstamped = [joint_state(0, [0.01 * i]) for i in range(20)]
    path = write_ros2(tmp_path / "publish.mcap", states("/joint_states", unstamped))
    assert read_log(path)[0].clock == "publish"
    same = [(*m[:3], m[4], m[4], m[5]) for m in states("/joint_states", unstamped)]
    path = write_ros2(tmp_path / "log.mcap", same)
    assert read_log(path)[0].clock == "log"


def test_clocks_are_never_mixed(tmp_path):
    """One topic without stamps takes the clock of all, and that is reported; asked for, it is refused."""
    unstamped = [joint_state(0, [0.01 * i]) for i in range(20)]
    path = write_ros2(tmp_path / "a.mcap", [*simple(), *states("/joint_command", unstamped)])
    recording = read_log(path)[0]
    assert recording.clock == "publish"
    assert "clock_fallback" in codes(recording)
    assert recording.signal("position").t[0] == recording.signal("goal").t[0] == 0
    with pytest.raises(LogError, match="/joint_command"):
        read_mcap(path, clock="header")
    assert read_mcap(path, clock="log")[0].clock == "log"


def test_a_few_missing_stamps_are_dropped(tmp_path):
    """A message whose stamp was not filled in does not change everybody's clock."""
    contents = [joint_state(EPOCH + i * S // 100 if i != 5 else 0, [0.01 * i]) for i in range(200)]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    assert recording.clock == "header"
    assert codes(recording)["no_stamp"] == 1
    assert recording.signal("position").t.size == 199


def test_epoch_times_keep_their_nanoseconds(tmp_path):
    """Stamps of today minus stamps of today are exact to a nanosecond."""
    stamps = [EPOCH + ns for ns in (0, 1, 3, 10**9 + 1)]
    contents = [joint_state(ns, [0.0]) for ns in stamps]
    t = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0].signal("position").t
    np.testing.assert_array_equal(t, [0, 1e-9, 3e-9, 1.000000001])


def test_stamps_out_of_order_and_repeated(tmp_path):
    """Stamps that run backwards are sorted, repeated ones dropped; both are counted."""
    order = [0, 1, 2, 5, 4, 3, 6, 6, 7]
    contents = [joint_state(EPOCH + i * S // 100, [0.01 * i]) for i in order]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    np.testing.assert_allclose(recording.signal("position").y, 0.01 * np.arange(8))
    assert codes(recording)["time_order"] == 2
    assert codes(recording)["repeated_time"] == 1


# Channels and values


def test_empty_arrays(tmp_path):
    """A JointState may hold positions, velocities, both or neither; what is absent is no zero."""
    contents = [
        joint_state(EPOCH, [0.1], [1.0]),
        joint_state(EPOCH + 10**7, [0.2]),
        joint_state(EPOCH + 2 * 10**7, [], [3.0]),
        joint_state(EPOCH + 3 * 10**7),
    ]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    np.testing.assert_array_equal(recording.signal("position").y, [0.1, 0.2])
    np.testing.assert_array_equal(recording.signal("velocity").y, [1.0, 3.0])
    np.testing.assert_allclose(recording.signal("velocity").t, [0, 0.02])


def test_odd_channel_does_not_kill_the_rest(tmp_path, capfd):
    """A channel whose definition or messages cannot be decoded is skipped and reported."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Ros2Writer(file)
        good = writer.register_msgdef(KIND, JOINT_STATE)
        for *_, log, publish, content in simple():
            writer.write_message("/joint_states", good, content, log, publish)
        inner = writer._writer
        odd = inner.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"int32 a\n---\nint32 b")
        none = inner.register_channel("/no_schema", "cdr", 0)
        channels = [inner.register_channel("/odd", "cdr", odd), inner.register_channel("/short", "cdr", good.id)]
        for channel in [*channels, none]:
            inner.add_message(channel, EPOCH, b"\0\1\0\0\7", EPOCH)
        writer.finish()
    recording = read_log(tmp_path / "a.mcap")[0]
    assert recording.signal("position").t.size == 20
    text = str(recording.faults)
    assert "/odd" in text
    assert "/short" in text
    assert capfd.readouterr().out == ""


def test_messages_compressed_one_by_one(tmp_path):
    """A bag whose messages are compressed one by one is refused with what to do about it."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(KIND, "ros2msg", JOINT_STATE.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        writer.add_message(channel, EPOCH, zstandard.compress(b"message"), EPOCH)
        writer.finish()
    with pytest.raises(LogError, match="compression mode FILE"):
        read_log(tmp_path / "a.mcap")


def test_absurd_lengths_inside_a_message(tmp_path):
    """A message that claims billions of joints is skipped, not believed."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(KIND, "ros2msg", JOINT_STATE.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        head = b"\0\1\0\0" + struct.pack("<iI", 1, 0) + struct.pack("<I", 1) + b"\0" * 4
        for claim in (2**31, 2**32 - 1):
            writer.add_message(channel, EPOCH, head + struct.pack("<I", claim), EPOCH)
            writer.add_message(channel, EPOCH, head + struct.pack("<IIII", 0, claim, 0, 0), EPOCH)
        writer.finish()
    with pytest.raises(LogError, match="cannot be decoded"):
        read_log(tmp_path / "a.mcap")


def test_simulated_time_begins_at_zero(tmp_path):
    """A single stamp of zero, as simulated time begins, does not cost the header clock."""
    contents = [joint_state(i * S // 100, [0.01 * i]) for i in range(20)]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    assert recording.clock == "header"
    assert codes(recording) == {"no_stamp": 1}


def test_two_channels_of_one_topic(tmp_path):
    """A topic that was advertised twice is one signal."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = [writer.register_channel("/joint_states", "json", 0) for _ in range(2)]
        for i in range(20):
            data = json.dumps({"name": ["a"], "position": [0.01 * i]}).encode()
            writer.add_message(channels[i % 2], EPOCH + i * S // 100, data, EPOCH + i * S // 100)
        writer.finish()
    np.testing.assert_allclose(read_log(tmp_path / "a.mcap")[0].signal("position").y, 0.01 * np.arange(20))


def test_joints_in_another_order(tmp_path):
    """Columns follow the names, not the order of one message; messages of other joints are reported."""
    contents = []
    for i in range(20):
        pair = [0.01 * i, -0.01 * i], ("a", "b")
        swapped = [-0.01 * i, 0.01 * i], ("b", "a")
        values, names = swapped if i % 3 == 1 else pair
        contents.append(joint_state(EPOCH + i * S // 100, values, names=names))
    contents.append(joint_state(EPOCH + S, [9.0], names=("c",)))
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    position = recording.signal("position")
    assert position.columns == ("a", "b")
    np.testing.assert_allclose(position.y, 0.01 * np.outer(np.arange(20), [1, -1]))
    assert codes(recording)["other_joints"] == 1


def test_nan_is_dropped_and_counted(tmp_path):
    """Samples that are not finite are dropped and counted; a signal of nothing else is left out."""
    contents = [joint_state(EPOCH + i * S // 100, [np.nan if i == 3 else 0.0], [np.nan]) for i in range(10)]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    assert recording.signal("position").t.size == 9
    assert set(recording.signals) == {"position"}
    assert sum(fault.count for fault in recording.faults if fault.code == "not_finite") == 11
    contents = [joint_state(EPOCH + i * S // 100, [np.nan]) for i in range(10)]
    with pytest.raises(LogError):
        read_log(write_ros2(tmp_path / "b.mcap", states("/joint_states", contents)))


def test_a_dead_joint_does_not_cost_the_others(tmp_path):
    """A joint that never reports is left out; the samples of the others stay."""
    contents = [joint_state(EPOCH + i * S // 100, [0.0, np.nan], names=("a", "b")) for i in range(10)]
    recording = read_log(write_ros2(tmp_path / "a.mcap", states("/joint_states", contents)))[0]
    assert recording.signal("position").columns == ("a",)
    assert codes(recording)["dead_joint"] == 1


def test_degrees(tmp_path):
    """Goals beyond two turns are refused as degrees; --unit deg converts; a wheel may turn on."""
    position = simple(value=1.5)
    goal = simple(topic="/joint_command", value=1.5)
    path = write_ros2(tmp_path / "deg.mcap", [*position, *goal])
    with pytest.raises(LogError, match="looks like degrees"):
        read_log(path)
    assert read_mcap(path, unit="deg")[0].signal("position").y[-1] == pytest.approx(np.deg2rad(28.5))
    assert read_mcap(path, unit="rad")[0].signal("position").y[-1] == pytest.approx(28.5)
    wheel = write_ros2(tmp_path / "wheel.mcap", position)
    assert read_log(wheel)[0].signal("position").y[-1] == pytest.approx(28.5)


def test_missing_goal_is_told_by_name(tmp_path):
    """A log without goals reads; asking for them lists what there is."""
    recording = read_log(write_ros2(tmp_path / "a.mcap", simple()))[0]
    assert recording.rig == RigFacts()
    with pytest.raises(LogError, match="no 'goal' signal; it has position"):
        recording.signal("goal")


def test_foreign_types(tmp_path):
    """IMU, battery, any joint interface and JointCommand become signals with their units."""
    battery = "std_msgs/Header header\nfloat32 voltage" + JOINT_STATE[JOINT_STATE.index("\n\n===") :]
    command = "std_msgs/Header header\nstring[] joint_names\nfloat64[] positions\nfloat64[] velocities"
    command += JOINT_STATE[JOINT_STATE.index("\n\n===") :]
    messages = []
    for i in range(10):
        ns = EPOCH + i * S // 100
        imu = {"header": header(ns), "angular_velocity": {"x": 1.0}, "orientation_covariance": [-1.0] + [0.0] * 8}
        dynamic = {
            "header": header(ns),
            "joint_names": ["j"],
            "interface_values": [{"interface_names": ["torque_enable", "effort"], "values": [1.0, 5.0]}],
        }
        goal = {"header": header(ns), "joint_names": ["j"], "positions": [0.1], "velocities": []}
        for topic, kind, text, content in [
            ("/imu", "sensor_msgs/msg/Imu", IMU, imu),
            ("/battery", "sensor_msgs/msg/BatteryState", battery, {"header": header(ns), "voltage": 12.5}),
            ("/dynamic_joint_states", "control_msgs/msg/DynamicJointState", DYNAMIC_JOINT_STATE, dynamic),
            ("/motor_goals", "bitbots_msgs/msg/JointCommand", command, goal),
        ]:
            messages.append((topic, kind, text, ns, ns, content))
    recording = read_log(write_ros2(tmp_path / "a.mcap", messages))[0]
    units = {name: signal.unit for name, signal in recording.signals.items()}
    assert units == {
        "gyro": "rad/s",
        "acceleration": "m/s^2",
        "supply_voltage": "V",
        "torque_enable": "1",
        "effort": "raw",
        "goal": "rad",
    }
    assert recording.signal("gyro").columns == ("x", "y", "z")
    assert recording.signal("goal").y[0] == 0.1


def test_several_sources_of_one_quantity(tmp_path):
    """The main topic keeps the plain name, another one carries its topic's; nothing is lost or merged."""
    path = write_ros2(tmp_path / "a.mcap", [*simple(), *simple(topic="/arm/joint_states", value=0.02)])
    recording = read_log(path)[0]
    assert set(recording.signals) == {"position", "position@/arm/joint_states"}
    assert recording.signal("position").y[1] == pytest.approx(0.01)


def test_foxglove_json(tmp_path):
    """JSON logs in Foxglove's own joint type are read, goals by their topic."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.JointStates", "jsonschema", b'{"type": "object"}')
        topics = [writer.register_channel(topic, "json", schema) for topic in ("/joints", "/joints_goal")]
        for i in range(10):
            ns = EPOCH + i * S // 100
            joints = [{"name": "a", "position": 0.1, "velocity": 0.2}, {"name": "b", "position": 0.3}]
            data = json.dumps({"timestamp": {"sec": ns // S, "nsec": ns % S}, "joints": joints}).encode()
            for channel in topics:
                writer.add_message(channel, ns + 5, data, ns + 5)
        writer.finish()
    recording = read_log(tmp_path / "a.mcap")[0]
    assert recording.clock == "header"
    assert recording.signal("position").columns == recording.signal("goal").columns == ("a", "b")
    np.testing.assert_array_equal(recording.signal("velocity").y, np.full(10, 0.2))


# Facts of the rig


def with_bench(path, fields):
    with path.open("wb") as file, Ros2Writer(file) as writer:
        writer.add_metadata("frasa.bench", fields)
        schema = writer.register_msgdef(KIND, DEFINITIONS[KIND])
        for *_, log, publish, content in simple():
            writer.write_message("/joint_states", schema, content, log, publish)
    return path


def test_facts_by_hand(tmp_path):
    """A record with a few facts and no time window speaks for the whole file."""
    recording = read_log(with_bench(tmp_path / "a.mcap", {"servo": "mx64", "mass": "0.5"}))[0]
    assert recording.name == "a.mcap"
    assert recording.rig == RigFacts(servo="mx64", mass=0.5)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"mass": "heavy"}, "mass = 'heavy' is not a number"),
        ({"mass": "-1"}, "mass = -1"),
        ({"origin": "guess"}, "origin"),
        ({"extra": "{"}, "cannot be understood"),
        ({"truth": "[1]"}, "cannot be understood"),
        ({"start_ns": "5", "end_ns": "1"}, "expected 0 <= start"),
        ({"start_ns": "1", "end_ns": "2"}, "time window"),
    ],
)
def test_facts_that_cannot_be_used(tmp_path, fields, complaint):
    """A fact that cannot be understood is named, with the run it belongs to."""
    with pytest.raises(LogError, match=complaint):
        read_log(with_bench(tmp_path / "a.mcap", fields))


def test_samples_outside_all_runs_are_counted(tmp_path):
    """Samples that no run claims are left out, and counted."""
    fields = {"start_ns": str(EPOCH), "end_ns": str(EPOCH + S // 10)}
    recording = read_log(with_bench(tmp_path / "a.mcap", fields))[0]
    assert recording.signal("position").t.size == 11
    assert codes(recording) == {"outside_runs": 9}


def test_lost_run_is_reported(tmp_path):
    """A run that the cut took away altogether is counted."""
    t = np.arange(4000) * 0.01
    y = np.random.default_rng(1).normal(scale=0.1, size=4000)
    one = Recording("r", {"goal": Signal("goal", "rad", t, y)}, RigFacts(), "real", "", "", "file")
    write_mcap(tmp_path / "a.mcap", [one] * 3)
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[: len(data) // 2])
    back = read_logs([tmp_path / "a.mcap"])
    assert len(back) == 2
    assert codes(back[-1])["lost_run"] == 1
    assert back[0].faults == ()
    assert zlib.crc32(back[0].signal("goal").y.tobytes()) == zlib.crc32(y.tobytes())

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.cli import build_parser
from frasa_sysid.commands import importing
from frasa_sysid.errors import LogError
from frasa_sysid.message_definitions import DYNAMIC_JOINT_STATE
from frasa_sysid.readers import bag_bounds, read_log
from frasa_sysid.readers.bag import read_bag
from frasa_sysid.readers.signal_map import load_map

S = 10**9
EPOCH = 1_700_000_000 * S
N = 100
NUMBERS = ("positions", "velocities", "accelerations", "max_currents")
COMMAND = "std_msgs/Header header\nstring[] joint_names\n" + "".join(f"float64[] {one}\n" for one in NUMBERS)
INTERFACE = "string[] interface_names\nfloat64[] values\n"


def store_of(ros):
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types = {
        "bitbots_msgs/msg/JointCommand": COMMAND,
        "control_msgs/msg/DynamicJointState": DYNAMIC_JOINT_STATE.split("\n====")[0],
        "control_msgs/msg/InterfaceValue": INTERFACE,
    }
    for name, text in types.items():
        store.register(get_types_from_msg(text, name))
    return store


def header(store, ros, i):
    stamp = store.types["builtin_interfaces/msg/Time"](sec=EPOCH // S + i // 100, nanosec=(i % 100) * 10**7)
    words = {"stamp": stamp, "frame_id": ""} | ({"seq": i} if ros == 1 else {})
    return store.types["std_msgs/msg/Header"](**words)


def messages(store, ros, names=("knee", "hip")):
    """Topic, type, time of arrival [ns] and message, as a RoboCup humanoid records them."""
    kinds = store.types
    for i in range(N):
        at = EPOCH + i * 10**7
        y = np.array([0.01 * i, -0.01 * i])
        state = kinds["sensor_msgs/msg/JointState"](
            header=header(store, ros, i), name=list(names), position=y, velocity=np.array([]), effort=y * 100
        )
        command = kinds["bitbots_msgs/msg/JointCommand"](
            header=header(store, ros, i),
            joint_names=list(names),
            positions=y + 0.1,
            velocities=np.full(2, -1.0),
            accelerations=np.array([]),
            max_currents=np.array([]),
        )
        values = [
            kinds["control_msgs/msg/InterfaceValue"](interface_names=["voltage"], values=np.array([12.0 - j]))
            for j in range(2)
        ]
        dynamic = kinds["control_msgs/msg/DynamicJointState"](
            header=header(store, ros, i), joint_names=list(names), interface_values=values
        )
        yield "/joint_states", "sensor_msgs/msg/JointState", at + 3 * 10**6, state
        yield "/joint_command", "bitbots_msgs/msg/JointCommand", at + 10**6, command
        yield "/dynamic_joint_states", "control_msgs/msg/DynamicJointState", at + 2 * 10**6, dynamic
        yield "/chat", "std_msgs/msg/String", at, kinds["std_msgs/msg/String"](data="hello")


def write1(path):
    store = store_of(1)
    with Writer1(path) as writer:
        connections = {}
        for topic, kind, at, message in messages(store, 1):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], at, store.serialize_ros1(message, kind))
    return path


def write2(folder, version=9, plugin=StoragePlugin.SQLITE3):
    store = store_of(2)
    with Writer2(folder, version=version, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, at, message in messages(store, 2):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], at, bytes(store.serialize_cdr(message, kind)))
    return folder


def without_definitions(path):
    """A .db3 as ROS 2 Humble and older wrote it: no table of definitions."""
    import sqlite3

    with sqlite3.connect(path) as base:
        for command in ("DROP TABLE schema", "DROP TABLE message_definitions"):
            base.execute(command)
    base.close()
    return path


def frasa(*words):
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    importing.add_parser(parser.add_subparsers(required=True))
    return run_command(parser, [str(word) for word in words])


def check(recording):
    i = np.arange(N)
    y = np.stack([0.01 * i, -0.01 * i], axis=1)
    assert recording.signal("position").columns == ("knee", "hip")
    np.testing.assert_allclose(recording.signal("position").y, y, atol=1e-12)
    np.testing.assert_allclose(recording.signal("position").t, i / 100, atol=1e-9)
    np.testing.assert_allclose(recording.signal("goal").y, y + 0.1)
    np.testing.assert_allclose(recording.signal("effort").y, y * 100)
    assert recording.signal("effort").unit == "raw"


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """The same log as a ROS 1 bag, a rosbag2 folder with definitions, and a .db3 without them."""
    folder = tmp_path_factory.mktemp("bags")
    old = write2(folder / "old")
    return {
        "ros1": write1(folder / "one.bag"),
        "folder": write2(folder / "two") / "metadata.yaml",
        "old": without_definitions(next(old.glob("*.db3"))),
        "mcap": write2(folder / "three", plugin=StoragePlugin.MCAP) / "metadata.yaml",
    }


@pytest.fixture
def metadata(bags, tmp_path):
    """The metadata of a copy of the folder, to be spoilt."""
    return Path(shutil.copytree(bags["folder"].parent, tmp_path / "bag")) / "metadata.yaml"


@pytest.mark.parametrize("kind", ["ros1", "folder", "old", "mcap"])
def test_bags_by_message_type(bags, kind):
    """Joints, goals, header stamps and interfaces come out of every kind of bag; what is no signal is left alone."""
    recording = read_bag(bags[kind])[0]
    check(recording)
    assert recording.clock == "header"
    assert recording.faults == ()
    np.testing.assert_allclose(recording.signal("voltage").y[0], [12.0, 11.0])
    (clocks,) = [one for one in recording.extra["clocks"] if one["of"] == "log"][:1] or [None]
    assert clocks is not None


@pytest.mark.parametrize("kind", ["ros1", "folder", "old"])
def test_bags_by_a_map(bags, kind):
    """A built-in map reads the same, in declared units; of a speed limit of -1 it makes no goal."""
    recording = read_bag(bags[kind], mapping=load_map("robocup"))[0]
    check(recording)
    assert "goal_velocity" not in recording.signals
    ros2 = read_bag(bags[kind], mapping=load_map("ros2_control"))[0]
    assert ros2.signal("supply_voltage").unit == "V"
    np.testing.assert_allclose(ros2.signal("supply_voltage").y[0], [12.0, 11.0])


def test_import_of_bags(bags, tmp_path, capsys):
    """Files and folders become one MCAP each, called like the bag, with its files attached."""
    folder = bags["ros1"].parent
    assert frasa("import", folder / "one.bag", folder / "two", "--format", "rosbag", "--out", tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.mcap", "two.mcap"]
    assert "effort in 2 recordings: nobody declared its unit" in capsys.readouterr().err
    for name in ("one", "two"):
        recording = read_log(tmp_path / f"{name}.mcap")[0]
        check(recording)
        data = folder / "one.bag" if name == "one" else next((folder / "two").glob("*.db3"))
        assert recording.extra["imported_sha256"] == sha256_of_file(data)
        with (tmp_path / f"{name}.mcap").open("rb") as file:
            attached = {one.name: one.data for one in make_reader(file).iter_attachments()}
        assert attached[data.name] == data.read_bytes()
        assert name == "one" or "metadata.yaml" in attached
    assert run_command(build_parser(), ["inspect", str(tmp_path / "two.mcap")]) == 0
    assert "effort in 1 recordings: nobody declared its unit" in capsys.readouterr().err
    found = importing.find_sources(str(folder), "rosbag")
    assert sorted({one.relative_to(folder).parts[0] for one in found}) == ["old", "one.bag", "three", "two"]


def test_large_originals_are_not_attached(bags, tmp_path, capsys, monkeypatch):
    """What is above the limit stays where it is, and that is said; the signals come all the same."""
    monkeypatch.setattr(importing, "ATTACHED", 1000)
    assert frasa("import", bags["ros1"], "--format", "rosbag", "--out", tmp_path) == 0
    assert "are not attached; keep the original" in capsys.readouterr().err
    check(read_log(tmp_path / "one.mcap")[0])
    with (tmp_path / "one.mcap").open("rb") as file:
        assert list(make_reader(file).iter_attachments()) == []


@pytest.mark.parametrize(
    ("unit", "name", "si", "factor"),
    [
        ("N m", "torque", "N m", 1.0),
        ("mA", "current", "A", 1e-3),
        ("raw", "effort", "raw", 1.0),
        ("none", None, None, 0),
    ],
)
def test_effort_is_what_was_declared(bags, tmp_path, capsys, unit, name, si, factor):
    """Only a declared unit makes an effort a torque or a current."""
    words = ["--format", "rosbag", "--out", tmp_path, "--effort-unit", unit]
    assert frasa("import", bags["ros1"], *words) == 0
    assert "declared" not in capsys.readouterr().err
    signals = read_log(tmp_path / "one.mcap")[0].signals
    assert {one for one in signals if one in ("effort", "torque", "current")} == ({name} if name else set())
    if name:
        assert signals[name].unit == si
        np.testing.assert_allclose(signals[name].y[:, 0], np.arange(N) * factor, atol=1e-12)


def test_bags_that_cannot_be_read(bags, tmp_path):
    """No bag, one cut off, one without topics of use, a file missing: each one line with what was found."""
    (tmp_path / "a.db3").write_bytes(b"hello")
    (tmp_path / "b.txt").write_bytes(b"hello")
    (tmp_path / "c.bag").write_bytes(bags["ros1"].read_bytes()[:3000])
    (tmp_path / "d.db3").write_bytes(bags["old"].read_bytes()[:200])
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    cases = {
        "a.db3": "is no bag: it does not begin with 'SQLite format 3'",
        "b.txt": "expected a .bag or .db3 file",
        "c.bag": "cannot be read as a bag",
        "d.db3": "cannot be read as a bag",
        "metadata.yaml": "cannot be read as a bag",
    }
    for name, complaint in cases.items():
        with pytest.raises(LogError) as error:
            read_bag(tmp_path / name)
        assert complaint in str(error.value)
        assert "\n" not in str(error.value)
    with pytest.raises(LogError, match=r"nothing that map robotis names; it holds .*/chat"):
        read_bag(bags["ros1"], mapping=only_op3())


def only_op3():
    from dataclasses import replace

    mapping = load_map("robotis")
    return replace(mapping, entries=tuple(one for one in mapping.entries if "/robotis/" in one.topic))


def test_a_damaged_page_costs_what_comes_after(bags, tmp_path):
    """Of a .db3 with a broken page the messages before it are read, and the loss is counted."""
    data = bytearray(bags["old"].read_bytes())
    middle = len(data) * 3 // 4 // 4096 * 4096
    data[middle : middle + 8192] = b"\xff" * 8192
    (tmp_path / "a.db3").write_bytes(data)
    try:
        recording = read_bag(tmp_path / "a.db3")[0]
    except LogError as error:
        assert "cannot be read as a bag" in str(error)  # noqa: PT017 - the page may hold the index
    else:
        assert {fault.code for fault in recording.faults} >= {"truncated"}
        assert 0 < recording.signal("position").t.size < N


def test_a_journal_beside_a_bag_is_named(bags, tmp_path):
    """What a crashed recorder left in SQLite's journal was not read, and that is said."""
    (tmp_path / "a.db3").write_bytes(bags["old"].read_bytes())
    (tmp_path / "a.db3-wal").write_bytes(b"x")
    (fault,) = read_bag(tmp_path / "a.db3")[0].faults
    assert fault.message.startswith("a.db3-wal stands beside the bag")


def test_without_rosbags_it_is_said_how_to_get_it(bags, monkeypatch):
    """The package is asked for only where a bag is read."""
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(LogError, match=r"pip install 'frasa\[formats\]'"):
        read_bag(Path(bags["ros1"]))


def test_databases_that_compute(bags, tmp_path):
    """A view or a computed column is SQL of a stranger, which need not end; columns hold any type."""
    import sqlite3

    endless = "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n)"
    view = f"CREATE VIEW messages AS {endless} SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
    for commands, complaint in (
        (("ALTER TABLE messages RENAME TO other", view), "'messages' is a view, computed by SQL"),
        (("ALTER TABLE topics ADD COLUMN a AS (zeroblob(900000000))",), "'topics' is a table, computed by SQL"),
        (("UPDATE topics SET name = x'ff', type = 5",), "a topic whose name or type is no text"),
    ):
        path = tmp_path / "a.db3"
        path.write_bytes(bags["old"].read_bytes())
        with sqlite3.connect(path) as base:
            for command in commands:
                base.execute(command)
        base.close()
        with pytest.raises(LogError, match=complaint):
            read_bag(path)


def test_chunks_of_bags_unpack_within_bounds(monkeypatch):
    """What `rosbags` unpacks stops at a limit, in each packing."""
    import bz2

    import lz4.frame
    import zstandard

    monkeypatch.setattr(bag_bounds, "CHUNK_LIMIT", 2**16)
    packers = ((bag_bounds.unpack_bz2, bz2.compress), (bag_bounds.unpack_lz4, lz4.frame.compress))
    for unpack, pack in (*packers, (bag_bounds.unpack_zstd, zstandard.compress)):
        assert unpack(pack(b"a" * 2**16)) == b"a" * 2**16
        with pytest.raises(ValueError, match="unpacks to more than 65536 bytes"):
            unpack(pack(bytes(2**22)))


def test_definitions_that_take_memory_without_bytes():
    """Arrays of empty messages, and of a fixed number of elements that no message has."""
    line = "=" * 80
    for text in (f"a/E[] x\n{line}\nMSG: a/E\n", f"a/E[9] x\n{line}\nMSG: a/E\n", "float64[4000000000] x\n"):
        with pytest.raises(ValueError, match="is an array of"):
            bag_bounds.check_definitions(get_types_from_msg(text, "a/msg/B"))
    bag_bounds.check_definitions(get_types_from_msg("float64[36] x\nstring[] names\n", "a/msg/B"))


def test_metadata_of_a_folder_is_plain(metadata):
    """Aliases and tags are refused before another reader of YAML sees them."""
    good = metadata.read_text()
    for more in ("a: &a [1]\nb: *a\n", "a: !!python/name:os.system\n", "a: " + "[" * 5000):
        metadata.write_text(good + more)
        with pytest.raises(LogError, match="is not YAML"):
            read_bag(metadata)


def test_topics_of_metadata_that_are_no_text(metadata):
    """YAML may hold anything for a name or type: it costs that topic, or the bag, not a traceback."""
    good = metadata.read_text()
    for word in ("name: /joint_states", "type: sensor_msgs/msg/JointState"):
        assert word in good
        metadata.write_text(good.replace(word, f"{word.partition(':')[0]}: {{a: 1}}"))
        found = read_bag(metadata)[0]
        assert "goal" in found.signals
        assert "velocity@/joint_states" not in found.signals
        assert any("no text" in fault.message for fault in found.faults)


def test_metadata_with_a_word_for_its_files(metadata):
    """The package takes it for a list of files only as it closes, when all has been read."""
    said = yaml.safe_load(metadata.read_text())
    said["rosbag2_bagfile_information"]["files"] = "none"
    metadata.write_text(yaml.safe_dump(said))
    assert read_bag(metadata)[0].signals

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid import writer
from frasa_sysid.errors import LogError
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Fault, Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap


def make_recording(signals, rig=None, **others):
    others = {"origin": "real", "source": "x", "sha256": "0", "clock": "file"} | others
    return Recording(name="r", signals={one.name: one for one in signals}, rig=rig or RigFacts(), **others)


def bench(n=50):
    t = np.arange(n) * 0.01
    return make_recording(
        [
            Signal("position", "rad", t, np.sin(t)),
            Signal("velocity", "rad/s", t[1:], np.cos(t[1:])),
            Signal("goal", "rad", t, np.sin(t + 0.02)),
            Signal("supply_voltage", "V", t, 12 + 0.01 * t),
            Signal("temperature", "degC", t[::10], 30 + t[::10]),
        ],
        RigFacts(servo="mx106", mass=0.1 + 0.2, length=0.1, firmware_gain=32, trajectory="sin_sin"),
        origin="simulated",
        truth={"kp": 1 / 3},
        faults=(Fault("failed_read", 2, "two were dropped"),),
        extra={"offset": 0.1, "ki": 0, "note": "bench 3", "motor": {"name": "é"}},
    )


def assert_same(one, two):
    assert set(one.signals) == set(two.signals)
    for name, signal in one.signals.items():
        np.testing.assert_array_equal(signal.y, two.signals[name].y)
        np.testing.assert_allclose(signal.t, two.signals[name].t, rtol=0, atol=1e-9)
        assert (signal.unit, signal.columns) == (two.signals[name].unit, two.signals[name].columns)
    for what in ("rig", "origin", "truth", "extra", "faults"):
        assert getattr(one, what) == getattr(two, what)


def test_round_trip(tmp_path):
    """Reading what was written gives the same signals, facts, truth, faults and extras."""
    recordings = [bench(), replace(bench(80), rig=RigFacts(), origin="real", truth={}, faults=(), extra={})]
    write_mcap(tmp_path / "a.mcap", recordings)
    back = read_log(tmp_path / "a.mcap")
    assert [one.name for one in back] == ["a.mcap#00", "a.mcap#01"]
    assert {one.clock for one in back} == {"header"}
    for one, two in zip(recordings, back, strict=True):
        assert_same(one, two)


def test_robot_round_trip(tmp_path):
    """Several joints and an IMU keep their columns, each signal its own clock."""
    t = np.arange(40) * 0.01
    rng = np.random.default_rng(0)
    robot = make_recording(
        [
            Signal("position", "rad", t, rng.uniform(-1, 1, (40, 2)), ("knee", "hip")),
            Signal("goal", "rad", t[::2], rng.uniform(-1, 1, (20, 1))[:, 0]),
            Signal("gyro", "rad/s", t + 0.0005, rng.normal(size=(40, 3)), ("x", "y", "z")),
            Signal("orientation", "1", t[3:] + 0.0005, rng.normal(size=(37, 4)), ("w", "x", "y", "z")),
            Signal("current", "A", t, rng.normal(size=(40, 2)), ("knee", "hip")),
        ]
    )
    write_mcap(tmp_path / "robot.mcap", [robot])
    assert_same(robot, read_log(tmp_path / "robot.mcap")[0])


# Values stay below a turn apart: a larger jump is an encoder wrap, which reading undoes.
values = hnp.arrays(np.float64, st.integers(1, 20), elements=st.floats(-2.5, 2.5))


@settings(max_examples=40, deadline=None)
@given(y=values, periods=st.data(), mass=st.floats(0, 1e6), length=st.none() | st.floats(1e-12, 10))
def test_round_trip_of_anything(y, periods, mass, length, tmp_path_factory):
    """Times come back to a nanosecond and numbers exactly, whatever they are."""
    dt = periods.draw(hnp.arrays(np.float64, y.size, elements=st.floats(1e-6, 100)))
    t = np.cumsum(dt) - dt[0]
    given = make_recording([Signal("goal", "rad", t, y)], RigFacts(mass=mass, length=length))
    path = tmp_path_factory.mktemp("any") / "any.mcap"
    write_mcap(path, [given])
    back = read_log(path)[0]
    np.testing.assert_array_equal(back.signal("goal").y, y)
    np.testing.assert_allclose(back.signal("goal").t, t, rtol=0, atol=1e-9)
    assert back.rig == given.rig


def test_same_recordings_same_bytes(tmp_path):
    """The bytes depend on the recordings alone, and a file read and written again stays as it was."""
    write_mcap(tmp_path / "one.mcap", [bench(), bench(30)], {"log.json": b"{}"})
    write_mcap(tmp_path / "two.mcap", [bench(), bench(30)], {"log.json": b"{}"})
    write_mcap(tmp_path / "again.mcap", read_log(tmp_path / "one.mcap"), {"log.json": b"{}"})
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()


def test_opens_without_frasa(tmp_path):
    """The plain libraries read it through index and statistics, every channel with its schema."""
    write_mcap(tmp_path / "a.mcap", [bench(), bench(30)], {"log.json": b"original"})
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count > 0
        assert summary.chunk_indexes
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        for channel in summary.channels.values():
            assert channel.schema_id > 0
            schema = summary.schemas[channel.schema_id]
            assert schema.data
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
        seen = list(reader.iter_decoded_messages(log_time_order=False))
        assert len(seen) == summary.statistics.message_count
        times = [message.log_time for _, _, message, _ in seen]
        assert times == sorted(times)
        for _, _, message, decoded in seen:
            stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
            assert message.log_time == message.publish_time == stamp
        assert {channel.topic for _, channel, _, _ in seen} == {
            "/joint_states",
            "/joint_command",
            "/dynamic_joint_states",
        }
        records = list(reader.iter_metadata())
        assert [record.name for record in records] == ["frasa.bench", "frasa.bench", "frasa.made"]
        assert float(records[0].metadata["mass"]) == 0.1 + 0.2
        assert int(records[1].metadata["start_ns"]) - int(records[0].metadata["end_ns"]) >= 10**9
        assert [one.data for one in reader.iter_attachments()] == [b"original"]


def test_imu_without_orientation_says_so(tmp_path):
    """What the IMU does not give is marked by a covariance of -1 and does not come back as zeros."""
    t = np.arange(5) * 0.01
    gyro = Signal("gyro", "rad/s", t, np.ones((5, 3)), ("x", "y", "z"))
    write_mcap(tmp_path / "imu.mcap", [make_recording([gyro])])
    assert set(read_log(tmp_path / "imu.mcap")[0].signals) == {"gyro"}


@pytest.mark.parametrize(
    ("signals", "complaint"),
    [
        ([Signal("goal", "rad", np.array([-1.0, 0.0]), np.zeros(2))], "before its time zero"),
        ([Signal("goal", "rad", np.array([0.0, 1e-11]), np.zeros(2))], "nanosecond"),
        ([], "no signals"),
    ],
)
def test_what_cannot_be_written(tmp_path, signals, complaint):
    """A recording that would not come back is refused, and the old file stays."""
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    with pytest.raises(LogError, match=complaint):
        write_mcap(path, [make_recording(signals)])
    with pytest.raises(LogError, match="no recording"):
        write_mcap(path, [])
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_replaces_through_a_rename(tmp_path: Path):
    """An existing file is replaced whole, nothing else is left in the folder."""
    path = tmp_path / "a.mcap"
    write_mcap(path, [bench()])
    write_mcap(path, [bench(10)])
    assert list(tmp_path.iterdir()) == [path]
    assert read_log(path)[0].signal("position").t.size == 10
    assert io.BytesIO(path.read_bytes()).read(5) == b"\x89MCAP"


def test_messages_are_made_as_they_are_written(tmp_path, monkeypatch):
    """A log is written a few messages at a time, in order of time over all topics, whatever the size of the pieces."""
    t = np.arange(50) / 100
    recording = Recording(
        name="a",
        signals={
            "position": Signal("position", "rad", t, np.sin(t)),
            "goal": Signal("goal", "rad", t[::3] + 0.001, np.cos(t[::3])),
            "duty": Signal("duty", "1", t[5:], t[5:]),
            "gyro": Signal("gyro", "rad/s", t[::2], np.stack([t, t, t], axis=1)[::2], ("x", "y", "z")),
        },
        rig=RigFacts(servo="mx106"),
        origin="real",
        source="a",
        sha256="0" * 64,
        clock="header",
    )
    write_mcap(tmp_path / "a.mcap", [recording])
    monkeypatch.setattr(writer, "BLOCK", 7)
    write_mcap(tmp_path / "b.mcap", [recording])
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with (tmp_path / "a.mcap").open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times == sorted(times)
    assert len(times) == 50 + 17 + 45 + 25

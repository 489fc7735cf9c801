"""A log that is more than memory is given to: what is kept, what is said of the rest."""

import numpy as np
import pytest
from mcap_ros2.writer import Writer as Ros2Writer

from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.excerpt import liveliest, part, words
from frasa_sysid.message_definitions import IMU, JOINT_STATE
from frasa_sysid.readers import read_mcap
from frasa_sysid.readers.kept_windows import NUMBERS, KeptWindows, Limit
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.robot_residuals import residual_count, stride_of

S = 10**9
EPOCH = 1_700_000_000 * S
RATE = 20  # Hz
SECONDS = 200
LIVELY = (90.0, 130.0)  # [s] in which the joints move
LIMIT = 5 * 10 * RATE * (2 * 2 + 2 * 4 + 3 * 3 + 3 * 4)  # five windows of joints and IMU


def log(path, bad=(), by_topic=False):
    """Two joints that move between two times only, and an IMU; NaN at some samples."""
    t = np.arange(SECONDS * RATE) / RATE
    moving = (t >= LIVELY[0]) & (t < LIVELY[1])
    q = np.where(moving, np.sin(3.0 * t), 0.0)
    joints, imu = [], []
    for i, time in enumerate(t):
        ns = EPOCH + int(time * S)
        header = {"stamp": {"sec": ns // S, "nanosec": ns % S}, "frame_id": ""}
        value = float("nan") if i in bad else float(q[i])
        state = {"header": header, "name": ["a", "b"], "position": [value, -value], "velocity": [0.0, 0.0]}
        rates = {"angular_velocity": {"x": 0.1, "y": 0.2, "z": float(i)}, "linear_acceleration": dict(x=0, y=0, z=9.81)}
        turn = {"orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        joints.append(("/joint_states", "sensor_msgs/msg/JointState", ns, state))
        imu.append(("/imu/data", "sensor_msgs/msg/Imu", ns, {"header": header, **rates, **turn}))
    messages = imu + joints if by_topic else [one for pair in zip(joints, imu, strict=True) for one in pair]
    with path.open("wb") as file, Ros2Writer(file, chunk_size=20_000) as writer:
        kinds = {"sensor_msgs/msg/JointState": JOINT_STATE, "sensor_msgs/msg/Imu": IMU}
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in kinds.items()}
        for topic, kind, ns, content in messages:
            writer.write_message(topic, schemas[kind], content, log_time=ns + 2 * 10**6, publish_time=ns + 10**6)
    return path


@pytest.fixture(scope="module")
def long_log(tmp_path_factory):
    return log(tmp_path_factory.mktemp("long") / "walk.mcap", bad=(50, 51, 3000))


def numbers_in(recordings):
    return sum(signal.y.size for one in recordings for signal in one.signals.values())


def test_a_usual_log_is_kept_whole(long_log):
    """Nothing is cut, nothing is said, of a log that memory has room for."""
    whole = read_mcap(long_log)
    assert [one.name for one in whole] == ["walk.mcap"]
    assert "excerpt" not in {fault.code for fault in whole[0].faults}
    assert whole[0].signal("gyro").t.size == SECONDS * RATE
    assert NUMBERS * 8 == 2**27


def test_the_lively_part_is_kept_and_the_rest_is_told(long_log):
    """Of a log that is too long the windows in which the joints move are kept, and every sample is accounted for."""
    found = read_mcap(long_log, limit=Limit(LIMIT))
    spans = [(one.extra["excerpt"]["from_s"], one.extra["excerpt"]["to_s"]) for one in found]
    assert all(one.name == f"walk.mcap@{begin:.0f}s" for one, (begin, _) in zip(found, spans, strict=True))
    assert any(begin <= LIVELY[0] and end >= LIVELY[1] for begin, end in spans)
    assert numbers_in(found) <= LIMIT
    fault = next(fault for fault in found[-1].faults if fault.code == "excerpt")
    assert "200 s are more than memory is given to" in fault.message
    assert "--between" in fault.message
    whole = found[0].extra["whole_log"]
    assert whole["position"]["samples"] == whole["gyro"]["samples"] == SECONDS * RATE
    assert whole["position"]["not_finite"] == 3
    assert whole["gyro"]["high"] == SECONDS * RATE - 1
    kept = sum(one.signals[name].t.size for one in found for name in one.signals)
    dropped = sum(fault.count for one in found for fault in one.faults if fault.code == "not_finite")
    assert kept + dropped + fault.count == SECONDS * RATE * len(whole)
    rest = [fault.message for fault in found[-1].faults if fault.code == "rest_of_log"]
    assert rest == [f"position, in the part that is not kept: {3 - dropped} samples not finite"]


def test_the_same_samples_as_of_the_whole(long_log):
    """What is kept is what the whole log has there, to the last bit, and clocks are compared over all of it."""
    whole, found = read_mcap(long_log)[0], read_mcap(long_log, limit=Limit(LIMIT))
    for one in found:
        begin = one.extra["excerpt"]["from_s"]
        rows = np.searchsorted(whole.signal("gyro").y[:, 2], one.signal("gyro").y[:, 2])
        np.testing.assert_array_equal(whole.signal("gyro").y[rows], one.signal("gyro").y)
        np.testing.assert_allclose(whole.signal("gyro").t[rows] - one.signal("gyro").t, begin, atol=1.0 / RATE)
    assert found[0].extra["clocks"][0]["drift_ppm"]["value"] == pytest.approx(0.0, abs=1e-3)


def test_topics_one_after_the_other(tmp_path):
    """A file with the IMU first and the joints behind it keeps the same windows of both, within bounds."""
    found = read_mcap(log(tmp_path / "a.mcap", by_topic=True), limit=Limit(LIMIT))
    assert numbers_in(found) <= LIMIT
    assert all({"position", "gyro"} <= set(one.signals) for one in found)


def test_between(long_log):
    """A part that was asked for is read and no other; one that is not there is an error with the log's length."""
    found = read_mcap(long_log, limit=Limit(between=(20.0, 35.0)))
    assert [one.name for one in found] == ["walk.mcap@20s"]
    assert found[0].duration == pytest.approx(15.0, abs=0.1)
    assert "as asked" in next(fault.message for fault in found[0].faults if fault.code == "excerpt")
    with pytest.raises(LogError, match=r"nothing between 300 and 400 s; the log goes from 0 to 19\d"):
        read_mcap(long_log, limit=Limit(between=(300.0, 400.0)))
    with pytest.raises(UsageError, match="--between 5 2"):
        Limit(between=(5.0, 2.0))


def robot_recording(name, seconds, rate, lively, base="fixed"):
    """Two joints that move in some seconds only, on their own clock."""
    t = np.arange(round(seconds * rate)) / rate
    q = np.where((t >= lively[0]) & (t < lively[1]), np.sin(5.0 * t), 0.0)
    signals = {
        one: Signal(one, unit, t, np.stack([q, -q], axis=1), ("a", "b"))
        for one, unit in (("position", "rad"), ("velocity", "rad/s"), ("goal", "rad"))
    }
    return Recording(name, signals, RigFacts(base=base), "real", name, "0" * 64, "header")


def test_a_fit_takes_the_parts_that_move():
    """Within a budget every log keeps its share, by the windows that move most; nothing shorter than it is worth."""
    logs = [
        robot_recording("up.mcap", 100.0, 100.0, (40.0, 50.0)),
        robot_recording("down.mcap", 100.0, 100.0, (10.0, 20.0)),
    ]
    logs.append(part(robot_recording("up.mcap", 300.0, 100.0, (0.0, 300.0)), 299.5, 300.0))
    most = 4 * 3000
    kept = liveliest(logs, residual_count, most)
    assert sum(residual_count(one) for one in kept) <= most
    assert [one.name for one in kept] == ["up.mcap@40s", "down.mcap@10s"]
    assert kept[0].signal("position").t[0] == pytest.approx(0.0, abs=0.01)
    assert kept[1].duration == pytest.approx(10.0, abs=0.02)
    assert words(kept) == "up.mcap: 10 of 100 s (40-50 s); down.mcap: 10 of 100 s (10-20 s)"
    assert liveliest(logs, residual_count, 10**6) == logs
    assert words(logs[:2]) == ""


def test_a_kilohertz_is_compared_at_200_hz():
    """Samples that come ten to a correlation time cost memory and tell nothing more."""
    fast, slow = (robot_recording("a.mcap", 20.0, rate, (0.0, 20.0)) for rate in (1000.0, 100.0))
    assert (stride_of(fast.signal("position").t), stride_of(slow.signal("position").t)) == (5, 1)
    assert residual_count(fast) == 2 * residual_count(slow) == 2 * 8000


def test_stamps_beyond_any_clock():
    """A log time that no signed number holds is as late as can be, not an error."""
    windows = KeptWindows(Limit())
    assert windows.of(np.array([2**64 - 1, 2**63], dtype=np.uint64)).tolist() == [0, 0]

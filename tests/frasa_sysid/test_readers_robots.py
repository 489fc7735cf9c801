import gzip
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.errors import LogError
from frasa_sysid.readers.harold import read_harold
from frasa_sysid.readers.imu_on_axis import read_imu_on_axis
from frasa_sysid.readers.kbot import read_kbot
from frasa_sysid.readers.mcap import read_mcap
from frasa_sysid.readers.robstride import read_robstride
from frasa_sysid.readers.rostopic_csv import read_rostopic_csv
from frasa_sysid.readers.upkie import read_upkie
from frasa_sysid.writer import write_mcap

IMU_LINES = "0.0 -0.5 0 2.0 0 0.2 -0.5\n0.002 -0.4 0 1.9 0.004 0.3 -0.4\n0.004 -0.3 0 1.8 0.008 0.3 -0.3\n"
CHIRP = {
    "config": {"kp": 150.0, "kd": 8.0, "actuator_id": 44},
    "data": [
        {"time_since_start": 0.01 * i, "position": 45.0, "commanded_position": 90.0, "torque": 1.0, "freq": 0.2}
        for i in range(3)
    ],
}
METADATA = {"joint_name_to_metadata": {"knee": {"id": 44, "actuator_type": "Robstride_04"}}}
SQUAT = [
    {"time": t, "actuator_id": one, "position": 45.0, "commanded_position": 90.0, "velocity": 180.0}
    for t in (0.2, 0.0, 0.1)
    for one in (31, 44)
]
HAROLD = (
    "timestamp,timestamp_ms,pos_hip,pos_knee,cmd_pos_hip,cmd_pos_knee,load_hip,load_knee,bus_voltage_v,mode,cmd_vx\n"
    "2026-01-02T05:02:24.729,100,0.1,0.2,0.3,0.4,8,9,12.1,POLICY,0.3\n"
    "2026-01-02T05:02:24.930,301,0.2,0.3,0.4,0.5,8,9,12.0,STAND,0.3\n"
)
UPKIE = [
    {
        "time": 100.002 + 0.05 * i,
        "action": {"servo": {"hip": {"position": 0.1, "velocity": 0.0}, "wheel": {"position": None, "velocity": 1.0}}},
        "observation": {
            "time": 100.0 + 0.05 * i,
            "servo": {"hip": {"position": 0.1, "velocity": 0.0}, "wheel": {"position": 5.0, "velocity": 1.0}},
            "imu": {"angular_velocity": [0.1, 0.2, 0.3], "orientation": [1.0, 0.0, 0.0, 0.0]},
            "cpu_temperature": 53.0,
        },
    }
    for i in range(3)
]
ROSTOPIC = (
    "%time,field.header.seq,field.header.stamp,field.angular_velocity.x,field.angular_velocity.y,"
    "field.angular_velocity.z\n"
    "1638567086107885441,1,1638567085109329358,0.1,0.2,0.3\n"
    "1638567086117897383,2,1638567085119357711,0.1,0.2,0.4\n"
)


def put(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def lines(cycles):
    return "\n".join(json.dumps(one) for one in cycles)


CASES = [
    (read_imu_on_axis, IMU_LINES),
    (read_robstride, json.dumps(CHIRP)),
    (read_kbot, json.dumps(SQUAT)),
    (read_harold, HAROLD),
    (read_upkie, lines(UPKIE)),
    (read_rostopic_csv, ROSTOPIC),
]


@pytest.mark.parametrize(("read", "content"), CASES, ids=lambda one: getattr(one, "__name__", ""))
def test_nothing_is_lost_on_the_way_to_mcap(tmp_path, read, content):
    """Signals, columns, units, faults and extras come back from the MCAP as they were read."""
    recording = read(put(tmp_path / "log", content))[0]
    write_mcap(tmp_path / "log.mcap", [recording], {"log": content.encode()})
    back = read_mcap(tmp_path / "log.mcap")[0]
    assert back.signals.keys() == recording.signals.keys()
    for name, signal in recording.signals.items():
        np.testing.assert_allclose(back.signals[name].t, signal.t, atol=1e-9)
        np.testing.assert_array_equal(back.signals[name].y.ravel(), signal.y.ravel())
        assert back.signals[name].unit == signal.unit
        assert len(signal.columns) < 2 or back.signals[name].columns == signal.columns
    assert set(recording.faults) <= set(back.faults)
    assert dict(back.extra) == json.loads(json.dumps(dict(recording.extra)))


def test_imu_on_axis(tmp_path):
    """The motor's columns are commands, and are called so."""
    one = read_imu_on_axis(put(tmp_path / "a.dat", IMU_LINES))[0]
    np.testing.assert_allclose(one.signal("gyro").y, [-0.5, -0.4, -0.3])
    np.testing.assert_allclose(one.signal("goal_velocity").y, [2.0, 1.9, 1.8])
    assert {name: signal.unit for name, signal in one.signals.items()} == {
        "gyro": "rad/s",
        "imu_angle": "rad",
        "goal_velocity": "rad/s",
        "goal": "rad",
        "kalman_angle": "rad",
        "kalman_rate": "rad/s",
    }


def test_robstride(tmp_path):
    """Degrees become radians; the actuator's type and joint come from the metadata beside the log."""
    put(tmp_path / "metadata.json", METADATA)
    one = read_robstride(put(tmp_path / "a.json", CHIRP))[0]
    np.testing.assert_allclose(one.signal("position").y, np.pi / 4)
    np.testing.assert_allclose(one.signal("goal").y, np.pi / 2)
    assert one.rig.servo == "robstride_04"
    assert one.rig.firmware_gain == 150.0
    assert one.rig.trajectory == "chirp"
    assert one.extra["joint"] == "knee"
    (tmp_path / "metadata.json").unlink()
    assert read_robstride(tmp_path / "a.json")[0].rig.servo == "robstride"


def test_kbot(tmp_path):
    """Records out of time order are sorted, counted and put into one frame an instant."""
    one = read_kbot(put(tmp_path / "a.json", SQUAT))[0]
    np.testing.assert_allclose(one.signal("position").t, [0.0, 0.1, 0.2])
    assert one.signal("position").columns == ("31", "44")
    np.testing.assert_allclose(one.signal("velocity").y, np.pi)
    assert [(fault.code, fault.count) for fault in one.faults] == [("time_order", 1)]


def test_kbot_incomplete(tmp_path):
    """An instant that lacks an actuator, or has one twice, is left out or kept once, and counted."""
    one = read_kbot(put(tmp_path / "a.json", [*SQUAT[:-1], SQUAT[0]]))[0]
    assert one.signal("position").t.size == 2
    codes = {fault.code: fault.count for fault in one.faults}
    assert codes["missing_joint"] == 1
    assert codes["repeated_time"] == 1


def test_harold(tmp_path):
    """A wide table: groups of columns become signals of several joints; both clocks are compared."""
    one = read_harold(put(tmp_path / "a.csv", HAROLD))[0]
    assert one.signal("position").columns == ("hip", "knee")
    np.testing.assert_allclose(one.signal("goal").y, [[0.3, 0.4], [0.4, 0.5]])
    assert one.signal("supply_voltage").columns == ("battery",)
    np.testing.assert_allclose(one.signal("position").t, [0.0, 0.201])
    assert one.extra["modes"] == ["POLICY", "STAND"]
    assert one.extra["clocks"][0]["of"] == "file"


def test_upkie(tmp_path):
    """Commands are of their own time, nulls leave out a column, other numbers are kept under their path."""
    one = read_upkie(put(tmp_path / "a.json", lines(UPKIE)))[0]
    assert one.signal("goal").columns == ("hip",)
    assert one.signal("position").columns == ("hip", "wheel")
    assert one.signal("goal").t[0] == pytest.approx(0.002)
    assert one.signal("orientation").columns == ("w", "x", "y", "z")
    np.testing.assert_allclose(one.signal("observation.cpu_temperature").y, 53.0)
    assert one.faults == ()


def test_rostopic(tmp_path):
    """The stamps are the time; what arrived long after them is a backlog and counted."""
    one = read_rostopic_csv(put(tmp_path / "a.csv", ROSTOPIC))[0]
    np.testing.assert_allclose(one.signal("gyro").t, [0.0, 0.010028353])
    assert [(fault.code, fault.count) for fault in one.faults] == [("backlog", 2)]


@pytest.mark.parametrize(
    ("read", "content", "complaint"),
    [
        (read_imu_on_axis, "0 1 2\n", "line 1 has 3 numbers, expected 7; was it cut off"),
        (read_imu_on_axis, "a b c d e f g\n", "line 1 is not numbers"),
        (read_imu_on_axis, "0 99999 0 0 0 0 0\n", "expected rad/s"),
        (read_imu_on_axis, " \n", "holds no line"),
        (read_robstride, "[]", "not a Robstride run"),
        (read_robstride, '{"config": {}, "data": [{"position": 1}]}', "lacks 'time_since_start'"),
        (
            read_robstride,
            '{"config": {}, "data": [{"position": 1, "time_since_start": null}]}',
            "no sample with a time",
        ),
        (read_robstride, "{", "is not JSON"),
        (read_kbot, "{}", "not a K-Bot log"),
        (read_kbot, '[{"time": 0}]', "record 0 lacks"),
        (read_harold, "timestamp,pos_a\n1,2\n", "no column timestamp_ms"),
        (read_harold, "timestamp,timestamp_ms,x\n2026-01-01T00:00:00,1,2\n", "no column 'pos_"),
        (read_harold, "timestamp,timestamp_ms,pos_a\nnoon,1,2\n", "not an ISO time"),
        (read_harold, HAROLD + "2026-01-02T05:02", "fields, expected 11; was it cut off"),
        (read_upkie, "[1]\n", "line 1 is not an Upkie cycle"),
        (read_upkie, lines(UPKIE) + '\n{"time": 1', "line 4 is not JSON"),
        (read_upkie, '{"time": 1}\n', "no observation/servo"),
        (read_upkie, "\n", "holds no cycle"),
        (read_rostopic_csv, "%time,field.header.stamp,field.data\n1,2,3\n", "expected columns of sensor_msgs/Imu"),
        (read_rostopic_csv, "%time,field.data\n1,3\n", "no column field.header.stamp"),
        (read_rostopic_csv, ROSTOPIC + "12,3,x,1,2,3\n", "is not a whole number"),
    ],
)
def test_bad_files_are_refused(tmp_path, read, content, complaint):
    """One line with what was found and what was expected."""
    with pytest.raises(LogError, match=complaint):
        read(put(tmp_path / "a", content))


@pytest.mark.parametrize(("read", "content"), CASES, ids=lambda one: getattr(one, "__name__", ""))
def test_cut_off_gzip_is_refused(tmp_path, read, content):
    """A packed log that was cut off is damaged, not short."""
    (tmp_path / "a.gz").write_bytes(gzip.compress(content.encode() * 50)[:-9])
    with pytest.raises(LogError, match="damaged gzip"):
        read(tmp_path / "a.gz")


ANY = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=3), st.lists, max_leaves=5
)


@settings(max_examples=60, deadline=None)
@given(a=ANY, b=ANY, c=ANY)
def test_any_json_is_read_or_refused(tmp_path_factory, a, b, c):
    """Whatever stands in a field, a log is read or refused, and nothing else happens."""
    folder = tmp_path_factory.mktemp("fuzz")
    record = {"time_since_start": a, "position": b, "commanded_position": c}
    cycle = {"time": a, "observation": {"time": b, "servo": {"hip": {"position": c}}, "imu": {"orientation": a}}}
    made = [
        (read_robstride, json.dumps({"config": {"kp": c, "actuator_id": a}, "data": [record, record]})),
        (read_kbot, json.dumps([{"time": a, "actuator_id": b, "position": c}, *SQUAT])),
        (read_upkie, lines([cycle, cycle])),
    ]
    for read, content in made:
        try:
            read(put(folder / "a", content))
        except LogError:
            continue

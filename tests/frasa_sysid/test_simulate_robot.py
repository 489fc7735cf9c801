import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.excitation_hung import design, first_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.readers import read_log
from frasa_sysid.robot_body import build, joints_of
from frasa_sysid.robot_physics import ENCODER_COUNT, simulate
from frasa_sysid.robot_truth import draw
from frasa_sysid.simulate_robot import GYRO_COUNT, IDEAL, SETTLE, SPEED_COUNT, WRITE_AFTER, Wiring, simulate_robot
from frasa_sysid.writer import write_mcap


@pytest.fixture(scope="module")
def path(robot_model_dir):
    return robot_model_dir / "nominal.xml"


@pytest.fixture(scope="module")
def joints(path):
    return joints_of(path)


def hung(joints, seconds=10.0):
    sizes = first_sizes(joints)
    return design(joints, replace(sizes, quick=sizes.quick / 3, swing=sizes.swing / 3, step=sizes.step / 3), seconds)


@pytest.fixture(scope="module")
def ideal(path, joints):
    """Four seconds of a held robot whose computer reads without faults."""
    truth = draw("fixed", 11, joints.classes, joints.names)
    return simulate_robot(path, joints, truth, hung(joints), 4.0, "x.mcap", IDEAL, timestep=0.0005)


@pytest.fixture(scope="module")
def nodding(path, joints):
    """A robot that nods on its feet, read without faults."""
    truth = draw("floating", 12, joints.classes, joints.names)
    excitation = standing(joints, 10.0)
    return simulate_robot(path, joints, truth, excitation, 5.6, "x.mcap", IDEAL, timestep=0.001)


@pytest.fixture(scope="module")
def recorded(path, joints):
    """Six seconds as a robot records them."""
    truth = draw("fixed", 13, joints.classes, joints.names)
    return simulate_robot(path, joints, truth, hung(joints), 6.0, "x.mcap", timestep=0.001)


def lag(times, early, t, late, most=0.1):
    """By how much `late` at t is behind `early` at other times [s]: least squares over shifts of a spline."""
    spline = CubicSpline(times, early)
    inside = (t > times[0] + most + 0.01) & (t < times[-1] - most - 0.01)
    worth = lambda shift: float(((late[inside] - spline(t[inside] - shift)) ** 2).sum())  # noqa: E731
    grid = np.arange(-most, most, 0.002)
    start = grid[np.argmin([worth(one) for one in grid])]
    return minimize_scalar(worth, bounds=(start - 0.003, start + 0.003), method="bounded", options={"xatol": 1e-7}).x


def true_motion(path, joints, truth, excitation, seconds, timestep):
    """What the robot of a log without faults did."""
    written = np.arange(-SETTLE, seconds - 1e-9, IDEAL.period) + WRITE_AFTER
    body = build(path, truth, joints, timestep)
    return simulate(body, joints, truth, written, excitation.at(written), seconds, quantized=False)


def test_joint_channels_are_late_by_their_delays(path, joints, ideal):
    """Position and velocity trail the true angle and its differences by what was drawn, at every joint."""
    truth = draw("fixed", 11, joints.classes, joints.names)
    true = true_motion(path, joints, truth, hung(joints), 4.0, 0.0005)
    middle = (true.t[1:] + true.t[:-1]) / 2
    speed = np.diff(true.angle, axis=0) / np.diff(true.t)[:, None]
    for name, times, motion in (("position", true.t, true.angle), ("velocity", middle, speed)):
        signal, delay = ideal.signal(name), ideal.truth[f"sensor.{name}_delay"]
        moving = signal.t > 0.8
        zeros = [ideal.truth[f"{one}.zero"] if name == "position" else 0.0 for one in joints.names]
        for i, zero in enumerate(zeros):
            late = lag(times[::2], motion[::2, i], signal.t[moving], signal.y[moving, i] - zero)
            assert late == pytest.approx(delay, abs=1e-4), (name, joints.names[i])


def test_gyro_and_orientation_are_late_by_their_delays(nodding):
    """The gyro's pitch rate leads or trails the orientation's by the difference of their delays."""
    q, gyro = nodding.signal("orientation"), nodding.signal("gyro")
    pitch = np.arcsin(2 * (q.y[:, 0] * q.y[:, 2] - q.y[:, 3] * q.y[:, 1]))
    rate = CubicSpline(q.t, pitch)(q.t, 1)
    expected = nodding.truth["sensor.gyro_delay"] - nodding.truth["sensor.orientation_delay"]
    moving = gyro.t > 1.5
    late = lag(q.t, rate, gyro.t[moving], gyro.y[moving, 1] - nodding.truth["imu.gyro_bias_y"])
    assert late == pytest.approx(expected, abs=5e-4)


def test_trunk_is_late_against_the_joints(path, joints, nodding):
    """A robot with all ages zero tells the same story earlier: each channel by its own delay."""
    truth = draw("floating", 12, joints.classes, joints.names)
    young = replace(truth, position_delay=0.0, velocity_delay=0.0, gyro_delay=0.0, orientation_delay=0.0)
    early = simulate_robot(path, joints, young, standing(joints, 10.0), 5.6, "x.mcap", IDEAL, timestep=0.001)
    for name, signal in nodding.signals.items():
        if name in ("position", "velocity", "gyro", "orientation"):
            delay = nodding.truth[f"sensor.{name}_delay"]
            inside = (signal.t > 1.2) & (signal.t < 5.5)
            before = CubicSpline(early.signal(name).t, early.signal(name).y)(signal.t[inside] - delay)
            scale = np.ptp(signal.y[inside], axis=0).max()
            assert np.sqrt(((before - signal.y[inside]) ** 2).mean()) < 0.01 * scale, name


def test_zeros_are_in_the_readings(ideal, joints):
    """At rest the servo's own reading, zero included, is near the goal: the loop closes on what it reads."""
    position, goal = ideal.signal("position"), ideal.signal("goal")
    rest = position.t < 0.4
    error = position.y[rest].mean(axis=0) - goal.y[0]
    zeros = np.array([ideal.truth[f"{name}.zero"] for name in joints.names])
    arms = [i for i, name in enumerate(joints.names) if "yaw" in name]
    # Nothing loads a yaw joint, so friction alone holds it where it started: on its goal.
    assert np.abs(error[arms]).max() < 2e-3
    assert np.abs(zeros).max() <= np.radians(3.0)
    assert 0.3 < np.degrees(zeros).std() < 2.0


def test_bus_and_counts(recorded, joints):
    """Rates, jitter, losses and quanta are those of the wiring."""
    wiring, position, goal = Wiring(), recorded.signal("position"), recorded.signal("goal")
    sent = goal.t.size
    lost = 1 - position.t.size / sent
    assert abs(lost - wiring.lost) < 4 * np.sqrt(wiring.lost / sent)
    assert np.median(np.diff(goal.t)) == pytest.approx(wiring.period, rel=0.02)
    assert np.diff(goal.t).std() > 1e-4
    for name, count in (("position", ENCODER_COUNT), ("goal", ENCODER_COUNT), ("velocity", SPEED_COUNT)):
        counts = recorded.signal(name).y / count
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    gyro = recorded.signal("gyro").y / GYRO_COUNT
    np.testing.assert_allclose(gyro, np.round(gyro), atol=1e-6)
    volts = recorded.signal("supply_voltage").y * 10
    np.testing.assert_allclose(volts, np.round(volts), atol=1e-4)
    assert recorded.signal("supply_voltage").t.size == 60
    assert position.columns == joints.names
    assert np.linalg.norm(recorded.signal("orientation").y, axis=1) == pytest.approx(1.0)


def test_imu_noise(recorded):
    """The held trunk's gyro shows bias and noise; its orientation wanders by a few milliradians."""
    wiring, gyro = Wiring(), recorded.signal("gyro").y
    bias = [recorded.truth[f"imu.gyro_bias_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(gyro.mean(axis=0), bias, atol=4 * wiring.gyro_noise / np.sqrt(len(gyro)))
    assert gyro.std() > 0.8 * wiring.gyro_noise
    spread = 2 * recorded.signal("orientation").y[:, 1:].std(axis=0)
    assert 0.2 * wiring.orientation_noise < spread.mean() < 2 * wiring.orientation_noise


def test_battery_sags_under_load(ideal):
    """The voltage falls below the open one by at least what the electronics draw, more while the robot moves."""
    volts, truth = ideal.signal("supply_voltage"), ideal.truth
    assert volts.y.max() < truth["supply.voltage"] - 2.0 * truth["supply.resistance"]
    assert np.ptp(volts.y) > 0.02


def test_truth_is_named_and_the_same_for_both_bases(ideal, path, joints):
    """All parameters of the plan stand in the recording; a seed is one robot, however it is held."""
    names = {"gain_scale", "damping_scale", "friction_scale", "delay", "kp", "forcerange"}
    assert {f"{servo}.{name}" for servo in ("mx64", "mx106") for name in names} <= set(ideal.truth)
    assert {f"{joint}.zero" for joint in joints.names} <= set(ideal.truth)
    held, free = (draw(base, 5, joints.classes, joints.names) for base in ("fixed", "floating"))
    assert replace(held, base="floating") == free
    others = [draw("fixed", seed, joints.classes, joints.names).command_delay for seed in range(5)]
    assert len(set(others)) == 5


def test_round_trip_and_bytes(recorded, path, joints, tmp_path):
    """The log reads back as it was, and the same seed gives the same bytes."""
    for name in ("a", "b"):
        truth = draw("fixed", 21, joints.classes, joints.names)
        made = simulate_robot(path, joints, truth, hung(joints), 1.0, "r.mcap", timestep=0.001)
        write_mcap(tmp_path / f"{name}.mcap", [made])
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    (back,) = read_log(tmp_path / "a.mcap", "auto")
    assert (back.origin, back.rig.base, dict(back.truth)) == ("simulated", "fixed", dict(made.truth))
    assert set(back.signals) == set(made.signals)
    for name, signal in made.signals.items():
        np.testing.assert_allclose(back.signal(name).t, signal.t, atol=1e-9)
        np.testing.assert_array_equal(back.signal(name).y.reshape(signal.y.shape), signal.y)


def command(*words):
    return run_command(build_parser(), [str(word) for word in words])


def test_the_stored_log_is_simulated_and_says_so(robot_model_dir, capsys):
    """bench_logs/robot.mcap holds two held runs and a standing one of one robot, with their truth; inspect says it."""
    log = robot_model_dir.parent / "bench_logs" / "robot.mcap"
    assert log.stat().st_size < 3e6
    assert command("inspect", log, "--json") == 0
    shown = json.loads(capsys.readouterr().out)["recordings"]
    assert [one["rig"]["base"] for one in shown] == ["fixed", "fixed", "floating"]
    assert {one["origin"] for one in shown} == {"simulated"}
    assert len({one["truth"]["sensor.gyro_delay"] for one in shown}) == 1


def test_command_line(robot_model_dir, tmp_path, capsys):
    """`simulate --robot` writes a log and its truth; options of the other kind are refused."""
    out, model = tmp_path / "r.mcap", robot_model_dir / "nominal.xml"
    base = ("simulate", "--robot", "--out", out, "--model", model, "--base", "floating")
    assert command(*base, "--seed", 4, "--seconds", 0.5, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["truth"]["mx106.delay"] == read_log(out, "auto")[0].truth["mx106.delay"]
    assert command(*base, "--pitch", 80) == 2
    assert "--pitch 80.0" in capsys.readouterr().err
    assert command(*base, "--duty-age", 0.01) == 2
    assert "belongs to --servo" in capsys.readouterr().err
    assert command("simulate", "--servo", "mx64", "--out", out, "--base", "fixed") == 2
    assert command(*base, "--seconds", 0) == 2
    assert command(*base, "--seed", -1) == 2
    assert command("simulate", "--robot", "--out", out, "--model", robot_model_dir / "bench_pendulum.xml") == 3

"""MuJoCo's own delays do what the model's comments say."""

import mujoco
import numpy as np
import pytest
from mujoco import rollout

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


def step_with_motion(model, data, steps, rate=0.5):
    """Move all joints and the trunk's yaw at a constant rate, by hand, and let sensors and history follow."""
    for _ in range(steps):
        angle = rate * data.time
        data.qpos[3:7] = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
        data.qpos[7:] = angle
        data.qvel[:] = data.time
        mujoco.mj_step(model, data)


@pytest.mark.parametrize("delay", [0.0, 0.002, 0.0071, 0.030, 0.0533, 0.080])
def test_joint_measurements_lag(nominal, delay):
    """Position and velocity are read exactly `delay` late, fractions of a step included."""
    for name in ("left_knee.position", "left_knee.velocity"):
        nominal.sensor_delay[nominal.sensor(name).id] = delay
    data = mujoco.MjData(nominal)
    step_with_motion(nominal, data, 100)
    now = data.time - nominal.opt.timestep
    assert data.sensor("left_knee.position").data[0] == pytest.approx(0.5 * (now - delay), abs=1e-12)
    assert data.sensor("left_knee.velocity").data[0] == pytest.approx(now - delay, abs=1e-12)


def test_nominal_delays_lag(nominal):
    """As delivered: position now, velocity 30 ms late, angular rate and orientation 50 ms late."""
    data = mujoco.MjData(nominal)
    step_with_motion(nominal, data, 100)
    now = data.time - nominal.opt.timestep
    assert data.sensor("right_elbow.position").data[0] == pytest.approx(0.5 * now)
    assert data.sensor("right_elbow.velocity").data[0] == pytest.approx(now - 0.030)
    assert data.sensor("gyro").data[2] - data.sensor("measured_gyro").data[2] == pytest.approx(0.050)
    w, _, _, z = data.sensor("measured_orientation").data
    assert 2 * np.arctan2(z, w) == pytest.approx(0.5 * (now - 0.050))


def test_too_long_a_delay_is_cut_to_the_buffer(nominal):
    """MuJoCo cuts a delay beyond the buffer without a word: callers must check."""
    nominal.sensor_delay[nominal.sensor("left_knee.velocity").id] = 0.1
    data = mujoco.MjData(nominal)
    step_with_motion(nominal, data, 100)
    late = data.time - nominal.opt.timestep - data.sensor("left_knee.velocity").data[0]
    assert late == pytest.approx(0.080)


def test_interpolated_quaternion_is_a_little_short(nominal):
    """Between two steps the quaternion is interpolated number by number: its norm is below 1, by 1e-7 at 1 rad/s."""
    nominal.sensor_delay[nominal.sensor("measured_orientation").id] = 0.051
    data = mujoco.MjData(nominal)
    step_with_motion(nominal, data, 100, rate=1.0)
    assert 1 - np.linalg.norm(data.sensor("measured_orientation").data) == pytest.approx(1.25e-7, rel=1e-2)


@pytest.mark.parametrize("delay", [0.002, 0.0071, 0.032])
def test_command_lags(bench, delay):
    """The servo acts on the command of `delay` ago; the force shows it."""
    bench.actuator_delay[0] = delay
    data = mujoco.MjData(bench)
    for _ in range(60):
        data.ctrl[0] = data.time
        start, angle = data.time, data.qpos[0]
        mujoco.mj_step(bench, data)
    goal = data.actuator_force[0] / bench.actuator_gainprm[0, 0] + angle
    assert start - goal == pytest.approx(delay, abs=1e-12)


def test_buffer_without_delay_changes_nothing(robot_model_dir):
    """With delay 0 the motion is the same, bit by bit, as without any history attribute."""
    path = str(robot_model_dir / "bench_pendulum.xml")
    ends = []
    for nsample in (None, 0):
        spec = mujoco.MjSpec.from_file(path)
        if nsample is not None:
            spec.actuator("servo").nsample = nsample
        model = spec.compile()
        data = mujoco.MjData(model)
        for _ in range(500):
            data.ctrl[0] = np.sin(7 * data.time)
            mujoco.mj_step(model, data)
        ends.append((model.nhistory, data.qpos[0], data.qvel[0]))
    assert ends[0][0] > ends[1][0] == 0
    assert ends[0][1:] == ends[1][1:]


def test_reset_leaves_an_empty_history(nominal):
    """After a reset the history is zeros, the quaternion too, until it is filled or the delay has passed."""
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, 0)
    mujoco.mj_forward(nominal, data)
    assert not data.sensor("measured_orientation").data.any()
    sensor = nominal.sensor("measured_orientation").id
    past = np.tile(data.sensor("orientation").data, (nominal.sensor_history[sensor, 0], 1))
    mujoco.mj_initSensorHistory(nominal, data, sensor, None, past, 0.0)
    mujoco.mj_step(nominal, data)
    np.testing.assert_array_equal(data.sensor("measured_orientation").data, past[0])


def test_rollout_carries_the_history(nominal):
    """A roll-out from a saved full state reads the same delayed sensors as plain stepping."""
    nominal.actuator_delay[:] = 0.0071
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, 0)
    commands = nominal.key_ctrl[0] + np.random.default_rng(0).normal(0, 0.1, (80, nominal.nu))
    readings = []
    for step, command in enumerate(commands):
        if step == 30:
            state = np.zeros((1, mujoco.mj_stateSize(nominal, FULL)))
            mujoco.mj_getState(nominal, data, state[0], FULL)
            warmstart = data.qacc_warmstart.copy()[None]
        data.ctrl[:] = command
        mujoco.mj_step(nominal, data)
        readings.append(data.sensordata.copy())
    scratch = [mujoco.MjData(nominal)]
    _, sensors = rollout.rollout(nominal, scratch, state, commands[None, 30:], initial_warmstart=warmstart)
    np.testing.assert_array_equal(sensors[0], readings[30:])


def test_commands_cannot_be_late_by_less_than_a_step(robot_model_dir):
    """MuJoCo acts on a delayed command at least one step late: the reason for the fit's lower bound on delays."""
    model = mujoco.MjModel.from_xml_path(str(robot_model_dir / "bench_pendulum.xml"))
    model.actuator_gainprm[0, 0], model.actuator_biasprm[0, 1] = 1.0, 0.0
    model.actuator_forcerange[0] = (-1e6, 1e6)
    for asked, acted in ((0.0, 0.0), (0.0005, 0.002), (0.002, 0.002), (0.0033, 0.0033)):
        model.actuator_delay[0] = asked
        data = mujoco.MjData(model)
        for _ in range(10):
            now = data.time
            data.ctrl[0] = now
            mujoco.mj_step(model, data)
        assert now - data.actuator_force[0] == pytest.approx(acted, abs=1e-9)

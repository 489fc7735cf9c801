"""How late a published model's sensors and servos are, measured against what is true in the simulation."""

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from scipy.interpolate import CubicSpline

from frasa_sysid import stored_robot_fit
from frasa_sysid.calibration import hold_history, load_calibration, load_model
from frasa_sysid.publish import publish, write

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
JOINT = "left_knee"
SERVOS = {JOINT: "mx106", "left_elbow": "mx64"}
STEPS = 600
# delay, sensor that is late, true one
LATE = [
    ("sensor.position_delay", f"{JOINT}.position", f"{JOINT}.true_position"),
    ("sensor.velocity_delay", f"{JOINT}.velocity", f"{JOINT}.true_velocity"),
    ("sensor.gyro_delay", "measured_gyro", "gyro"),
    ("sensor.orientation_delay", "measured_orientation", "orientation"),
]


@pytest.fixture(scope="module")
def robot(robot_model_dir, robot_record, tmp_path_factory):
    """A published model, with sensors of the truth and of the servo's force beside its own; and its ranges."""
    folder = tmp_path_factory.mktemp("published")
    nominal, out = robot_model_dir / "nominal.xml", folder / "calibrated.xml"
    robot_record().save(folder / "robot.json")
    write(publish([], nominal, out, stored_robot_fit.load(folder / "robot.json")), nominal, out)
    load_model(out)
    spec = mujoco.MjSpec.from_file(str(out))
    joint, actuator = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtObj.mjOBJ_ACTUATOR
    added = {
        "position": (mujoco.mjtSensor.mjSENS_JOINTPOS, joint),
        "velocity": (mujoco.mjtSensor.mjSENS_JOINTVEL, joint),
    }
    added["force"] = (mujoco.mjtSensor.mjSENS_ACTUATORFRC, actuator)
    for name in SERVOS:
        for what, (kind, owner) in added.items():
            spec.add_sensor(name=f"{name}.true_{what}", type=kind, objtype=owner, objname=name)
    return spec.compile(), load_calibration(out)


def commands(model, seed):
    """Smooth commands for all servos, shape (STEPS, nu), small enough for no force limit to be reached."""
    rng = np.random.default_rng(seed)
    t = np.arange(STEPS)[:, None] * model.opt.timestep
    return held(model) + 0.06 * np.sin(2 * np.pi * rng.uniform(0.7, 2.5, model.nu) * t + rng.uniform(0, 6, model.nu))


def held(model):
    """Commands well inside their ranges, shape (nu,)."""
    return model.actuator_ctrlrange.mean(axis=1)


def start(model, seed):
    """A robot in the air, tumbling slowly, that has always been where it is."""
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = data.ctrl[:] = held(model)
    data.qvel[3:6] = np.random.default_rng(seed).uniform(-1, 1, 3)
    hold_history(model, data)
    return data


def by_stepping(model, data, ctrl):
    """Every sensor at the beginning of each step, shape (STEPS, nsensordata)."""
    seen = []
    for one in ctrl:
        data.ctrl[:] = one
        mujoco.mj_step(model, data)
        seen.append(data.sensordata.copy())
    return np.array(seen)


def columns(model, seen, name):
    sensor = model.sensor(name)
    return seen[..., sensor.adr[0] : sensor.adr[0] + sensor.dim[0]]


def lag(times, late, true, at_first):
    """How late `late` is [s] after `true`, both (n, k), by least squares; before its begin `true` was as at first."""
    spline = CubicSpline(times, true)
    found = 0.02
    for _ in range(20):
        at = times - found
        value, slope = spline(at), spline(at, 1)
        usable = at > at_first
        found += float(((value - late) * slope)[usable].sum() / (slope**2)[usable].sum())
    return found


def check(model, calibration, seen, times, ctrl):
    """Every delay is the fitted one to a tenth of a step."""
    tenth = 0.1 * model.opt.timestep
    for name, late, true in LATE:
        wanted = calibration.ranges[name].value
        assert abs(wanted / model.opt.timestep - round(wanted / model.opt.timestep)) > 0.1
        found = lag(times, columns(model, seen, late), columns(model, seen, true), times[0])
        assert found == pytest.approx(wanted, abs=tenth), name
    for joint, servo in SERVOS.items():
        index = model.actuator(joint).id
        force = columns(model, seen, f"{joint}.true_force")
        assert np.abs(force).max() < 0.99 * model.actuator_forcerange[index, 1]
        goal = force / model.actuator_gainprm[index, 0] + columns(model, seen, f"{joint}.true_position")
        found = lag(times, goal, ctrl[:, [index]], times[0])
        assert found == pytest.approx(calibration.ranges[f"{servo}.delay"].value, abs=tenth), servo


def test_delays_in_a_loop_of_steps(robot):
    """Position, velocity, gyro, orientation and command are late by what was fitted, to a tenth of a step."""
    model, calibration = robot
    ctrl = commands(model, 0)
    seen = by_stepping(model, start(model, 0), ctrl)
    check(model, calibration, seen, np.arange(STEPS) * model.opt.timestep, ctrl)


def test_the_lag_is_measured_well_enough_to_fail(robot):
    """A delay that is half a step off is seen as such: the test above can fail."""
    model, calibration = robot
    step = model.opt.timestep
    before = model.sensor_delay.copy()
    try:
        model.sensor_delay[before > 0] += 0.5 * step
        ctrl = commands(model, 0)
        seen = by_stepping(model, start(model, 0), ctrl)
        for name, late, true in LATE:
            times = np.arange(STEPS) * step
            found = lag(times, columns(model, seen, late), columns(model, seen, true), 0.0)
            assert found == pytest.approx(calibration.ranges[name].value + 0.5 * step, abs=0.1 * step)
    finally:
        model.sensor_delay[:] = before


def test_delays_in_rollouts_on_threads(robot):
    """The same under mujoco.rollout, eight robots on two threads, from states that carry their histories."""
    model, calibration = robot
    ctrl = np.array([commands(model, seed) for seed in range(8)])
    states = np.zeros((8, mujoco.mj_stateSize(model, FULL)))
    for seed in range(8):
        mujoco.mj_getState(model, start(model, seed), states[seed], FULL)
    scratch = [mujoco.MjData(model) for _ in range(2)]
    for _ in range(2):  # the second time the scratch remembers other robots
        _, seen = rollout.rollout(model, scratch, states, ctrl)
        for seed in range(8):
            check(model, calibration, seen[seed], np.arange(STEPS) * model.opt.timestep, ctrl[seed])


def test_delays_across_resets(robot):
    """Episode after episode in one MjData: late by the same from the first step on, as if nothing had been before."""
    model, _ = robot
    data = mujoco.MjData(model)
    times = np.arange(STEPS) * model.opt.timestep
    for seed in range(3):
        ctrl = commands(model, seed)
        fresh = start(model, seed)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = fresh.qpos, fresh.qvel, fresh.ctrl
        hold_history(model, data)
        seen = by_stepping(model, data, ctrl)
        np.testing.assert_array_equal(seen, by_stepping(model, fresh, ctrl))
        for name, late, true in LATE:
            value, reading = columns(model, seen, true), columns(model, seen, late)
            wait = model.sensor_delay[model.sensor(late).id]
            began = times < wait
            np.testing.assert_allclose(reading[began], np.tile(value[0], (began.sum(), 1)), atol=1e-12, err_msg=name)
            at = times[~began] - wait
            np.testing.assert_allclose(reading[~began], CubicSpline(times, value)(at), atol=2e-3, err_msg=name)


def test_without_filling_the_first_readings_are_nothing(robot):
    """Why histories are filled: MuJoCo alone reads zeros and commands zero until the first delay has passed."""
    model, _ = robot
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not columns(model, data.sensordata, "measured_orientation").any()
    hold_history(model, data)
    np.testing.assert_array_equal(
        columns(model, data.sensordata, "measured_orientation"), columns(model, data.sensordata, "orientation")
    )


def test_the_present_holds_for_every_delay_of_a_range(robot):
    """Whatever delay is set after filling, and whenever: the first reading and command are the present ones."""
    model, calibration = robot
    data = start(model, 1)
    data.time = 7.3
    data.ctrl[:] += 0.2
    hold_history(model, data)
    before = model.sensor_delay.copy(), model.actuator_delay.copy()
    try:
        for share in np.linspace(0, 1, 9):
            for name, late, true in LATE:
                one = calibration.ranges[name]
                model.sensor_delay[model.sensor(late).id] = one.low + share * (one.high - one.low)
                mujoco.mj_forward(model, data)
                np.testing.assert_allclose(
                    columns(model, data.sensordata, late), columns(model, data.sensordata, true), atol=1e-15
                )
            one = calibration.ranges["mx106.delay"]
            index = model.actuator(JOINT).id
            model.actuator_delay[index] = one.low + share * (one.high - one.low)
            mujoco.mj_forward(model, data)
            assert data.actuator_force[index] == pytest.approx(model.actuator_gainprm[index, 0] * 0.2)
    finally:
        model.sensor_delay[:], model.actuator_delay[:] = before

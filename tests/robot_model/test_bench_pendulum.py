"""The bench pendulum against the pendulum's equations."""

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration.apply import actuators_of, dofs_of, read, servo_classes

MASS, LENGTH, GRAVITY = 0.5, 0.15, 9.81


def test_options_are_the_robots(nominal, calibrated, bench):
    """Every solver option is the same as on the robot that is published, so that what is fitted is what is simulated.

    The nominal robot differs in one: it takes damping as its source does.
    """
    names = [name for name in dir(nominal.opt) if not name.startswith("_")]
    compared = [name for name in names if not callable(getattr(nominal.opt, name))]
    assert len(compared) > 20
    for name in compared:
        robot, pendulum, before = (getattr(one.opt, name) for one in (calibrated, bench, nominal))
        np.testing.assert_array_equal(robot, pendulum, err_msg=name)
        if name == "disableflags":
            before |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        np.testing.assert_array_equal(before, pendulum, err_msg=name)


def test_friction_rows_are_the_robots(calibrated, bench):
    """Dry friction of every servo is as hard on the published robot as it is on the bench."""
    for servo in servo_classes(calibrated):
        for dof in dofs_of(calibrated, actuators_of(calibrated, servo)):
            np.testing.assert_array_equal(calibrated.dof_solref[dof], bench.dof_solref[0])
            np.testing.assert_array_equal(calibrated.dof_solimp[dof], bench.dof_solimp[0])


def test_servo_is_the_robots(nominal, bench):
    """Class mx106 lists the one actuator, and its numbers and delay buffer are the robot's."""
    assert servo_classes(bench) == ("mx106",)
    assert [bench.actuator(i).name for i in actuators_of(bench, "mx106")] == ["servo"]
    for field in ("kp", "forcerange", "damping", "frictionloss", "armature", "delay"):
        expected = read(nominal, f"mx106.{field}")
        if field == "armature":  # 0.0267 less 0.001 s * 1.7, which no double holds exactly
            assert read(bench, f"mx106.{field}") == pytest.approx(expected, rel=1e-15)
        else:
            assert read(bench, f"mx106.{field}") == expected
    np.testing.assert_array_equal(bench.actuator_history[0], nominal.actuator_history[0])
    assert bench.actuator_ctrllimited[0] == 0


@pytest.mark.parametrize("angle", [-2.5, -0.7, 0.0, 0.3, np.pi / 2, 3.0])
def test_gravity_torque(bench, angle):
    """Gravity's torque at rest is -m g l sin(q)."""
    data = mujoco.MjData(bench)
    data.qpos[0] = angle
    mujoco.mj_forward(bench, data)
    assert -data.qfrc_bias[0] == pytest.approx(-MASS * GRAVITY * LENGTH * np.sin(angle), abs=1e-9)


def test_positive_angle_is_counter_clockwise(bench):
    """Seen along +y, with x to the right and z up, a positive angle moves the weight to the right."""
    data = mujoco.MjData(bench)
    data.qpos[0] = 0.1
    mujoco.mj_forward(bench, data)
    assert data.body("pendulum").xipos[0] == pytest.approx(LENGTH * np.sin(0.1))
    assert data.body("pendulum").xipos[1] == 0


def test_small_swing_period(bench):
    """Without servo it swings with the period of a pendulum with the rotor's inertia, and touches nothing."""
    bench.dof_damping[:] = bench.dof_frictionloss[:] = 0
    bench.actuator_gainprm[:] = bench.actuator_biasprm[:] = 0
    armature = bench.dof_armature[0]
    data = mujoco.MjData(bench)
    data.qpos[0] = 0.02
    crossings, before = [], data.qpos[0]
    for _ in range(2500):
        mujoco.mj_step(bench, data)
        now = data.qpos[0]
        if before < 0 <= now:
            crossings.append(data.time - bench.opt.timestep * now / (now - before))
        before = now
    assert data.ncon == 0
    period = 2 * np.pi * np.sqrt((MASS * LENGTH**2 + 1e-9 + armature) / (MASS * GRAVITY * LENGTH))
    assert np.diff(crossings).mean() == pytest.approx(period, rel=1e-3)


def test_servo_holds_the_weight_with_the_expected_error(bench):
    """Holding the arm level, kp times the error lies within the friction of the weight's torque."""
    data = mujoco.MjData(bench)
    data.ctrl[0] = np.pi / 2
    mujoco.mj_step(bench, data, 5000)
    torque = bench.actuator_gainprm[0, 0] * (data.ctrl[0] - data.qpos[0])
    needed = MASS * GRAVITY * LENGTH * np.sin(data.qpos[0])
    assert abs(torque - needed) <= bench.dof_frictionloss[0] + 1e-3

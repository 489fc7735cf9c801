from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.robot_body import build, joints_of, tilt_quaternion
from frasa_sysid.robot_physics import IDLE_CURRENT, servos_of, simulate
from frasa_sysid.robot_truth import Scales, draw, scaled
from frasa_sysid.servo import PUBLISHED_M4


@pytest.fixture(scope="module")
def path(robot_model_dir):
    return robot_model_dir / "nominal.xml"


@pytest.fixture(scope="module")
def joints(path):
    return joints_of(path)


def some_goals(joints, end, start=-0.5):
    """Stamps and goals of all joints moving at once, then a jump to rest."""
    written = np.arange(start, end, 0.01)
    rates = np.random.default_rng(0).uniform(0.4, 1.4, len(joints.names))
    goals = joints.neutral + 0.25 * np.sin(2 * np.pi * rates * (written[:, None] - start))
    return written, np.where(written[:, None] > 0.8 * end, joints.neutral, goals)


def run(path, joints, truth, end, timestep, contacts=True):
    body = build(path, truth, joints, timestep)
    if not contacts:
        body.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return simulate(body, joints, truth, *some_goals(joints, end), end, quantized=False)


def test_classes_are_each_joints_own(joints):
    """Arms, head and hip yaws have MX-64, the rest of the legs MX-106."""
    small = {name for name, servo in zip(joints.names, joints.servos, strict=True) if servo == "mx64"}
    assert small == {
        name for name in joints.names if not any(one in name for one in ("roll", "hip_p", "kn", "ank"))
    } | {
        "left_shoulder_roll",
        "right_shoulder_roll",
    }


def test_scales_reach_the_mechanics(joints):
    """Torque per volt, back-EMF plus viscous friction, and dry friction are each multiplied by their scale."""
    old = PUBLISHED_M4["mx106"]
    new = scaled(old, Scales(1.1, 0.9, 1.2))
    assert new.kp() / old.kp() == pytest.approx(1.1)
    assert new.force_limit() / old.force_limit() == pytest.approx(1.1)
    assert new.damping() / old.damping() == pytest.approx(0.9)
    assert new.friction.viscous / old.friction.viscous == pytest.approx(0.9)
    torque = np.array([1.0]), np.array([-2.0]), np.array([0.0])
    assert new.friction.bound(*torque) / old.friction.bound(*torque) == pytest.approx(1.2)


def box_friction(reach, free, bound, force):
    """Projected Gauss-Seidel: dry friction [N m] that stops what it can, shape (n,)."""
    for _ in range(300):
        largest = 0.0
        for i in range(free.size):
            new = np.clip(force[i] - (free[i] + reach[i] @ force) / reach[i, i], -bound[i], bound[i])
            largest = max(largest, abs(new - force[i]))
            force[i] = new
        if largest < 1e-10:
            break
    return force


def written_out(path, joints, truth, end, h):
    """The held robot's angles by a program of its own: mass matrix, and friction as a box problem."""
    body, servos = build(path, truth, joints, h), servos_of(truth, joints)
    model, n = body.model, len(joints.names)
    data, mass, bias, force = mujoco.MjData(model), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    written, goals = some_goals(joints, end)
    data.qpos[:] = goals[0] - servos.zero
    damping, volts, duty, angles = servos.viscous + servos.kt**2 / servos.R, truth.open_voltage, None, []
    for k in range(int(np.ceil((end - written[0]) / h))):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fullM(model, data, mass)
        mujoco.mj_fwdVelocity(model, data)
        bias[:] = data.qfrc_bias
        q, v = data.qpos.copy(), data.qvel.copy()
        if k % round(0.001 / h) == 0:
            last = np.searchsorted(written + truth.command_delay, written[0] + k * h + 1e-9, side="right") - 1
            error = goals[max(last, 0)] - q - servos.zero
            duty = np.clip(servos.error_gain * error, -servos.max_duty, servos.max_duty)
        driven = servos.kt / servos.R * volts * duty
        motor = driven - servos.kt**2 / servos.R * v
        reach = np.linalg.inv(mass + np.diag(h / 2 * damping))
        free = v + h * reach @ (driven - bias - damping * v)
        force = box_friction(h * reach, free, servos.dry_bound(motor, -bias, v), force)
        data.qvel[:] = free + h * reach @ force
        angles.append(q)
        data.qpos[:] = q + h * data.qvel
        volts = truth.open_voltage - truth.resistance * max(duty @ (motor / servos.kt) + IDLE_CURRENT, 0.0)
    return np.array(angles)


def test_equals_a_program_written_out(path, joints):
    """Sticking, slipping and sag of all joints at once are what mass matrix and box friction give."""
    truth = draw("fixed", 3, joints.classes, joints.names)
    made = run(path, joints, truth, 0.5, 0.001, contacts=False).angle
    expected = written_out(path, joints, truth, 0.5, 0.001)
    assert np.ptp(expected, axis=0).min() > 0.1
    np.testing.assert_allclose(made, expected, rtol=0, atol=1e-4)


def test_a_finer_step_changes_little(path, joints):
    """Half the step: all joints within a third of a milliradian, most of the time far closer."""
    truth = draw("fixed", 4, joints.classes, joints.names)
    coarse, fine = (run(path, joints, truth, 1.5, h, contacts=False).angle for h in (0.00025, 0.000125))
    difference = np.abs(fine[::2][: len(coarse)] - coarse)
    assert difference.max() < 1e-3
    assert np.sqrt((difference**2).mean()) < 1e-4


def test_friction_holds_still(path, joints):
    """After the last jump joints come to rest and do not creep."""
    truth = draw("fixed", 5, joints.classes, joints.names)
    traces = run(path, joints, truth, 4.0, 0.0005, contacts=False)
    late = traces.t > 3.8
    assert np.ptp(traces.angle[late], axis=0).max() < 5e-5


def test_command_delay_shifts_the_motion(path, joints):
    """Seven milliseconds more of command delay move the whole motion by seven milliseconds."""
    truth = replace(draw("fixed", 6, joints.classes, joints.names), command_delay=0.004, resistance=0.0)
    written, goals = some_goals(joints, 1.0)
    # At rest first, so that the start is the same for both.
    written = np.concatenate([written[0] - np.arange(200, 0, -1) * 0.01, written])
    goals = np.concatenate([np.repeat(goals[:1], 200, axis=0), goals])
    both = []
    for one in (truth, replace(truth, command_delay=0.011)):
        body = build(path, one, joints, 0.0005)
        body.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        both.append(simulate(body, joints, one, written, goals, 1.0, quantized=False).angle)
    early, late = both
    moved = slice(4000, None)
    assert np.abs(late[14:][moved] - early[:-14][moved]).max() < 2e-5
    assert np.abs(late[moved] - early[moved]).max() > 1e-2


def test_the_held_trunk_is_tilted(path, joints):
    """Gravity in the trunk's frame follows roll and pitch as drawn."""
    truth = draw("fixed", 7, joints.classes, joints.names)
    traces = run(path, joints, truth, 0.1, 0.0005)
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), traces.orientation[0] * [1, -1, -1, -1])
    assert np.arctan2(up[1], up[2]) == pytest.approx(truth.roll, abs=1e-6)
    assert -np.arcsin(up[0]) == pytest.approx(truth.pitch, abs=1e-6)
    assert tilt_quaternion(truth.roll, truth.pitch) == pytest.approx(traces.orientation[0])


def test_trunk_is_the_drawn_one(path, joints):
    """Mass and centre of mass of the trunk differ from the model's by what was drawn, the rest is the model's."""
    truth = draw("floating", 8, joints.classes, joints.names)
    body, nominal = build(path, truth, joints, 0.0005), mujoco.MjModel.from_xml_path(str(path))
    trunk = nominal.body("trunk")
    assert body.trunk_mass == pytest.approx(truth.trunk_mass * trunk.mass[0])
    np.testing.assert_allclose(body.trunk_com, trunk.ipos + np.array(truth.trunk_com))
    np.testing.assert_allclose(body.model.body_mass[2:], nominal.body_mass[2:])
    assert body.model.nu == 0
    assert not body.model.sensor_delay.any()

"""Every episode has its own robot, drawn from the ranges, and nothing accumulates."""

import mujoco
import numpy as np
import pytest

from frasa_rl.config import AssumedRanges
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import CalibrationError, actuators_of, dofs_of, load_model, read

RANGES = AssumedRanges()


def numbers_of(model):
    """Every array of floating-point numbers in a model."""
    names = [name for name in dir(model) if not name.startswith("_")]
    arrays = {name: getattr(model, name) for name in names if isinstance(getattr(model, name), np.ndarray)}
    return {name: array.copy() for name, array in arrays.items() if array.dtype.kind == "f"}


def draws(env, count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield env.randomizer.draw(rng)


def test_nothing_accumulates(env, nominal):
    """After many episodes the original can be restored to the last bit."""
    for _ in draws(env, 200):
        pass
    env.randomizer.restore()
    fresh = load_model(nominal)
    mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
    for name, array in numbers_of(fresh).items():
        np.testing.assert_array_equal(getattr(env.model, name), array, err_msg=name)


def test_assumed_ranges_are_reached_and_kept(env):
    """Draws fill their ranges: none outside, some near both ends."""
    drawn = list(draws(env, 400))
    for name in ("floor_friction", "trunk_mass", "supply_voltage", "damping", "frictionloss"):
        wanted, values = getattr(RANGES, name), np.array([one[name] for one in drawn])
        width = wanted.high - wanted.low
        assert wanted.low <= values.min() < wanted.low + 0.05 * width, name
        assert wanted.high - 0.05 * width < values.max() <= wanted.high, name


def test_a_heavier_trunk_is_harder_to_turn(env, nominal):
    """The trunk's inertia scales with its mass (upstream bug B6), and its centre of mass moves at most 5 mm."""
    original, trunk = load_model(nominal), env.robot.trunk
    for drawn in draws(env, 20):
        ratio = drawn["trunk_mass"]
        np.testing.assert_allclose(env.model.body_mass[trunk], ratio * original.body_mass[trunk])
        np.testing.assert_allclose(env.model.body_inertia[trunk], ratio * original.body_inertia[trunk])
        assert np.abs(env.model.body_ipos[trunk] - original.body_ipos[trunk]).max() <= 0.005


def test_derived_constants_follow(env):
    """What MuJoCo derives from masses and frames is that of the drawn robot (upstream bug B6)."""
    list(draws(env, 1))
    derived = env.model.dof_invweight0.copy()
    mujoco.mj_setConst(env.model, mujoco.MjData(env.model))
    np.testing.assert_array_equal(env.model.dof_invweight0, derived)


def test_voltage_scales_gain_and_torque_limit_but_not_damping(env, nominal):
    """kp and torque limit of all servos scale by voltage over the model's supply voltage."""
    original = load_model(nominal)
    drawn = next(draws(env, 1))
    ratio = drawn["supply_voltage"] / 15.0
    np.testing.assert_allclose(env.model.actuator_gainprm[:, 0], ratio * original.actuator_gainprm[:, 0])
    np.testing.assert_allclose(env.model.actuator_biasprm[:, 1], -env.model.actuator_gainprm[:, 0])
    np.testing.assert_allclose(env.model.actuator_forcerange, ratio * original.actuator_forcerange)
    np.testing.assert_allclose(env.model.dof_damping, drawn["damping"] * original.dof_damping)


def test_joint_zeros_differ_on_all_20_joints(env, nominal):
    """Every joint has its own zero error of at most 1.5 deg: the robot stands as the nominal one at other angles."""
    original = load_model(nominal)
    list(draws(env, 1))
    joints = original.actuator_trnid[:, 0]
    zeros = np.array([read(env.model, f"{original.joint(joint).name}.zero") for joint in joints])
    assert np.degrees(np.abs(zeros).max()) <= 1.5
    assert len(set(np.round(zeros, 9))) == 20
    here, there = mujoco.MjData(env.model), mujoco.MjData(original)
    here.qpos[:3] = there.qpos[:3]
    here.qpos[original.jnt_qposadr[joints]] = 0.3
    there.qpos[original.jnt_qposadr[joints]] = 0.3 - zeros
    mujoco.mj_kinematics(env.model, here)
    mujoco.mj_kinematics(original, there)
    np.testing.assert_allclose(here.geom_xpos, there.geom_xpos, atol=1e-12)
    assert np.abs(there.geom_xpos - mujoco.MjData(original).geom_xpos).max() > 0.01


def test_measured_ranges_replace_assumed_ones(calibrated):
    """A calibrated servo's damping and friction loss come from its measured range; the other class keeps the ratio."""
    env = StandUp(calibrated)
    assert env.calibration_id == "c0ffee"
    original = load_model(calibrated)
    other = dofs_of(original, actuators_of(original, "mx64"))
    values = {name: [] for name in ("mx106.damping", "mx106.frictionloss", "mx106.delay", "sensor.gyro_delay")}
    for drawn in draws(env, 50):
        for name, seen in values.items():
            seen.append(read(env.model, name))
            assert seen[-1] == pytest.approx(drawn[name])
        np.testing.assert_allclose(env.model.dof_damping[other], drawn["damping"] * original.dof_damping[other])
        assert read(env.model, "mx106.kp") == pytest.approx(drawn["mx106.kp"] * drawn["supply_voltage"] / 15.0)
    assert min(values["mx106.damping"]) >= 1.60
    assert max(values["mx106.damping"]) <= 1.70
    assert np.ptp(values["sensor.gyro_delay"]) > 0.005


def test_ranges_of_another_calibration_are_refused(calibrated):
    """A model and ranges with different ids are never used together."""
    file = calibrated.with_name("randomization.yaml")
    file.write_text(file.read_text().replace("c0ffee", "decaf"))
    with pytest.raises(CalibrationError, match="decaf"):
        StandUp(calibrated)

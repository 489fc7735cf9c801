"""Zero errors of joints and the trunk's mass, in a compiled model."""

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import CalibrationError, ModelError, Range, apply, load_model, parameter, read, trunk_of
from frasa_sysid.calibration.ranges import Calibration

FOOT = "left_ankle_roll"


@pytest.fixture
def model(robot_model_dir):
    return load_model(robot_model_dir / "nominal.xml")


def pose(model, qpos):
    """Places and orientations of all geoms."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return np.concatenate([data.geom_xpos.ravel(), data.geom_xmat.ravel()])


def test_the_measured_angle_less_the_zero_is_the_true_one(model, robot_model_dir):
    """Every geom of a robot with zeros, at measured angles q, is where the nominal one's is at q less the zeros."""
    nominal, rng = load_model(robot_model_dir / "nominal.xml"), np.random.default_rng(0)
    joints = [model.joint(i).name for i in range(1, model.njnt)]
    zeros = rng.uniform(-0.1, 0.1, len(joints))
    apply(model, {f"{joint}.zero": zero for joint, zero in zip(joints, zeros, strict=True)})
    for _ in range(20):
        q = mujoco.MjData(nominal).qpos.copy()
        q[7:] = rng.uniform(-1.5, 1.5, len(joints))
        true = q.copy()
        true[7:] -= zeros
        np.testing.assert_allclose(pose(model, q), pose(nominal, true), atol=1e-12)
        assert np.abs(pose(model, q) - pose(nominal, q)).max() > 0.01


def test_sensor_and_servo_know_the_measured_angle_only(model):
    """The joint's sensor reads it, and a servo told to hold it makes no torque, wherever the true angle is."""
    apply(model, {"left_knee.zero": 0.05})
    data = mujoco.MjData(model)
    knee = model.joint("left_knee").qposadr[0]
    data.qpos[knee] = data.ctrl[model.actuator("left_knee").id] = 0.4
    mujoco.mj_forward(model, data)
    assert data.sensor("left_knee.position").data[0] == 0.4
    assert data.actuator("left_knee").force[0] == 0.0


def test_setting_it_again_adds_nothing(model):
    """Zeros and trunk are what was last set, read back to the last bit; setting the old ones restores the model."""
    before = {name: getattr(model, name).copy() for name in ("qpos0", "body_ipos", "body_mass", "dof_invweight0")}
    rng = np.random.default_rng(1)
    for _ in range(300):
        drawn = {"left_knee.zero": rng.uniform(-0.1, 0.1), "trunk.mass": rng.uniform(2, 4), "trunk.com_y": rng.normal()}
        apply(model, drawn)
        assert {name: read(model, name) for name in drawn} == drawn
    fresh = {"left_knee.zero": 0.0, "trunk.mass": before["body_mass"][1], "trunk.com_y": before["body_ipos"][1, 1]}
    apply(model, fresh)
    for name, value in before.items():
        np.testing.assert_allclose(getattr(model, name), value, rtol=1e-12)


def test_inertia_is_proportional_to_mass(model, robot_model_dir):
    """A trunk of twice the mass is twice as hard to turn, and what MuJoCo derives from it follows."""
    nominal = load_model(robot_model_dir / "nominal.xml")
    apply(model, {"trunk.mass": 2 * read(nominal, "trunk.mass")})
    np.testing.assert_allclose(model.body("trunk").inertia, 2 * nominal.body("trunk").inertia)
    assert model.body_subtreemass[1] == pytest.approx(nominal.body_subtreemass[1] + nominal.body_mass[1])


def test_a_centre_of_mass_that_was_compiled_into_the_origin_moves():
    """MuJoCo passes over `body_ipos` of a body whose centre of mass was at its frame's origin."""
    text = """<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>
      <body name="arm"><joint name="j"/><geom size="0.1" pos="0 0 1"/></body></body></worldbody>
      <actuator><position name="j" joint="j"/></actuator>
      <custom><tuple name="s"><element objtype="actuator" objname="j"/></tuple></custom></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    apply(model, {"trunk.com_x": 0.02})
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.xipos[model.body("base").id, 0] == pytest.approx(0.02)


def test_the_trunk_carries_the_servos(model, robot_model_dir):
    """The body with the free joint, whatever its name, or the root of a fixed base; two robots have two."""
    assert model.body(trunk_of(model)).name == "trunk"
    bench = load_model(robot_model_dir / "bench_pendulum.xml")
    assert bench.body_parentid[trunk_of(bench)] == 0
    with pytest.raises(ModelError, match="carries all servos"):
        trunk_of(mujoco.MjModel.from_xml_string("<mujoco/>"))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("left_knee.zero", float("nan")),
        ("left_knee.zero", 2.0),
        ("tail.zero", 0.1),
        ("root.zero", 0.1),
        ("trunk.mass", 0.0),
        ("trunk.mass", float("inf")),
        ("trunk.com_x", float("nan")),
    ],
)
def test_what_no_robot_has(model, name, value):
    """Joints that are no hinges, zeros beyond a radian and masses that are none are refused."""
    with pytest.raises(ModelError):
        apply(model, {name: value})


def test_names_and_signs():
    """Joints may have dots in their names; only zeros and places may be negative."""
    assert (parameter("arm.left.zero").owner, parameter("arm.left.zero").unit) == ("arm.left", "rad")
    assert [parameter(f"trunk.{one}").unit for one in ("mass", "com_z")] == ["kg", "m"]
    for name in ("sensor.zero", "trunk.zero", ".zero", "zero", "trunk.kp"):
        with pytest.raises(CalibrationError):
            parameter(name)
    Calibration("0", {"left_knee.zero": Range(-0.1, -0.05, 0.0, "rad", "here")})
    with pytest.raises(CalibrationError, match="cannot be negative"):
        Calibration("0", {"trunk.mass": Range(-0.1, 0.0, 0.1, "kg", "here")})

"""Every episode has its own robot, drawn from the ranges, and nothing accumulates."""

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from frasa_rl.config import Assumed, AssumedRanges, ServoSpread, Task
from frasa_rl.randomize import Randomizer
from frasa_rl.robot import find_robot
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import CalibrationError, ModelError, actuators_of, dofs_of, load_calibration, read

RANGES = AssumedRanges()


def made(path, task=None):
    """A model of its own, its randomizer, and an untouched model to compare with."""
    task = task or Task()
    model, original = build_model(path, task), build_model(path, task)
    return model, Randomizer(model, find_robot(model, task), task, load_calibration(path)), original


def assuming(**ranges):
    return replace(Task(), assumed=replace(RANGES, **ranges))


def bytes_of(model):
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def draws(randomizer, count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield randomizer.draw(rng)


@pytest.mark.parametrize("name", ["nominal.xml", "calibrated.xml"])
def test_nothing_accumulates_over_1000_resets(robot_model_dir, name):
    """A seeded robot is the same to the last bit of its model before and after 1,000 others, and so is the original."""
    path = robot_model_dir / name
    model = build_model(path, Task())
    maker = StartMaker(model, Task(), load_calibration(path), threads=1)
    maker.randomizer.restore()
    untouched = bytes_of(model)
    first, _ = maker.draw_robot(np.random.default_rng(7))
    rng = np.random.default_rng(0)
    for _ in range(1000):
        maker.draw_robot(rng)
    again, _ = maker.draw_robot(np.random.default_rng(7))
    assert bytes_of(again) == bytes_of(first) != untouched
    maker.randomizer.restore()
    assert bytes_of(model) == untouched


def test_assumed_ranges_are_reached_and_kept(nominal):
    """Draws fill their ranges to their ends, as told and in the model; what is null stays as it is."""
    delays = {
        "command_delay": Assumed(0.002, 0.011, "s", "a test"),
        "position_delay": Assumed(0.0, 0.004, "s", "a test"),
        "velocity_delay": Assumed(0.02, 0.04, "s", "a test"),
        "gyro_delay": Assumed(0.03, 0.06, "s", "a test"),
        "orientation_delay": Assumed(0.04, 0.08, "s", "a test"),
    }
    ranges = replace(RANGES, **delays)
    model, randomizer, original = made(nominal, replace(Task(), assumed=ranges))
    trunk, knee = model.body("trunk").id, model.joint("left_knee").dofadr[0]
    sensors = {name: model.sensor(f"left_knee.{name}").id for name in ("position", "velocity")}
    sensors |= {name: model.sensor(f"measured_{name}").id for name in ("gyro", "orientation")}
    seen = {one.name: [] for one in fields(AssumedRanges) if getattr(ranges, one.name) is not None}
    for drawn in draws(randomizer, 1500):
        mass = model.body_mass[trunk] / original.body_mass[trunk]
        inertia = model.body_inertia[trunk] / original.body_inertia[trunk]
        np.testing.assert_allclose(inertia, mass)  # upstream bug B6: mass without inertia
        assert model.dof_damping[knee] / original.dof_damping[knee] == pytest.approx(drawn["damping"])
        assert drawn["trunk_mass"] == pytest.approx(mass)
        in_model = {
            "floor_friction": model.geom("floor").friction[0],
            "trunk_mass": mass,
            "trunk_com": model.body_ipos[trunk, 1] - original.body_ipos[trunk, 1],
            "supply_voltage": 15.0 * model.actuator_forcerange[3, 1] / original.actuator_forcerange[3, 1],
            "joint_zero": read(model, "left_knee.zero"),
            "damping": model.dof_damping[knee] / original.dof_damping[knee],
            "frictionloss": model.dof_frictionloss[knee] / original.dof_frictionloss[knee],
            "command_delay": model.actuator_delay[model.actuator("left_knee").id],
        }
        in_model |= {f"{name}_delay": model.sensor_delay[index] for name, index in sensors.items()}
        for name, values in seen.items():
            values.append(in_model[name])
    for name, values in seen.items():
        wanted = getattr(ranges, name)
        near = 0.01 * (wanted.high - wanted.low)
        assert wanted.low - 1e-12 <= min(values) < wanted.low + near, name
        assert wanted.high - near < max(values) <= wanted.high + 1e-12, name


def test_nothing_assumed_is_nothing_changed(nominal):
    """With all assumed ranges null a nominal model stays as its file says, to the last bit."""
    model, randomizer, _ = made(nominal, assuming(**{one.name: None for one in fields(AssumedRanges)}))
    randomizer.restore()
    before = bytes_of(model)
    assert next(draws(randomizer, 1)) == {"trunk_mass": 1.0}
    assert bytes_of(model) == before


def test_derived_constants_follow(nominal):
    """What MuJoCo derives from masses and frames is that of the drawn robot (upstream bug B6)."""
    model, randomizer, original = made(nominal)
    list(draws(randomizer, 1))
    before = bytes_of(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    assert bytes_of(model) == before
    assert not np.allclose(model.dof_invweight0, original.dof_invweight0, rtol=1e-6)
    assert model.body_subtreemass[1] == pytest.approx(model.body_mass.sum())


def test_voltage_scales_gain_and_torque_limit_but_not_damping(nominal):
    """kp and torque limit of all servos scale by voltage over the model's supply voltage."""
    model, randomizer, original = made(nominal)
    drawn = next(draws(randomizer, 1))
    ratio = drawn["supply_voltage"] / 15.0
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], ratio * original.actuator_gainprm[:, 0])
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], -model.actuator_gainprm[:, 0])
    np.testing.assert_allclose(model.actuator_forcerange, ratio * original.actuator_forcerange)
    np.testing.assert_allclose(model.dof_damping, drawn["damping"] * original.dof_damping)


@pytest.mark.parametrize(("per", "count"), [("robot", 1), ("class", 2), ("joint", 20)])
@pytest.mark.parametrize("field", ["damping", "frictionloss"])
def test_a_spread_is_per_robot_class_or_joint(nominal, per, count, field):
    """So many different ratios there are, equal within what they are for, and each is told."""
    spread = ServoSpread(0.5, 2.0, "ratio", "a test", per)
    model, randomizer, original = made(nominal, assuming(**{field: spread}))
    drawn = next(draws(randomizer, 1))
    name = f"dof_{field}"
    servos = dofs_of(model, np.arange(model.nu))
    ratios = getattr(model, name)[servos] / getattr(original, name)[servos]
    assert len(set(np.round(ratios, 9))) == count
    told = {one for key, one in drawn.items() if key.split(".")[0] == field}
    assert set(np.round(list(told), 9)) == set(np.round(ratios, 9))
    if per == "class":
        assert len(set(np.round(ratios[actuators_of(model, "mx64")], 9))) == 1


def test_joints_may_differ_on_top_of_a_measured_class(calibrated):
    """A ratio of each joint multiplies what its class has, measured or not."""
    own = Assumed(0.9, 1.1, "ratio", "a test")
    model, randomizer, original = made(calibrated, assuming(joint_damping=own, joint_frictionloss=own))
    for drawn in draws(randomizer, 5):
        for actuator in actuators_of(model, "mx106"):
            dof = dofs_of(model, np.array([actuator]))[0]
            name = model.joint(model.actuator_trnid[actuator, 0]).name
            for field in ("damping", "frictionloss"):
                wanted = drawn[f"mx106.{field}"] * drawn[f"joint_{field}.{name}"]
                assert getattr(model, f"dof_{field}")[dof] == pytest.approx(wanted)
        other = dofs_of(model, actuators_of(model, "mx64"))
        ratios = model.dof_damping[other] / original.dof_damping[other] / drawn["damping"]
        assert ratios.min() >= 0.9
        assert ratios.max() <= 1.1
        assert np.ptp(ratios) > 0.02


def test_friction_of_a_law_cannot_differ_by_joint(robot_model_dir):
    """A friction law belongs to a class: asking for more is an error that says what to do."""
    path = robot_model_dir / "calibrated.xml"
    own = Assumed(0.9, 1.1, "ratio", "a test")
    with pytest.raises(ModelError, match=r"mx64, mx106 has a friction law.*coulomb_viscous"):
        made(path, assuming(joint_frictionloss=own))
    task = assuming(joint_frictionloss=own)
    model, randomizer, _ = made(path, replace(task, physics=replace(task.physics, friction_law="coulomb_viscous")))
    list(draws(randomizer, 1))
    assert len(set(model.dof_frictionloss[dofs_of(model, actuators_of(model, "mx64"))])) > 2


def test_delays_need_room(nominal):
    """A range that a history buffer cannot hold is an error that names the buffer and what it needs."""
    with pytest.raises(ModelError, match=r'command_delay reaches 40 ms.* holds 32 ms: give it nsample="2[12]"'):
        made(nominal, assuming(command_delay=Assumed(0.0, 0.04, "s", "a test")))
    task = assuming(gyro_delay=Assumed(0.0, 0.01, "s", "a test"))
    with pytest.raises(ModelError, match=r"gyro_delay has a range, but names.gyro is null"):
        made(nominal, replace(task, names=replace(task.names, gyro=None)))


def test_measured_delays_replace_assumed_ones(calibrated):
    """One class' command delay and the gyro's are measured, the other class takes the assumed one."""
    ranges = {name: Assumed(0.001, 0.002, "s", "a test") for name in ("command_delay", "gyro_delay")}
    model, randomizer, _ = made(calibrated, assuming(**ranges))
    for drawn in draws(randomizer, 10):
        assert read(model, "mx64.delay") == drawn["command_delay"] <= 0.002
        assert read(model, "mx106.delay") == drawn["mx106.delay"] >= 0.004
        assert read(model, "sensor.gyro_delay") == drawn["sensor.gyro_delay"] >= 0.020


def test_joint_zeros_differ_on_all_20_joints(nominal):
    """Every joint has its own zero error of at most 1.5 deg: the robot stands as the nominal one at other angles."""
    model, randomizer, original = made(nominal)
    list(draws(randomizer, 1))
    joints = original.actuator_trnid[:, 0]
    zeros = np.array([read(model, f"{original.joint(joint).name}.zero") for joint in joints])
    assert np.degrees(np.abs(zeros).max()) <= 1.5
    assert len(set(np.round(zeros, 9))) == 20
    here, there = mujoco.MjData(model), mujoco.MjData(original)
    here.qpos[:3] = there.qpos[:3]
    here.qpos[original.jnt_qposadr[joints]] = 0.3
    there.qpos[original.jnt_qposadr[joints]] = 0.3 - zeros
    mujoco.mj_kinematics(model, here)
    mujoco.mj_kinematics(original, there)
    np.testing.assert_allclose(here.geom_xpos, there.geom_xpos, atol=1e-12)
    assert np.abs(there.geom_xpos - mujoco.MjData(original).geom_xpos).max() > 0.01


def test_measured_ranges_replace_assumed_ones(calibrated):
    """A calibrated servo's damping and friction loss come from its measured range; the other class keeps the ratio."""
    model, randomizer, original = made(calibrated)
    other = dofs_of(original, actuators_of(original, "mx64"))
    values = {name: [] for name in ("mx106.damping", "mx106.frictionloss", "mx106.delay", "sensor.gyro_delay")}
    for drawn in draws(randomizer, 50):
        for name, seen in values.items():
            seen.append(read(model, name))
            assert seen[-1] == pytest.approx(drawn[name])
        np.testing.assert_allclose(model.dof_damping[other], drawn["damping"] * original.dof_damping[other])
        assert read(model, "mx106.kp") == pytest.approx(drawn["mx106.kp"] * drawn["supply_voltage"] / 15.0)
    assert min(values["mx106.damping"]) >= 1.60
    assert max(values["mx106.damping"]) <= 1.70
    assert np.ptp(values["sensor.gyro_delay"]) > 0.005


def test_ranges_of_another_calibration_are_refused(calibrated):
    """A model and ranges with different ids are never used together."""
    file = calibrated.with_name("randomization.yaml")
    file.write_text(file.read_text().replace("c0ffee", "decaf"))
    with pytest.raises(CalibrationError, match="decaf"):
        made(calibrated)


def test_the_floor_wins_over_any_foot(nominal):
    """The drawn friction holds even against a geom of high priority."""
    task = Task()
    model = build_model(nominal, task)
    model.geom_priority[5] = 3
    Randomizer(model, find_robot(model, task), task, None).draw(np.random.default_rng(0))
    assert model.geom("floor").priority[0] == 4

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import (
    LAW_FIELDS,
    SENSOR_FIELDS,
    SERVO_FIELDS,
    CalibrationError,
    ModelError,
    actuators_of,
    apply,
    calibration_id,
    dofs_of,
    load_model,
    number,
    parameter,
    read,
    servo_classes,
    servo_law,
)
from frasa_sysid.calibration.friction import Friction

VALUES = {"kp": 17.5, "forcerange": 3.25, "damping": 0.77, "frictionloss": 0.011, "armature": 0.0123, "delay": 0.0091}


@pytest.fixture
def model(robot_model_dir):
    """The nominal robot, fresh for each test."""
    return load_model(robot_model_dir / "nominal.xml")


M5 = Friction(0.1, 0.05, 0.02, 0.06, 0.03, 0.1, 0.2, stribeck_speed=0.4, stribeck_exponent=1.2)


@pytest.fixture
def with_law(robot_model_dir):
    """The nominal robot with places for a law of the mx106 and for its present supply."""
    spec = mujoco.MjSpec.from_file(str(robot_model_dir / "nominal.xml"))
    spec.add_numeric(name="mx106_friction", data=[0, 0.1, 0, 0, 0, 0, 0, 0, 0, 1, 1], size=11)
    spec.add_numeric(name="present_supply_voltage", data=[15.0], size=1)
    model = spec.compile()
    servo_law.set_law(model, "mx106", M5)
    return model


@pytest.mark.parametrize("servo", ["mx64", "mx106"])
@pytest.mark.parametrize("field", SERVO_FIELDS)
def test_a_servo_number_round_trips(model, servo, field):
    """What is applied is read back, for every actuator of its class and for no other."""
    name = f"{servo}.{field}"
    others = {f"{one}.{other}" for one in servo_classes(model) for other in SERVO_FIELDS} - {name}
    before = {other: read(model, other) for other in others}
    apply(model, {name: VALUES[field]})
    assert read(model, name) == VALUES[field]
    assert {other: read(model, other) for other in others} == before


def test_applied_to_every_joint_of_the_class(model):
    """Gain, its feedback and the symmetric limit reach all actuators; damping, friction and armature all joints."""
    apply(model, {f"mx64.{field}": value for field, value in VALUES.items()})
    mine = actuators_of(model, "mx64")
    dofs = dofs_of(model, mine)
    assert mine.size > 1
    np.testing.assert_array_equal(model.actuator_gainprm[mine, 0], 17.5)
    np.testing.assert_array_equal(model.actuator_biasprm[mine, 1], -17.5)
    np.testing.assert_array_equal(model.actuator_forcerange[mine], [[-3.25, 3.25]] * mine.size)
    np.testing.assert_array_equal(model.dof_damping[dofs], 0.77)
    np.testing.assert_array_equal(model.dof_armature[dofs], 0.0123)
    assert not set(mine) & set(actuators_of(model, "mx106"))
    assert np.isin(np.arange(6), dofs).sum() == 0


def test_applying_refreshes_what_mujoco_derives(model, robot_model_dir):
    """A changed armature changes the inverse weights as compiling it would."""
    before = model.dof_invweight0.copy()
    apply(model, {"mx64.armature": 0.1})
    assert not np.array_equal(before, model.dof_invweight0)
    apply(model, {"mx64.armature": read(load_model(robot_model_dir / "nominal.xml"), "mx64.armature")})
    np.testing.assert_allclose(model.dof_invweight0, before, rtol=1e-12)


@pytest.mark.parametrize("field", SENSOR_FIELDS)
def test_a_sensor_delay_round_trips(model, field):
    """Each sensor delay is set where the model has room for it, and its sensors are delayed."""
    apply(model, {f"sensor.{field}": 0.004})
    assert read(model, f"sensor.{field}") == 0.004
    assert (model.sensor_delay == 0.004).any()


@pytest.mark.parametrize("name", ["mx64.delay", "sensor.gyro_delay"])
@pytest.mark.parametrize("value", [0.5, -0.001, float("nan")])
def test_a_delay_without_room(model, name, value):
    """A delay that the history cannot hold is refused, where MuJoCo would cut it in silence."""
    with pytest.raises(ModelError, match="history buffer"):
        apply(model, {name: value})


@pytest.mark.parametrize(
    "name",
    ["", "kp", "mx64", "mx64.", ".kp", "mx64.colour", "sensor.kp", "mx64.kp.kp", "robot.supply_voltage", "robot.kp"],
)
def test_unknown_names(name):
    """A name that is no parameter is refused with the names there are."""
    with pytest.raises(CalibrationError, match="expected <servo>"):
        parameter(name)


def test_what_a_model_lacks(model, robot_model_dir, tmp_path):
    """A missing class, number or file, and XML that does not compile, are errors of the model."""
    with pytest.raises(ModelError, match="no servo class 'xl330'"):
        apply(model, {"xl330.kp": 1.0})
    with pytest.raises(ModelError, match="no custom number 'volts'"):
        number(model, "volts")
    with pytest.raises(ModelError, match="no model at"):
        load_model(tmp_path)
    bad = tmp_path / "bad.xml"
    for text in ("", "<mujoco>", "<mujoco><worldbody><joint/></worldbody></mujoco>", "\x00"):
        bad.write_text(text)
        with pytest.raises(ModelError, match=r"cannot compile|is not XML") as error:
            load_model(bad)
        assert "\n" not in str(error.value)
    assert servo_classes(mujoco.MjModel.from_xml_string("<mujoco/>")) == ()
    assert calibration_id(model) is None
    assert number(model, "servo_supply_voltage") == 15.0


@pytest.mark.parametrize("field", LAW_FIELDS)
def test_a_coefficient_round_trips(with_law, field):
    """Each coefficient of a law is set alone and read back; copies have their own."""
    other = copy.copy(with_law)
    apply(other, {f"mx106.{field}": 0.123})
    assert read(other, f"mx106.{field}") == 0.123
    name = "viscous" if field == "damping_off" else field
    assert servo_law.law(other, "mx106") == replace(M5, **{name: 0.123})
    assert servo_law.law(with_law, "mx106") == M5


def test_frictionloss_is_the_laws_coulomb_friction(with_law):
    """It is set in the law and in the joint, where it stays above zero for MuJoCo to make the row."""
    dofs = dofs_of(with_law, actuators_of(with_law, "mx106"))
    for value, kept in ((0.07, 0.07), (0.0, 1e-6)):
        apply(with_law, {"mx106.frictionloss": value, "mx64.frictionloss": value})
        assert servo_law.law(with_law, "mx106") == replace(M5, coulomb=value)
        assert read(with_law, "mx106.frictionloss") == read(with_law, "mx64.frictionloss") == value
        np.testing.assert_array_equal(with_law.dof_frictionloss[dofs], kept)


def test_shared_coefficients_stay_shared(with_law):
    """Where motor and load have the same coefficient, the load's follows the motor's unless it is given."""
    apply(with_law, {"mx106.load_motor": 0.09, "mx106.load_motor_stribeck": 0.11})
    assert servo_law.law(with_law, "mx106") == replace(M5, load_motor=0.09, load_motor_stribeck=0.11)
    m4 = replace(M5, load_external=0.06, load_external_stribeck=0.1)
    servo_law.set_law(with_law, "mx106", m4)
    apply(with_law, {"mx106.load_motor": 0.09, "mx106.load_motor_stribeck": 0.11})
    tied = replace(m4, load_motor=0.09, load_external=0.09, load_motor_stribeck=0.11, load_external_stribeck=0.11)
    assert servo_law.law(with_law, "mx106") == tied
    apply(with_law, {"mx106.load_external": 0.01, "mx106.load_motor": 0.02})
    assert servo_law.law(with_law, "mx106") == replace(tied, load_motor=0.02, load_external=0.01)


def test_a_law_the_model_has_not(model, with_law):
    """Coefficients for a class without a law are refused, and so are those a law cannot be evaluated with."""
    for one in (model, with_law):
        with pytest.raises(ModelError, match="no friction law for 'mx64'"):
            apply(one, {"mx64.stribeck": 0.1})
        with pytest.raises(ModelError, match="no friction law for 'mx64'"):
            read(one, "mx64.damping_off")
    for bad in ({"mx106.stribeck": -0.1}, {"mx106.load_motor": float("nan")}, {"mx106.stribeck_speed": 0.0}):
        with pytest.raises(ModelError, match="friction law of 'mx106'"):
            apply(with_law, bad)
    assert servo_law.law(with_law, "mx106") == M5


def test_the_supply_scales_gain_and_limit_of_every_servo(with_law):
    """Both are proportional to it, damping is not; in any order and however often, values hold at the stated supply."""
    before = copy.copy(with_law)
    apply(with_law, {"supply_voltage": 12.0})
    assert read(with_law, "supply_voltage") == 12.0
    np.testing.assert_allclose(with_law.actuator_gainprm[:, 0], 0.8 * before.actuator_gainprm[:, 0])
    np.testing.assert_allclose(with_law.actuator_biasprm[:, 1], -with_law.actuator_gainprm[:, 0])
    np.testing.assert_allclose(with_law.actuator_forcerange, 0.8 * before.actuator_forcerange)
    np.testing.assert_array_equal(with_law.dof_damping, before.dof_damping)
    assert read(with_law, "mx64.kp") == pytest.approx(read(before, "mx64.kp"))
    for values in (
        {"supply_voltage": 13.5, "mx106.kp": 20.0, "mx106.forcerange": 6.0},
        {"mx106.kp": 20.0, "mx106.forcerange": 6.0, "supply_voltage": 13.5},
    ):
        apply(with_law, values)
        mine = actuators_of(with_law, "mx106")
        np.testing.assert_allclose(with_law.actuator_gainprm[mine, 0], 18.0)
        np.testing.assert_allclose(with_law.actuator_forcerange[mine, 1], 5.4)
        assert read(with_law, "mx106.kp") == pytest.approx(20.0)
    apply(with_law, {"supply_voltage": 15.0})
    mine = actuators_of(with_law, "mx64")
    np.testing.assert_allclose(with_law.actuator_gainprm[mine], before.actuator_gainprm[mine])


def test_a_supply_that_cannot_be(model, with_law):
    """A model without a present supply, and a voltage that is none, are refused."""
    with pytest.raises(ModelError, match="present_supply_voltage"):
        apply(model, {"supply_voltage": 12.0})
    for bad in (0.0, -12.0, float("nan"), float("inf")):
        with pytest.raises(ModelError, match="expected positive"):
            apply(with_law, {"supply_voltage": bad})
    for stated, present in ((0.0, 15.0), (15.0, 0.0), (15.0, float("nan"))):
        with_law.numeric("servo_supply_voltage").data[0] = stated
        with_law.numeric("present_supply_voltage").data[0] = present
        with pytest.raises(ModelError, match=r"no positive voltage"):
            apply(with_law, {"mx64.kp": 12.0})

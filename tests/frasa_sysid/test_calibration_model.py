import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import (
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
)

VALUES = {"kp": 17.5, "forcerange": 3.25, "damping": 0.77, "frictionloss": 0.011, "armature": 0.0123, "delay": 0.0091}


@pytest.fixture
def model(robot_model_dir):
    """The nominal robot, fresh for each test."""
    return load_model(robot_model_dir / "nominal.xml")


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


@pytest.mark.parametrize("name", ["", "kp", "mx64", "mx64.", ".kp", "mx64.colour", "sensor.kp", "mx64.kp.kp"])
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
        with pytest.raises(ModelError, match="cannot compile") as error:
            load_model(bad)
        assert "\n" not in str(error.value)
    assert servo_classes(mujoco.MjModel.from_xml_string("<mujoco/>")) == ()
    assert calibration_id(model) is None
    assert number(model, "servo_supply_voltage") == 15.0

"""Actuators, servo classes, sensors and solver options of the nominal model against the source's tables."""

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration.apply import actuators_of, dofs_of, number, read, servo_classes

ENUMS = {
    "integrator": mujoco.mjtIntegrator.mjINT_EULER,
    "solver": mujoco.mjtSolver.mjSOL_NEWTON,
    "cone": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    "jacobian": mujoco.mjtJacobian.mjJAC_AUTO,
}
OPTIONS = [
    "timestep",
    "iterations",
    "ls_iterations",
    "tolerance",
    "ls_tolerance",
    "noslip_iterations",
    "noslip_tolerance",
    "ccd_iterations",
    "ccd_tolerance",
    "impratio",
    "density",
    "viscosity",
    "enableflags",
    "disableflags",
]


def test_actuators(nominal, table):
    """Order, joint, gain, force and command range of every actuator are the table's."""
    rows = table("actuators")
    assert nominal.nu == len(rows)
    for i, row in enumerate(rows):
        kp, kv = float(row["kp"]), float(row["kv"])
        assert nominal.actuator(i).name == row["name"]
        assert nominal.joint(nominal.actuator_trnid[i, 0]).name == row["joint"]
        assert nominal.actuator_gainprm[i, 0] == kp
        np.testing.assert_array_equal(nominal.actuator_biasprm[i, :3], [0, -kp, -kv])
        for name, field in (("force", "forcerange"), ("ctrl", "ctrlrange")):
            low_high = [float(row[f"{name}_lo"]), float(row[f"{name}_hi"])]
            np.testing.assert_array_equal(getattr(nominal, f"actuator_{field}")[i], low_high)
            assert getattr(nominal, f"actuator_{name}limited")[i]


def test_servo_classes_list_their_actuators(nominal, table):
    """The custom tuples name exactly the actuators that the table puts in each class."""
    assert set(servo_classes(nominal)) == {"mx64", "mx106"}
    for servo in servo_classes(nominal):
        names = [nominal.actuator(i).name for i in actuators_of(nominal, servo)]
        assert names == [row["name"] for row in table("actuators") if row["class"] == servo]


@pytest.mark.parametrize("servo", ["mx64", "mx106"])
def test_class_numbers(nominal, table, servo):
    """Every actuator and joint of a class carries the numbers of the active gain set."""
    (row,) = (r for r in table("actuator_classes") if r["active"] == "1" and r["class"] == servo)
    actuators = actuators_of(nominal, servo)
    dofs = dofs_of(nominal, actuators)
    assert set(nominal.actuator_gainprm[actuators, 0]) == {float(row["kp"])}
    assert set(nominal.actuator_forcerange[actuators, 1]) == {float(row["force_hi"])}
    for field in ("damping", "armature", "frictionloss"):
        assert set(getattr(nominal, f"dof_{field}")[dofs]) == {float(row[f"joint_{field}"])}
    assert read(nominal, f"{servo}.delay") == 0
    assert number(nominal, "servo_firmware_gain") == float(row["gain_set"].removeprefix("kp"))


def test_sensors(nominal, table):
    """The table's sensors come first, with its type, site and size."""
    for i, row in enumerate(table("sensors")):
        assert nominal.sensor(i).name == row["name"]
        assert nominal.sensor_type[i] == getattr(mujoco.mjtSensor, f"mjSENS_{row['type'].upper()}")
        assert nominal.site(nominal.sensor_objid[i]).name == row["attached_name"]
        assert nominal.sensor_dim[i] == int(row["dim"])


def test_options(nominal, table):
    """Every solver option is the table's."""
    option = {row["option"]: row["value"] for row in table("options")}
    for name in OPTIONS:
        assert getattr(nominal.opt, name) == float(option[name]), name
    for name, value in ENUMS.items():
        assert getattr(nominal.opt, name) == value
        assert value.name.split("_")[1] == option[name].upper()
    np.testing.assert_array_equal(nominal.opt.gravity, [float(option[f"gravity_{k}"]) for k in "xyz"])

"""Reading and writing calibrated numbers in a compiled `MjModel`.

Which actuators belong to a servo class stands in the model itself: a custom tuple
named after the class lists them. The supply voltage and firmware gain at which gains
and force limits hold are the custom numbers `servo_supply_voltage` and
`servo_firmware_gain`. Delays are MuJoCo's own (`actuator_delay`, `sensor_delay`).
Friction laws beyond Coulomb-viscous are custom numbers too (see `servo_law`). Zero errors
of joints, and the trunk, are in `bodies`.

A model whose supply may change also has the custom number `present_supply_voltage`: its
actuators hold what gain and force limit are at that supply, while `kp` and `forcerange`,
written and read here, stay those at the stated one. In a model of trapezoidal stepping (see
`stepping`) `armature` is that of the joint, without what stands in the model for its damping.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration import bodies, stepping
from frasa_sysid.calibration.errors import ModelError
from frasa_sysid.calibration.parameters import JOINT_FIELDS, LAW_COEFFICIENTS, LAW_FIELDS, Parameter, parameter

if TYPE_CHECKING:  # it brings the compiler
    from frasa_sysid.calibration.friction import Friction

LEAST_FRICTION = 1e-6  # [N m]; at zero MuJoCo makes no friction row, which a law fills
STATED_SUPPLY, PRESENT_SUPPLY = "servo_supply_voltage", "present_supply_voltage"
_SENSOR_TYPES = {
    "position_delay": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "velocity_delay": mujoco.mjtSensor.mjSENS_JOINTVEL,
    "gyro_delay": mujoco.mjtSensor.mjSENS_GYRO,
    "orientation_delay": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
}


def servo_classes(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the servo classes a model declares (its custom tuples of actuators)."""
    return tuple(
        model.tuple(i).name
        for i in range(model.ntuple)
        if (_tuple_types(model, i) == mujoco.mjtObj.mjOBJ_ACTUATOR).all()
    )


def actuators_of(model: mujoco.MjModel, servo: str) -> npt.NDArray[np.int64]:
    """Indices of the actuators of a servo class, shape (n,).

    Raises:
        ModelError: the model has no such class.
    """
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, servo)
    if index < 0 or not (_tuple_types(model, index) == mujoco.mjtObj.mjOBJ_ACTUATOR).all():
        known = ", ".join(servo_classes(model)) or "none (no custom tuple lists actuators)"
        raise ModelError(f"the model has no servo class '{servo}'; it has {known}")
    start = model.tuple_adr[index]
    return np.asarray(model.tuple_objid[start : start + model.tuple_size[index]], dtype=np.int64)


def dofs_of(model: mujoco.MjModel, actuators: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Degree of freedom that each joint actuator drives, shape (n,)."""
    return np.asarray(model.jnt_dofadr[model.actuator_trnid[actuators, 0]], dtype=np.int64)


def trunk_of(model: mujoco.MjModel) -> int:
    """The body that carries all servos: the one with the free joint, or the root of a fixed base.

    Raises:
        ModelError: the model has no servo class, or its servos belong to several robots.
    """
    servos = servo_classes(model)
    joints = [model.actuator_trnid[actuators_of(model, one), 0] for one in servos]
    roots = np.unique(model.body_rootid[model.jnt_bodyid[np.concatenate(joints)]]) if joints else np.zeros(0)
    if roots.size != 1:
        raise ModelError(f"expected one body that carries all servos of {', '.join(servos) or 'no class'}")
    return int(roots[0])


def delay_room(model: mujoco.MjModel, servo: str) -> float:
    """Longest command delay [s] that the history buffers of a servo class can hold."""
    return float(model.actuator_history[actuators_of(model, servo), 0].min() * model.opt.timestep)


def delayed_sensors(model: mujoco.MjModel, field: str) -> npt.NDArray[np.int64]:
    """Sensors with a history buffer that a `sensor.*_delay` parameter speaks of, shape (n,)."""
    kind = model.sensor_type == _SENSOR_TYPES[field]
    return np.flatnonzero(kind & (model.sensor_history[:, 0] > 0))


def apply(model: mujoco.MjModel, values: Mapping[str, float]) -> None:
    """Set calibrated values in a model, in place, and refresh what MuJoCo derives from them.

    Args:
        model: the compiled model.
        values: value by parameter name, in the units of `parameters`.

    Raises:
        CalibrationError: a name that does not exist.
        ModelError: as `assign` says.
    """
    assign(model, values)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def assign(model: mujoco.MjModel, values: Mapping[str, float]) -> None:
    """Set calibrated values in a model, in place; `mj_setConst` is left to the caller.

    Where motor and load share a coefficient of the friction law (M3, M4), setting the motor's
    sets the load's with it, unless that is given too.

    Args:
        model: the compiled model.
        values: value by parameter name, in the units of `parameters`.

    Raises:
        CalibrationError: a name that does not exist.
        ModelError: a class, joint, trunk, delay buffer, friction law or present supply the model does not have, a
            delay too long for its buffer, a coefficient that a law cannot be evaluated with, or a mass that is none.
    """
    laws: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        one = parameter(name)
        if one.field in LAW_COEFFICIENTS:
            laws.setdefault(one.owner, {})[LAW_COEFFICIENTS[one.field]] = value
        if one.owner == "sensor":
            _set_sensor_delay(model, one, value)
        elif one.owner == "robot":
            _set_supply(model, value)
        elif one.field in JOINT_FIELDS:
            bodies.set_zero(model, one.owner, value)
        elif one.owner == "trunk":
            bodies.set_trunk(model, trunk_of(model), one.field, value)
        elif one.field not in LAW_FIELDS:
            _set_servo(model, one, value)
    for servo, coefficients in laws.items():
        _set_coefficients(model, servo, coefficients)


def read(model: mujoco.MjModel, name: str) -> float:
    """The value a model holds for a parameter (of the first element it applies to).

    Raises:
        CalibrationError: no such parameter.
        ModelError: the model has no such class or joint, or not the friction law or present supply it speaks of.
    """
    one = parameter(name)
    if one.owner == "robot":
        return number(model, PRESENT_SUPPLY)
    if one.owner == "sensor":
        found = delayed_sensors(model, one.field)
        return float(model.sensor_delay[found[0]]) if found.size else 0.0
    if one.field in JOINT_FIELDS:
        return bodies.zero_of(model, one.owner)
    if one.owner == "trunk":
        return bodies.trunk_number(model, trunk_of(model), one.field)
    first = actuators_of(model, one.owner)[:1]
    law = _law(model, one.owner) if one.field in LAW_COEFFICIENTS else None
    if law is not None:
        return float(getattr(law, LAW_COEFFICIENTS[one.field]))
    if one.field in LAW_FIELDS:
        raise _no_law(one.owner)
    dof = dofs_of(model, first)[0]
    ratio = _supply_ratio(model)
    fields = {
        "kp": model.actuator_gainprm[first[0], 0] / ratio,
        "forcerange": model.actuator_forcerange[first[0], 1] / ratio,
        "damping": model.dof_damping[dof],
        "frictionloss": model.dof_frictionloss[dof],
        "armature": stepping.armature_of(model, int(dof)),
        "delay": model.actuator_delay[first[0]],
    }
    return float(fields[one.field])


def number(model: mujoco.MjModel, name: str) -> float:
    """A custom number of the model, such as `servo_supply_voltage` [V].

    Raises:
        ModelError: the model does not declare it.
    """
    try:
        return float(model.numeric(name).data[0])
    except KeyError:
        raise ModelError(
            f'the model has no custom number \'{name}\'; add <numeric name="{name}" data="..."/>'
        ) from None


def _tuple_types(model: mujoco.MjModel, index: int) -> npt.NDArray[np.int32]:
    start = model.tuple_adr[index]
    return np.asarray(model.tuple_objtype[start : start + model.tuple_size[index]])


def _set_servo(model: mujoco.MjModel, one: Parameter, value: float) -> None:
    actuators = actuators_of(model, one.owner)
    dofs = dofs_of(model, actuators)
    if one.field == "kp":
        gain = value * _supply_ratio(model)
        model.actuator_gainprm[actuators, 0] = gain
        model.actuator_biasprm[actuators, 1] = -gain
    elif one.field == "forcerange":
        limit = value * _supply_ratio(model)
        model.actuator_forcerange[actuators] = (-limit, limit)
    elif one.field == "delay":
        _check_delay(one.name, value, delay_room(model, one.owner))
        model.actuator_delay[actuators] = value
    elif one.field == "frictionloss" and _law(model, one.owner) is not None:
        model.dof_frictionloss[dofs] = max(value, LEAST_FRICTION)
    elif one.field == "frictionloss":
        model.dof_frictionloss[dofs] = value
    elif one.field == "damping":
        stepping.set_damping(model, dofs, value)
    else:
        stepping.set_armature(model, dofs, value)


def _law(model: mujoco.MjModel, servo: str) -> "Friction | None":
    from frasa_sysid.calibration import servo_law  # it looks servo classes up in this file

    # Asked first, because reading a law brings the compiler.
    return servo_law.law(model, servo) if servo_law.has_law(model) else None


def _no_law(servo: str) -> ModelError:
    return ModelError(f"the model has no friction law for '{servo}' (custom number '{servo}_friction')")


def _set_coefficients(model: mujoco.MjModel, servo: str, coefficients: dict[str, float]) -> None:
    law = _law(model, servo)
    if law is None:
        if set(coefficients) == {"coulomb"}:  # the joint's own frictionloss is all the friction there is
            return
        raise _no_law(servo)
    from frasa_sysid.calibration import servo_law

    servo_law.set_law(model, servo, law.changed(coefficients))


def _supply_ratio(model: mujoco.MjModel) -> float:
    """Present over stated supply; 1 for a model whose supply cannot change."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, PRESENT_SUPPLY) < 0:
        return 1.0
    present, stated = number(model, PRESENT_SUPPLY), number(model, STATED_SUPPLY)
    if not (np.isfinite([present, stated]).all() and present > 0.0 and stated > 0.0):
        raise ModelError(f"{PRESENT_SUPPLY} = {present} V, {STATED_SUPPLY} = {stated} V: one is no positive voltage")
    return present / stated


def _set_supply(model: mujoco.MjModel, voltage: float) -> None:
    """Gain and torque limit of every servo class scale with the supply; damping does not."""
    present = number(model, PRESENT_SUPPLY)
    if not (np.isfinite(voltage) and voltage > 0.0 and present > 0.0):
        raise ModelError(f"supply_voltage = {voltage} V in a model at {present} V: expected positive numbers")
    for servo in servo_classes(model):
        actuators = actuators_of(model, servo)
        model.actuator_gainprm[actuators, 0] *= voltage / present
        model.actuator_biasprm[actuators, 1] *= voltage / present
        model.actuator_forcerange[actuators] *= voltage / present
    model.numeric(PRESENT_SUPPLY).data[0] = voltage


def _set_sensor_delay(model: mujoco.MjModel, one: Parameter, value: float) -> None:
    sensors = delayed_sensors(model, one.field)
    room = model.sensor_history[sensors, 0].min() * model.opt.timestep if sensors.size else 0.0
    _check_delay(one.name, value, room)
    model.sensor_delay[sensors] = value


def _check_delay(name: str, value: float, room: float) -> None:
    if not 0.0 <= value <= room:
        raise ModelError(
            f"{name} = {value * 1e3:.2f} ms does not fit the model's history buffer of {room * 1e3:.1f} ms"
        )

"""Reading and writing calibrated numbers in a compiled `MjModel`.

Which actuators belong to a servo class stands in the model itself: a custom tuple
named after the class lists them. The supply voltage and firmware gain at which gains
and force limits hold are the custom numbers `servo_supply_voltage` and
`servo_firmware_gain`. Delays are MuJoCo's own (`actuator_delay`, `sensor_delay`).
"""

from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.errors import ModelError
from frasa_sysid.calibration.parameters import Parameter, parameter

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
    if servo not in servo_classes(model):
        known = ", ".join(servo_classes(model)) or "none (no custom tuple lists actuators)"
        raise ModelError(f"the model has no servo class '{servo}'; it has {known}")
    index = model.tuple(servo).id
    start = model.tuple_adr[index]
    return np.asarray(model.tuple_objid[start : start + model.tuple_size[index]], dtype=np.int64)


def dofs_of(model: mujoco.MjModel, actuators: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Degree of freedom that each joint actuator drives, shape (n,)."""
    return np.asarray(model.jnt_dofadr[model.actuator_trnid[actuators, 0]], dtype=np.int64)


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
        ModelError: a class or delay buffer the model does not have, or a delay too long for it.
    """
    for name, value in values.items():
        one = parameter(name)
        if one.owner == "sensor":
            _set_sensor_delay(model, one, value)
        else:
            _set_servo(model, one, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def read(model: mujoco.MjModel, name: str) -> float:
    """The value a model holds for a parameter (of the first element it applies to)."""
    one = parameter(name)
    if one.owner == "sensor":
        found = delayed_sensors(model, one.field)
        return float(model.sensor_delay[found[0]]) if found.size else 0.0
    first = actuators_of(model, one.owner)[:1]
    dof = dofs_of(model, first)[0]
    fields = {
        "kp": model.actuator_gainprm[first[0], 0],
        "forcerange": model.actuator_forcerange[first[0], 1],
        "damping": model.dof_damping[dof],
        "frictionloss": model.dof_frictionloss[dof],
        "armature": model.dof_armature[dof],
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
        model.actuator_gainprm[actuators, 0] = value
        model.actuator_biasprm[actuators, 1] = -value
    elif one.field == "forcerange":
        model.actuator_forcerange[actuators] = (-value, value)
    elif one.field == "delay":
        room = model.actuator_history[actuators, 0].min() * model.opt.timestep
        _check_delay(one.name, value, room)
        model.actuator_delay[actuators] = value
    else:
        getattr(model, f"dof_{one.field}")[dofs] = value


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

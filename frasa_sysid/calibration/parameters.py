"""The table of everything that can be calibrated in a MuJoCo model.

A parameter is data: a name, a unit, physical bounds and the field it sets. Names
are `<servo class>.<field>` for actuators (`mx106.damping`) and `sensor.<field>` for
delays of what the robot measures (`sensor.gyro_delay`).
"""

from dataclasses import dataclass
from typing import Literal

from frasa_sysid.calibration.errors import CalibrationError

ServoField = Literal["kp", "forcerange", "damping", "frictionloss", "armature", "delay"]
SensorField = Literal["position_delay", "velocity_delay", "gyro_delay", "orientation_delay"]


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    Attributes:
        name: `mx106.damping`, `sensor.gyro_delay`.
        owner: servo class, or `sensor`.
        field: what is set; see `SERVO_FIELDS` and `SENSOR_FIELDS`.
        unit: SI unit as text.
        meaning: one sentence.
    """

    name: str
    owner: str
    field: str
    unit: str
    meaning: str


SERVO_FIELDS: dict[str, tuple[str, str]] = {
    "kp": ("N m/rad", "position gain of the servo at the model's supply voltage and firmware gain"),
    "forcerange": ("N m", "torque limit at the model's supply voltage, symmetric"),
    "damping": ("N m s/rad", "viscous friction plus back-EMF kt^2/R of the powered motor"),
    "frictionloss": ("N m", "Coulomb friction"),
    "armature": ("kg m^2", "rotor inertia seen at the output"),
    "delay": ("s", "time from sending a goal to the servo acting on it"),
}
SENSOR_FIELDS: dict[str, tuple[str, str]] = {
    "position_delay": ("s", "age of a joint position when it is read"),
    "velocity_delay": ("s", "age of a joint velocity when it is read"),
    "gyro_delay": ("s", "age of the angular rate when it is read"),
    "orientation_delay": ("s", "age of the trunk orientation when it is read"),
}


def parameter(name: str) -> Parameter:
    """The parameter of that name.

    Raises:
        CalibrationError: no such parameter; the message lists the fields there are.
    """
    owner, _, field = name.partition(".")
    fields = SENSOR_FIELDS if owner == "sensor" else SERVO_FIELDS
    if not owner or field not in fields:
        raise CalibrationError(
            f"unknown parameter '{name}': expected <servo>.<{'|'.join(SERVO_FIELDS)}> "
            f"or sensor.<{'|'.join(SENSOR_FIELDS)}>"
        )
    unit, meaning = fields[field]
    return Parameter(name, owner, field, unit, meaning)

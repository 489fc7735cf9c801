"""The table of everything that can be calibrated in a MuJoCo model.

A parameter is data: a name, a unit, physical bounds and the field it sets. Names
are `<servo class>.<field>` for actuators (`mx106.damping`), `sensor.<field>` for
delays of what the robot measures (`sensor.gyro_delay`), `<joint>.zero` for the zero
error of a joint's encoder (`left_knee.zero`), `trunk.<field>` for the trunk's mass and
centre of mass, and `supply_voltage`.
"""

from dataclasses import dataclass
from functools import lru_cache

from frasa_sysid.calibration.errors import CalibrationError


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    Attributes:
        name: `mx106.damping`, `sensor.gyro_delay`, `left_knee.zero`, `trunk.mass`, `supply_voltage`.
        owner: servo class, joint, `sensor`, `trunk` or `robot`.
        field: what is set; see `SERVO_FIELDS`, `LAW_FIELDS`, `SENSOR_FIELDS`, `JOINT_FIELDS`, `TRUNK_FIELDS` and
            `ROBOT_FIELDS`.
        unit: SI unit as text.
        meaning: one sentence.
    """

    name: str
    owner: str
    field: str
    unit: str
    meaning: str

    @property
    def signed(self) -> bool:
        """Whether it may be negative: zeros and positions may, everything else may not."""
        return self.field in SIGNED_FIELDS


SERVO_FIELDS: dict[str, tuple[str, str]] = {
    "kp": ("N m/rad", "position gain of the servo at the model's supply voltage and firmware gain"),
    "forcerange": ("N m", "torque limit at the model's supply voltage, symmetric"),
    "damping": ("N m s/rad", "viscous friction plus back-EMF kt^2/R of the powered motor"),
    "frictionloss": ("N m", "Coulomb friction"),
    "armature": ("kg m^2", "rotor inertia seen at the output"),
    "delay": ("s", "time from sending a goal to the servo acting on it"),
}
# Of a servo whose friction is a law beyond Coulomb-viscous; its `frictionloss` is the law's Coulomb friction.
LAW_FIELDS: dict[str, tuple[str, str]] = {
    "damping_off": ("N m s/rad", "viscous friction K_v: what is left of the damping with the motor off"),
    "stribeck": ("N m", "extra friction K_cs at standstill"),
    "load_motor": ("1", "friction K_m as a share of the motor's torque"),
    "load_external": ("1", "friction K_e as a share of the load's torque"),
    "load_motor_stribeck": ("1", "extra share K_ms of the motor's torque at standstill"),
    "load_external_stribeck": ("1", "extra share K_es of the load's torque at standstill"),
    "quad_motor": ("1/(N m)", "friction Q_m by the square of the motor's torque, where the load drives it"),
    "quad_external": ("1/(N m)", "friction Q_e by the square of the load's torque, where the motor drives it"),
    "stribeck_speed": ("rad/s", "speed dq_s at which the extra of a standstill has faded"),
    "stribeck_exponent": ("1", "how sharply it fades, alpha"),
}
# Which coefficient of `friction.Friction` a field sets.
LAW_COEFFICIENTS: dict[str, str] = {
    "frictionloss": "coulomb",
    **{field: "viscous" if field == "damping_off" else field for field in LAW_FIELDS},
}
SENSOR_FIELDS: dict[str, tuple[str, str]] = {
    "position_delay": ("s", "age of a joint position when it is read"),
    "velocity_delay": ("s", "age of a joint velocity when it is read"),
    "gyro_delay": ("s", "age of the angular rate when it is read"),
    "orientation_delay": ("s", "age of the trunk orientation when it is read"),
}
JOINT_FIELDS: dict[str, tuple[str, str]] = {
    "zero": ("rad", "zero error of the joint's encoder: measured angle less true angle"),
}
TRUNK_FIELDS: dict[str, tuple[str, str]] = {
    "mass": ("kg", "mass of the trunk; its inertia is proportional to it"),
    "com_x": ("m", "centre of mass of the trunk in its body's frame, x"),
    "com_y": ("m", "centre of mass of the trunk in its body's frame, y"),
    "com_z": ("m", "centre of mass of the trunk in its body's frame, z"),
}
SIGNED_FIELDS = frozenset(("zero", "com_x", "com_y", "com_z"))
ROBOT_FIELDS: dict[str, tuple[str, str]] = {
    "supply_voltage": ("V", "present supply of all servos; their gains and torque limits are proportional to it"),
}


@lru_cache(1024)  # asked for every number of every robot drawn
def parameter(name: str) -> Parameter:
    """The parameter of that name.

    Raises:
        CalibrationError: no such parameter; the message lists the fields there are.
    """
    owner, _, field = ("robot", "", name) if name in ROBOT_FIELDS else name.partition(".")
    fields = {"sensor": SENSOR_FIELDS, "trunk": TRUNK_FIELDS, "robot": ROBOT_FIELDS}.get(owner)
    if fields is None and name.endswith(".zero"):  # names of joints may hold dots
        owner, field, fields = name.removesuffix(".zero"), "zero", JOINT_FIELDS
    fields = SERVO_FIELDS | LAW_FIELDS if fields is None else fields
    if not owner or field not in fields or (owner == "robot" and name != field):
        raise CalibrationError(
            f"unknown parameter '{name}': expected <servo>.<{'|'.join([*SERVO_FIELDS, *LAW_FIELDS])}>, "
            f"sensor.<{'|'.join(SENSOR_FIELDS)}>, <joint>.<{'|'.join(JOINT_FIELDS)}>, trunk.<{'|'.join(TRUNK_FIELDS)}> "
            f"or {'|'.join(ROBOT_FIELDS)}"
        )
    unit, meaning = fields[field]
    return Parameter(name, owner, field, unit, meaning)

"""Ranges that nobody has measured, each with who assumed it; measured ones come with the calibrated model."""

from dataclasses import dataclass, fields
from math import radians
from typing import Literal

from frasa_rl.config_checks import TaskError, one_of, within

ENVIRONMENT = "FRASA's published environment, Rhoban/frasa at 78457df"


@dataclass(frozen=True)
class Assumed:
    """A range that was not measured on the robot.

    Attributes:
        low: smallest value.
        high: largest value; uniform between the two.
        unit: SI unit, or `ratio` when the model's own value is multiplied.
        source: who assumed it.
    """

    low: float
    high: float
    unit: str
    source: str

    def __post_init__(self) -> None:
        within("low", self.low, -1e6, 1e6)
        within("high", self.high, -1e6, 1e6)
        if self.low > self.high:
            raise TaskError(f"low is {self.low:g} and high is {self.high:g}: expected low to be the smaller one")
        if not self.source.strip():
            raise TaskError("source is empty: expected who assumed the range, and why")


@dataclass(frozen=True)
class ServoSpread(Assumed):
    """An assumed range of servos.

    Attributes:
        per: one ratio for the whole `robot`, one for each servo `class`, or one for each `joint`. Actuators outside
            of all classes are a class of their own.
    """

    per: Literal["robot", "class", "joint"] = "robot"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("per", self.per, ("robot", "class", "joint"))


@dataclass(frozen=True)
class AssumedRanges:
    """What differs from episode to episode beside the calibrated ranges; null leaves it as it is in the model.

    A measured range replaces the assumed one, number by number. Delays differ by calibration only, unless a source
    for a range of theirs is given here.

    Attributes:
        floor_friction: sliding friction of the floor against everything [1].
        trunk_mass: mass of the trunk, with its inertia [ratio].
        trunk_com: offset of the trunk's centre of mass along each axis [m].
        supply_voltage: of all servos, gain and torque limit with it [V], or [ratio] of what the model has.
        joint_zero: zero error of each driven hinge, added to the model's own [rad].
        damping: of servos without a measured range [ratio].
        frictionloss: dry friction of servos without a measured range [ratio].
        joint_damping: of each joint by itself, on top of what its servo has, measured or not [ratio].
        joint_frictionloss: the same for dry friction [ratio].
        command_delay: from a command to the servo that acts on it [s].
        position_delay: age of joint positions when they are read [s].
        velocity_delay: age of joint velocities when they are read [s].
        gyro_delay: age of the angular rate when it is read [s].
        orientation_delay: age of the orientation when it is read [s].
    """

    floor_friction: Assumed | None = Assumed(0.25, 1.5, "1", ENVIRONMENT)
    trunk_mass: Assumed | None = Assumed(0.8, 1.2, "ratio", ENVIRONMENT)
    trunk_com: Assumed | None = Assumed(-0.005, 0.005, "m", ENVIRONMENT)
    supply_voltage: Assumed | None = Assumed(13.8, 16.8, "V", f"{ENVIRONMENT}: a 4-cell battery, empty to full")
    joint_zero: Assumed | None = Assumed(radians(-1.5), radians(1.5), "rad", ENVIRONMENT)
    damping: ServoSpread | None = ServoSpread(0.8, 1.2, "ratio", ENVIRONMENT)
    frictionloss: ServoSpread | None = ServoSpread(0.8, 1.2, "ratio", ENVIRONMENT)
    joint_damping: Assumed | None = None
    joint_frictionloss: Assumed | None = None
    command_delay: Assumed | None = None
    position_delay: Assumed | None = None
    velocity_delay: Assumed | None = None
    gyro_delay: Assumed | None = None
    orientation_delay: Assumed | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            one: Assumed | None = getattr(self, field.name)
            if one is not None:
                low, high, units = _BOUNDS[field.name]
                one_of(f"{field.name}.unit", one.unit, units)
                within(f"{field.name}.low", one.low, low, high, one.unit)
                within(f"{field.name}.high", one.high, low, high, one.unit)


_RATIO = (0.01, 100.0, ("ratio",))
_DELAY = (0.0, 1.0, ("s",))
_BOUNDS: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "floor_friction": (0.0, 10.0, ("1",)),
    "trunk_mass": _RATIO,
    "trunk_com": (-0.5, 0.5, ("m",)),
    "supply_voltage": (0.01, 1000.0, ("V", "ratio")),
    "joint_zero": (-0.5, 0.5, ("rad",)),
    "damping": _RATIO,
    "frictionloss": _RATIO,
    "joint_damping": _RATIO,
    "joint_frictionloss": _RATIO,
    "command_delay": _DELAY,
    "position_delay": _DELAY,
    "velocity_delay": _DELAY,
    "gyro_delay": _DELAY,
    "orientation_delay": _DELAY,
}

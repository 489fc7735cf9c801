"""The truth of a virtual robot: its servos, delays, zeros, trunk and battery, drawn at random from a seed.

Names are those of `calibration.parameters`, so that a fit can be held against them. Delays are ages:
a reading stamped t is the truth of t - delay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.random import Generator

from frasa_sysid.calibration.friction import Friction
from frasa_sysid.holds import HOLDS
from frasa_sysid.servo import PUBLISHED_M4, Servo, servo

Base = Literal["fixed", "floating"]
FIRMWARE_GAIN = 12.0  # P of the gain set that Rhoban/frasa uses
SUPPLY = 15.0  # [V] that goes with it; a robot stated at another one has a battery of as many times that

SCALES = (0.85, 1.15)  # of gain, damping and friction of a servo class
# Ages [s]: around the 30 ms (velocity) and 50 ms (trunk) that FRASA assumes (arXiv 2410.08650 and 2410.08655) ...
DELAYS: Mapping[str, tuple[float, float]] = {
    "command": (0.004, 0.020),
    "position": (0.0, 0.008),
    "velocity": (0.020, 0.040),
    "gyro": (0.035, 0.065),
    "orientation": (0.035, 0.065),
}
ZERO_SD, ZERO_MOST = np.radians(1.0), np.radians(3.0)  # a horn one tooth off is far more and would be seen
TRUNK_MASS, TRUNK_COM = 0.1, 0.005  # share; [m]
HELD_TILT = (np.radians(3.0), np.radians(9.0))  # [rad] nobody holds a trunk upright
OPEN_VOLTAGE, RESISTANCE = (15.2, 16.4), (0.04, 0.10)  # [V], [Ohm] a four-cell battery and its leads
GYRO_BIAS = 0.01  # [rad/s] standard deviation


@dataclass(frozen=True)
class Scales:
    """Of a servo class, against what is published about it: torque per volt, damping, friction."""

    gain: float = 1.0
    damping: float = 1.0
    friction: float = 1.0


@dataclass(frozen=True)
class RobotTruth:
    """Everything true about one virtual robot.

    Attributes:
        base: `fixed`, held by the trunk, or `floating`, on its feet.
        seed: what it was drawn from; also seeds its noise.
        scales: by servo class.
        command_delay: from the stamp of a goal to the firmware having it [s].
        position_delay, velocity_delay, gyro_delay, orientation_delay: age at the stamp [s].
        zeros: by joint, reading minus true angle [rad]; those missing are 0.
        trunk_mass: ratio to the model's, inertia with it.
        trunk_com: shift of the trunk's centre of mass [m], trunk frame.
        roll, pitch: of the held trunk [rad]; unused on the ground.
        open_voltage: of the battery without load [V].
        resistance: of battery and leads [Ohm].
        gyro_bias: [rad/s], trunk frame.
        firmware_gain: P of the servos while this log is taken; `<servo>.kp` is told at the usual one.
        types: what the servo classes are; those missing are the published ones of that name.
    """

    base: Base = "fixed"
    seed: int = 0
    scales: Mapping[str, Scales] | None = None
    command_delay: float = 0.0
    position_delay: float = 0.0
    velocity_delay: float = 0.0
    gyro_delay: float = 0.0
    orientation_delay: float = 0.0
    zeros: Mapping[str, float] | None = None
    trunk_mass: float = 1.0
    trunk_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll: float = 0.0
    pitch: float = 0.0
    open_voltage: float = 15.0
    resistance: float = 0.0
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    firmware_gain: float = FIRMWARE_GAIN
    types: Mapping[str, Servo] | None = None

    def servo(self, name: str) -> Servo:
        """The servo of a class as it is on this robot.

        Raises:
            UsageError: a class whose load-dependent law nobody published.
        """
        known = (self.types or {}).get(name) or servo(name, PUBLISHED_M4)
        return scaled(known, (self.scales or {}).get(name, Scales()))


def held(truth: RobotTruth, hold: str, firmware_gain: float | None = None) -> RobotTruth:
    """The same robot held in one of `holds.HOLDS`, as far off it as it was off upright; P of its servos, if another."""
    way, gain = HOLDS[hold], firmware_gain or truth.firmware_gain
    return replace(truth, roll=truth.roll + way.roll, pitch=truth.pitch + way.pitch, firmware_gain=gain)


def scaled(one: Servo, by: Scales) -> Servo:
    """A servo with other torque per volt, damping (back-EMF included) and friction.

    Only kt/R and kt^2/R reach the mechanics: both come out right with kt' = kt d/g, R' = R d/g^2.
    """
    kt, R = one.kt * by.damping / by.gain, one.R * by.damping / by.gain**2
    old = one.friction
    torques = ("coulomb", "stribeck", "load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck")
    friction: Friction = replace(
        old, viscous=old.viscous * by.damping, **{name: getattr(old, name) * by.friction for name in torques}
    )
    return replace(one, kt=kt, R=R, friction=friction)


def draw(
    base: Base,
    seed: int,
    servos: tuple[str, ...],
    joints: tuple[str, ...],
    types: Mapping[str, Servo] | None = None,
    supply: float = SUPPLY,
    firmware_gain: float = FIRMWARE_GAIN,
) -> RobotTruth:
    """A random robot; the same seed gives the same one.

    Args:
        base: how the log is taken; the same robot either way.
        seed: zero or more.
        servos: classes of the model.
        joints: those with a servo, in the model's order.
        types: what the servo classes are.
        supply: at which the model's gains hold [V].
        firmware_gain: P at which they do.
    """
    rng = np.random.default_rng((seed, 1))
    scales = {name: Scales(*rng.uniform(*SCALES, 3).tolist()) for name in sorted(servos)}
    delays = {f"{name}_delay": float(rng.uniform(low, high)) for name, (low, high) in DELAYS.items()}
    zeros = np.clip(rng.normal(0.0, ZERO_SD, len(joints)), -ZERO_MOST, ZERO_MOST)
    return RobotTruth(
        base,
        seed,
        scales,
        zeros=dict(zip(joints, zeros.tolist(), strict=True)),
        trunk_mass=1.0 + float(rng.uniform(-TRUNK_MASS, TRUNK_MASS)),
        trunk_com=_three(rng.uniform(-TRUNK_COM, TRUNK_COM, 3)),
        roll=_tilt(rng),
        pitch=_tilt(rng),
        open_voltage=float(rng.uniform(*OPEN_VOLTAGE)) * (supply / SUPPLY),
        resistance=float(rng.uniform(*RESISTANCE)),
        gyro_bias=_three(rng.normal(0.0, GYRO_BIAS, 3)),
        firmware_gain=firmware_gain,
        types=types,
        **delays,
    )


def _three(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _tilt(rng: Generator) -> float:
    return float(rng.uniform(*HELD_TILT) * rng.choice((-1.0, 1.0)))


def parameters_of(
    truth: RobotTruth, servos: tuple[str, ...], trunk_mass: float, trunk_com: tuple[float, float, float]
) -> dict[str, float]:
    """The truth by parameter name, as it stands in the recording.

    Args:
        truth: of the robot.
        servos: classes of the model.
        trunk_mass: of this robot's trunk [kg].
        trunk_com: of this robot's trunk [m], trunk frame.
    """
    found: dict[str, float] = {}
    for name in servos:
        found |= _of_servo(truth, name)
    found |= {
        f"sensor.{channel}_delay": getattr(truth, f"{channel}_delay")
        for channel in ("position", "velocity", "gyro", "orientation")
    }
    found |= {f"{joint}.zero": zero for joint, zero in (truth.zeros or {}).items()}
    found |= {"trunk.mass": trunk_mass, "trunk.mass_scale": truth.trunk_mass}
    found |= {f"trunk.com_{axis}": one for axis, one in zip("xyz", trunk_com, strict=True)}
    found |= {f"trunk.com_shift_{axis}": one for axis, one in zip("xyz", truth.trunk_com, strict=True)}
    if truth.base == "fixed":
        found |= {"trunk.roll": truth.roll, "trunk.pitch": truth.pitch}
    found |= {"supply.voltage": truth.open_voltage, "supply.resistance": truth.resistance}
    found |= {f"imu.gyro_bias_{axis}": one for axis, one in zip("xyz", truth.gyro_bias, strict=True)}
    return found


def _of_servo(truth: RobotTruth, name: str) -> dict[str, float]:
    one, by = truth.servo(name), (truth.scales or {}).get(name, Scales())
    law = one.friction
    return {
        f"{name}.gain_scale": by.gain,
        f"{name}.damping_scale": by.damping,
        f"{name}.friction_scale": by.friction,
        f"{name}.delay": truth.command_delay,
        f"{name}.kp": one.kp(),
        f"{name}.forcerange": one.force_limit(),
        f"{name}.damping": one.damping(),
        f"{name}.damping_off": law.viscous,
        f"{name}.armature": one.armature,
        f"{name}.frictionloss": law.coulomb,
        f"{name}.stribeck": law.stribeck,
        f"{name}.load_motor": law.load_motor,
        f"{name}.load_external": law.load_external,
        f"{name}.load_motor_stribeck": law.load_motor_stribeck,
        f"{name}.load_external_stribeck": law.load_external_stribeck,
        f"{name}.stribeck_speed": law.stribeck_speed,
        f"{name}.stribeck_exponent": law.stribeck_exponent,
    }

"""One candidate for a servo on the bench: every number a simulation of it takes, in MuJoCo's terms."""

from dataclasses import astuple, dataclass, fields

import numpy as np

from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.recording import FloatArray

NO_LIMIT = 1e6  # [rad/s] stands for "no goal speed limit"


@dataclass(frozen=True)
class ServoValues:
    """One candidate; the defaults switch everything beyond the Coulomb-viscous servo (M1) off.

    Attributes:
        kp: position gain [N m/rad] at the servo's stated supply and firmware gain.
        forcerange: torque limit [N m] at the stated supply.
        damping: powered, with back-EMF [N m s/rad].
        damping_off: with the motor switched off [N m s/rad]; the law's K_v.
        frictionloss: Coulomb friction K_c [N m].
        armature: [kg m^2].
        delay: of commands [s].
        offset: encoder reading with the arm hanging straight down [rad].
        stribeck ... stribeck_exponent: see `calibration.friction.Friction`.
        sag: share of the supply lost at stall, from the resistance of battery and leads.
        rest: 1 where kp and force limit are those of the unloaded supply, as beside a sag; 0 of the median.
        follow: share of the measured changes of the supply that reach the motor.
        goal_speed: speed limit of the firmware's own goal profile [rad/s].
        punch: error [rad] that the firmware adds once there is any (error-dependent gain).
        dead_zone: error [rad] without effect, such as backlash between motor and horn.
        collapse_at: error [rad] beyond which the firmware holds back ...
        collapse_to: ... to this share of the torque.
        loop_lag: age of the angle that the firmware's loop acts on [s].
        drag: torque that grows with the square of the speed [N m s^2/rad^2]; below zero the damping thins out.
        bias: constant torque [N m].
    """

    kp: float
    forcerange: float
    damping: float
    damping_off: float
    frictionloss: float
    armature: float
    delay: float
    offset: float
    stribeck: float = 0.0
    load_motor: float = 0.0
    load_external: float = 0.0
    load_motor_stribeck: float = 0.0
    load_external_stribeck: float = 0.0
    quad_motor: float = 0.0
    quad_external: float = 0.0
    stribeck_speed: float = 1.0
    stribeck_exponent: float = 1.0
    sag: float = 0.0
    rest: float = 0.0
    follow: float = 0.0
    goal_speed: float = NO_LIMIT
    punch: float = 0.0
    dead_zone: float = 0.0
    collapse_at: float = 100.0
    collapse_to: float = 1.0
    loop_lag: float = 0.0
    drag: float = 0.0
    bias: float = 0.0

    def array(self) -> FloatArray:
        """The numbers in the order of `FIELDS`, shape (len(FIELDS),)."""
        return np.array(astuple(self))

    def friction(self) -> Friction:
        """The friction law of this candidate."""
        shared = {name: getattr(self, name) for name in FRICTION_FIELDS if name != "coulomb"}
        return Friction(viscous=self.damping_off, coulomb=self.frictionloss, **shared)


FIELDS = tuple(one.name for one in fields(ServoValues))
COLUMN = {name: i for i, name in enumerate(FIELDS)}

r"""The firmware voltage law of position-controlled hobby servos.

With supply voltage V, firmware gain P, error gain e [duty per rad per unit of P], duty
limit u_max, torque constant kt and winding resistance R (design.md, "The servo, in symbols"):

.. math::
    duty = clip(e P (q_{goal} - q), \pm u_{max}), \qquad
    \tau_m = \frac{k_t}{R} (duty \cdot V - k_t \dot q)

In MuJoCo terms: kp = e P V kt/R, force range = u_max V kt/R, damping = K_v + kt^2/R.
"""

import math
from dataclasses import dataclass

from frasa_sysid.calibration.friction import Friction

Limits = tuple[tuple[str, tuple[float, float]], ...]


@dataclass(frozen=True)
class Servo:
    """A servo type: firmware constants, and electrical and friction numbers somebody published.

    Attributes:
        name: in lower case, such as `mx106`.
        error_gain: e [duty per rad per unit of firmware gain].
        max_duty: u_max.
        kt: torque constant [N m/A] at the output.
        R: winding resistance [Ohm].
        armature: rotor inertia at the output [kg m^2].
        friction: friction law that belongs to kt and R.
        supply_voltage: V at which `kp()` and `force_limit()` are stated by default [V].
        firmware_gain: P likewise.
        source: where the numbers come from.
        ticks_per_turn: of its encoder.
        supply_compensated: the firmware makes up for the supply: neither gain nor torque limit follow it.
        limits: name, and lowest and highest value, of those of kt, R, armature, viscous and coulomb that somebody
            knows bounds of; the others are looked for within wide multiples of the number itself.
    """

    name: str
    error_gain: float
    max_duty: float
    kt: float
    R: float
    armature: float
    friction: Friction
    supply_voltage: float
    firmware_gain: float
    source: str
    ticks_per_turn: float = 4096.0
    supply_compensated: bool = False
    limits: Limits = ()

    def torque_per_volt(self) -> float:
        """kt/R [N m/V]."""
        return self.kt / self.R

    def kp(self) -> float:
        """Position gain at the stated supply and firmware gain [N m/rad]."""
        return self.error_gain * self.firmware_gain * self.supply_voltage * self.torque_per_volt()

    def force_limit(self) -> float:
        """Torque limit at the stated supply [N m]."""
        return self.max_duty * self.supply_voltage * self.torque_per_volt()

    def damping(self) -> float:
        """Viscous friction plus back-EMF of the powered motor [N m s/rad]."""
        return self.friction.viscous + self.kt**2 / self.R

    def span(self, name: str) -> tuple[float, float] | None:
        """Bounds of a number of the MuJoCo joint and actuator that follow from `limits`; None where nothing does.

        Args:
            name: `kp`, `forcerange`, `damping`, `damping_off`, `frictionloss` or `armature`.
        """
        alone = {"damping_off": "viscous", "frictionloss": "coulomb", "armature": "armature"}
        limits = dict(self.limits)
        if name in alone:
            return limits.get(alone[name])
        if not {"kt", "R"} & limits.keys():
            return None
        (kt_low, kt_high), (r_low, r_high) = (limits.get(one, (getattr(self, one),) * 2) for one in ("kt", "R"))
        if name in ("kp", "forcerange"):
            now, here = (self.kp() if name == "kp" else self.force_limit()), self.torque_per_volt()
            return now * kt_low / r_high / here, now * kt_high / r_low / here
        if name == "damping":
            low, high = limits.get("viscous", (0.0, 20.0 * self.friction.viscous))
            return low + kt_low**2 / r_high, high + kt_high**2 / r_low
        return None

    def problems(self) -> str:
        """What no servo can have, in words; empty where all is well."""
        positive = ("error_gain", "kt", "R", "armature", "supply_voltage", "firmware_gain", "ticks_per_turn")
        for name in positive:
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                return f"{name} = {getattr(self, name):g}, expected a number above 0"
        if not 0.0 < self.max_duty <= 1.0:
            return f"max_duty = {self.max_duty:g}, expected a share of the full PWM, above 0 and at most 1"
        return ""

r"""The firmware voltage law of position-controlled hobby servos, and what is published about each.

With supply voltage V, firmware gain P, error gain e [duty per rad per unit of P], duty
limit u_max, torque constant kt and winding resistance R (design.md, "The servo, in symbols"):

.. math::
    duty = clip(e P (q_{goal} - q), \pm u_{max}), \qquad
    \tau_m = \frac{k_t}{R} (duty \cdot V - k_t \dot q)

In MuJoCo terms: kp = e P V kt/R, force range = u_max V kt/R, damping = K_v + kt^2/R.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from frasa_sysid.calibration.friction import Friction
from frasa_sysid.errors import UsageError


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


_BAM = "Rhoban/bam (Apache-2.0), package better-actuator-models 1.0.2, params/"

# Coulomb-viscous (M1) numbers: what fits start from and what "nominal" means for servos the robot has not.
NOMINAL: Mapping[str, Servo] = MappingProxyType(
    {
        one.name: one
        for one in (
            Servo(
                "mx106", 0.158, 0.9625, 2.1913757, 2.9649904, 0.02660923, Friction(0.03520238, 0.10352027), 15.0, 12.0,
                _BAM + "mx106/m1.json",
            ),
            Servo(
                "mx64", 0.158, 0.9625, 1.6224668, 3.9494337, 0.01195124, Friction(0.01169160, 0.09038677), 15.0, 12.0,
                _BAM + "mx64/m1.json",
            ),
            Servo(
                # error gain from the encoder and the PWM scale of the firmware: (4096 / 2 pi) / (256 * 885)
                "xl330", 0.00287735, 1.0, 0.3866958, 4.0171292, 0.001814167, Friction(0.003661672, 0.01283272), 7.4,
                400.0, _BAM + "xl330/m1.json",
            ),
            Servo(
                "sts3215", 0.166, 0.97, 1.2116414, 2.6761663, 0.02840336, Friction(0.05908516, 0.05239285), 12.0, 16.0,
                _BAM + "feetech_sts3215_7_4V/m1.json (identified on the 7.4 V version)",
            ),
            Servo(
                # 4.9 N m stall and 7.85 rad/s at 12 V: kt = V / speed, R = kt V / stall
                "sts3250", 0.166, 0.97, 1.529, 3.744, 0.02840336, Friction(0.05908516, 0.05239285), 12.0, 32.0,
                "Feetech STS3250 datasheet (stall torque, no-load speed); friction, armature and firmware as sts3215",
            ),
            Servo(
                # 2.45 N m stall and 6.5 rad/s (25 kg cm, 0.16 s for 60 deg) as sold; the gain is a round start
                "miuzei", 18.0, 1.0, 0.923, 2.26, 0.01, Friction(0.02, 0.05), 6.0, 1.0,
                "Miuzei 25 kg cm hobby servo as sold: stall torque and speed; the rest are starting values",
            ),
            Servo(
                # a linear axis whose force is known: only mass [kg], damping [N s/m] and friction [N] are fitted
                "emps", 1.0, 1.0, 1e-3, 1e-5, 60.0, Friction(100.0, 10.0), 1.0, 1.0,
                "EMPS prismatic drive (Janot, Gautier, Brunot 2019); round starting values",
            ),
        )
    }
)  # fmt: skip

# M4 numbers: the truth of the simulated bench logs.
PUBLISHED_M4: Mapping[str, Servo] = MappingProxyType(
    {
        one.name: one
        for one in (
            Servo(
                "mx106", 0.158, 0.9625, 2.23138890457851, 2.3717487904639545, 0.02457397334336701,
                Friction(
                    viscous=0.05096082506010955, coulomb=6.653380436533205e-13, stribeck=0.10491060771568866,
                    load_motor=0.009150334028953775, load_external=0.009150334028953775,
                    load_motor_stribeck=0.22235912179095094, load_external_stribeck=0.22235912179095094,
                    stribeck_speed=1.6232949773728853, stribeck_exponent=1.323485668999259,
                ),
                15.0, 12.0, _BAM + "mx106/m4.json",
            ),
            Servo(
                "mx64", 0.158, 0.9625, 1.6631556605652682, 3.1560000816605682, 0.010961212217454795,
                Friction(
                    viscous=0.014754905791636505, coulomb=0.061549466501679174, stribeck=0.02389528618121147,
                    load_motor=1.9611119490261663e-10, load_external=1.9611119490261663e-10,
                    load_motor_stribeck=0.23428996680337053, load_external_stribeck=0.23428996680337053,
                    stribeck_speed=1.5205782308422509, stribeck_exponent=1.3344007931759223,
                ),
                15.0, 12.0, _BAM + "mx64/m4.json",
            ),
        )
    }
)  # fmt: skip


def servo(name: str, table: Mapping[str, Servo] = NOMINAL) -> Servo:
    """The servo of that name.

    Raises:
        UsageError: unknown; the message lists the known ones.
    """
    if name not in table:
        raise UsageError(f"unknown servo '{name}': known are {', '.join(sorted(table))}")
    return table[name]

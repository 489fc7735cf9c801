r"""Friction of a geared servo: one law with six nested forms, from Coulomb-viscous (M1) to quadratic (M6).

Duclusaud, Passault, Padois, Ly: "Extended Friction Models for the Physics Simulation of
Servo Actuators", arXiv 2410.08650. With motor torque :math:`\tau_m`, external torque
:math:`\tau_e`, speed :math:`\dot q` and :math:`s = e^{-|\dot q / \dot q_s|^\alpha}`, friction
stops the joint as far as its bound allows:

.. math::
    \tau_f^{max} = K_v |\dot q| + K_c + |K_e \tau_e - K_m \tau_m|
                   + s (K_{cs} + |K_{es} \tau_e - K_{ms} \tau_m| + Q)

where Q acts while motor and load pull against each other, :math:`\tau_m \tau_e < 0`:
:math:`Q_e \tau_e^2` while the motor is the stronger, :math:`Q_m \tau_m^2` while the load is.

==== ==================================== =================================================
law  name                                 beyond M1
==== ==================================== =================================================
M1   Coulomb-viscous                      K_v, K_c
M2   Stribeck                             K_cs, dq_s, alpha
M3   load-dependent                       K_m = K_e
M4   Stribeck and load-dependent          K_cs, dq_s, alpha, K_m = K_e, K_ms = K_es
M5   directional                          as M4, motor and load apart
M6   quadratic                            as M5, and Q_m, Q_e
==== ==================================== =================================================
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from numba import njit

from frasa_sysid.calibration.errors import UsageError
from frasa_sysid.calibration.fast_math import fast_exp2, fast_log2, fma

FloatArray = npt.NDArray[np.float64]
LAWS = ("m1", "m2", "m3", "m4", "m5", "m6")
LOG2_LOG2_E = math.log2(math.log2(math.e))

# Coefficients each law has beyond the viscous and the Coulomb one, and (after `=`) those that follow another.
_STRIBECK = ("stribeck", "stribeck_speed", "stribeck_exponent")
_LOAD = ("load_motor", "load_external=load_motor")
_LOAD_STRIBECK = ("load_motor_stribeck", "load_external_stribeck=load_motor_stribeck")
_DIRECTIONAL = ("load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck")
COEFFICIENTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "m1": (),
        "m2": _STRIBECK,
        "m3": _LOAD,
        "m4": (*_STRIBECK, *_LOAD, *_LOAD_STRIBECK),
        "m5": (*_STRIBECK, *_DIRECTIONAL),
        "m6": (*_STRIBECK, *_DIRECTIONAL, "quad_motor", "quad_external"),
    }
)


@dataclass(frozen=True)
class Friction:
    """Coefficients of the law; those left at zero turn it into a simpler one.

    Attributes:
        viscous: K_v [N m s/rad].
        coulomb: K_c [N m].
        stribeck: K_cs [N m], extra at standstill.
        load_motor, load_external: K_m, K_e, shares of the motor's and of the load's torque.
        load_motor_stribeck, load_external_stribeck: K_ms, K_es, extra shares at standstill.
        quad_motor, quad_external: Q_m, Q_e [1/(N m)].
        stribeck_speed: dq_s [rad/s].
        stribeck_exponent: alpha.
    """

    viscous: float
    coulomb: float
    stribeck: float = 0.0
    load_motor: float = 0.0
    load_external: float = 0.0
    load_motor_stribeck: float = 0.0
    load_external_stribeck: float = 0.0
    quad_motor: float = 0.0
    quad_external: float = 0.0
    stribeck_speed: float = 1.0
    stribeck_exponent: float = 1.0

    def bound(self, motor: FloatArray, external: FloatArray, speed: FloatArray) -> FloatArray:
        """Largest friction torque [N m], the viscous part included; arguments and result of one shape.

        Args:
            motor: motor torque at the output [N m].
            external: external torque, such as gravity [N m], positive in the motor's direction.
            speed: joint speed [rad/s].
        """
        fade = np.exp(-(np.abs(speed / self.stribeck_speed) ** self.stribeck_exponent))
        loaded = np.abs(self.load_external * external - self.load_motor * motor)
        static = np.abs(self.load_external_stribeck * external - self.load_motor_stribeck * motor)
        driving = np.abs(motor) > np.abs(external)
        squared = np.where(driving, self.quad_external * external**2, self.quad_motor * motor**2)
        squared = np.where(motor * external < 0.0, squared, 0.0)
        return np.asarray(
            self.viscous * np.abs(speed) + self.coulomb + loaded + fade * (self.stribeck + static + squared)
        )

    def changed(self, coefficients: Mapping[str, float]) -> "Friction":
        """The law with other coefficients; where motor and load share one (M3, M4), the load's follows the motor's.

        Args:
            coefficients: by attribute; a load's own is kept apart where it is given.
        """
        followers = {
            f"load_external{suffix}": coefficients[f"load_motor{suffix}"]
            for suffix in ("", "_stribeck")
            if f"load_motor{suffix}" in coefficients
            and getattr(self, f"load_motor{suffix}") == getattr(self, f"load_external{suffix}")
        }
        return replace(self, **{**followers, **coefficients})

    def coefficients(self) -> FloatArray:
        """What `friction_loss` takes, in its order, shape (10,)."""
        return np.array([getattr(self, name) for name in FIELDS])


FIELDS = tuple(one.name for one in fields(Friction) if one.name != "viscous")


def law_of(friction: Friction) -> str:
    """The simplest of the six laws that has these coefficients."""
    for law in LAWS:
        own = {"coulomb", *(name.partition("=")[0] for name in COEFFICIENTS[law])}
        tied = [name.split("=") for name in COEFFICIENTS[law] if "=" in name]
        extra = [name for name in FIELDS if name not in own and not name.startswith("stribeck_")]
        if all(getattr(friction, name) == 0.0 for name in extra) and all(
            getattr(friction, name) == getattr(friction, other) for name, other in tied
        ):
            return law
    return LAWS[-1]


def check_law(law: str) -> str:
    """The law's name, if there is one of that name.

    Raises:
        UsageError: there is none.
    """
    if law not in LAWS:
        raise UsageError(f"unknown friction law '{law}': expected {', '.join(LAWS)}")
    return law


@njit(inline="always")
def stribeck_fade(speed: float, exponent: float, shift: float) -> float:
    """S of the law: 1 at standstill, falling with speed [rad/s].

    Args:
        speed: joint speed [rad/s].
        exponent: alpha.
        shift: log2(log2 e) - alpha log2(stribeck_speed), which is constant while speeds change.
    """
    return fast_exp2(-fast_exp2(fma(exponent, fast_log2(abs(speed)), shift)))


@njit(inline="always")
def faded_loss(
    motor: float,
    external: float,
    fade: float,
    coulomb: float,
    stribeck: float,
    load_motor: float,
    load_external: float,
    load_motor_stribeck: float,
    load_external_stribeck: float,
    quad_motor: float,
    quad_external: float,
) -> float:
    """The law without its viscous part [N m], its `stribeck_fade` given."""
    loaded = abs(fma(load_external, external, -load_motor * motor))
    static = abs(fma(load_external_stribeck, external, -load_motor_stribeck * motor))
    squared = quad_external * external * external if abs(motor) > abs(external) else quad_motor * motor * motor
    squared = squared if motor * external < 0.0 else 0.0
    return fma(fade, stribeck + static + squared, coulomb + loaded)


@njit(inline="always")
def friction_loss(
    motor: float,
    external: float,
    speed: float,
    coulomb: float,
    stribeck: float,
    load_motor: float,
    load_external: float,
    load_motor_stribeck: float,
    load_external_stribeck: float,
    quad_motor: float,
    quad_external: float,
    stribeck_speed: float,
    stribeck_exponent: float,
) -> float:
    """The law without its viscous part [N m], for compiled code; branch-free, so that it vectorises.

    The viscous part is not in the bound but in the joint's damping, as in MuJoCo.
    """
    shift = LOG2_LOG2_E - stribeck_exponent * fast_log2(stribeck_speed)
    return faded_loss(
        motor,
        external,
        stribeck_fade(speed, stribeck_exponent, shift),
        coulomb,
        stribeck,
        load_motor,
        load_external,
        load_motor_stribeck,
        load_external_stribeck,
        quad_motor,
        quad_external,
    )

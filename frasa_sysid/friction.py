r"""Friction of a geared servo, one nested law from Coulomb-viscous (M1) to load-dependent Stribeck (M4).

Duclusaud, Passault, Padois, Ly: "Extended Friction Models for the Physics Simulation of
Servo Actuators", arXiv 2410.08650. With motor torque :math:`\tau_m`, external torque
:math:`\tau_e` and speed :math:`\dot q` the friction torque is bounded by

.. math::
    \tau_f^{max} = K_v |\dot q| + K_c + K_l |\tau_m - \tau_e|
                   + e^{-|\dot q / \dot q_s|^\alpha} (K_{cs} + K_{ls} |\tau_m - \tau_e|)

and, within that bound, stops the joint. M1 keeps K_v and K_c; M2 adds K_cs; M3 adds K_l; M4 has all.
"""

from dataclasses import dataclass

import numpy as np

from frasa_sysid.recording import FloatArray


@dataclass(frozen=True)
class Friction:
    """Coefficients of the law; those left at zero turn it into a simpler one.

    Attributes:
        viscous: K_v [N m s/rad].
        coulomb: K_c [N m].
        stribeck: K_cs [N m], extra at standstill.
        load: K_l, share of the load.
        load_stribeck: K_ls, extra share at standstill.
        stribeck_speed: dq_s [rad/s].
        stribeck_exponent: alpha.
    """

    viscous: float
    coulomb: float
    stribeck: float = 0.0
    load: float = 0.0
    load_stribeck: float = 0.0
    stribeck_speed: float = 1.0
    stribeck_exponent: float = 1.0

    def bound(self, motor: FloatArray, external: FloatArray, speed: FloatArray) -> FloatArray:
        """Largest friction torque [N m], all arguments and the result of one shape.

        Args:
            motor: motor torque at the output [N m].
            external: external torque, such as gravity [N m], positive in the motor's direction.
            speed: joint speed [rad/s].
        """
        load = np.abs(motor - external)
        decay = np.exp(-(np.abs(speed / self.stribeck_speed) ** self.stribeck_exponent))
        static = self.coulomb + self.load * load + decay * (self.stribeck + self.load_stribeck * load)
        return np.asarray(self.viscous * np.abs(speed) + static)

r"""Training without the friction laws M2 to M6 of a calibrated model: constant dry friction in their place.

`frasa-sysid publish --as m1` fits all numbers of the Coulomb-viscous servo that stands in best; a published model
does not carry those. Here only the dry friction is exchanged, damping, gain and the rest stay: the constant that turns
as much work into heat as the law does, without its viscous part, over the speeds and loads a robot sees:

.. math:: F_c = \frac{\iint (\tau_f^{max}(\tau, -\tau, v) - K_v v)\, v\, dv\, d\tau}{\iint v\, dv\, d\tau}

with speeds :math:`v` from 0 to the task's rate limit, and motor and load pulling against each other with torques
:math:`\tau` from 0 to a quarter of the torque limit (the loads of our benches: 0.06 to 0.29 of it).
At standstill, where a law with a Stribeck part holds a joint harder, the stand-in is too weak.
"""

import mujoco
import numpy as np

from frasa_sysid.calibration import actuators_of, dofs_of, servo_classes, servo_law
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.calibration.parameters import LAW_COEFFICIENTS, LAW_FIELDS

LOAD_SHARE = 0.25  # of the torque limit
_ASIDE = "_law_aside"  # ending of the custom numbers once the law is off
_SPEEDS, _LOADS = 64, 16


def put_aside(spec: mujoco.MjSpec) -> None:
    """Take the friction laws of a model out of action before it is compiled; their coefficients stay in it."""
    for one in spec.numerics:
        if one.name.endswith(servo_law.SUFFIX) and len(one.data) == servo_law.NUMBERS:
            one.name = one.name.removesuffix(servo_law.SUFFIX) + _ASIDE


def laws_aside(model: mujoco.MjModel) -> dict[str, Friction]:
    """The laws that were put aside, by servo class."""
    found = {}
    for servo in servo_classes(model):
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, servo + _ASIDE)
        if index >= 0:
            start = int(model.numeric_adr[index])
            values = model.numeric_data[start : start + servo_law.NUMBERS]
            found[servo] = Friction(*(float(one) for one in values))
    return found


def dry_friction(law: Friction, torque_limit: float, speed: float) -> float:
    """The constant friction that stands in for a law [N m].

    Args:
        law: its coefficients.
        torque_limit: of the servo [N m].
        speed: the largest that is looked at [rad/s].
    """
    speeds = speed * (np.arange(_SPEEDS)[:, None] + 0.5) / _SPEEDS
    loads = LOAD_SHARE * torque_limit * (np.arange(_LOADS)[None] + 0.5) / _LOADS
    dry = law.bound(loads, -loads, speeds) - law.viscous * speeds
    return float((dry * speeds).sum() / (speeds.sum() * _LOADS))


def stand_in(model: mujoco.MjModel, speed: float) -> None:
    """Give the servos whose law was put aside the friction that stands in for it, in place."""
    for servo, law in laws_aside(model).items():
        actuators = actuators_of(model, servo)
        limit = float(model.actuator_forcerange[actuators[0], 1])
        model.dof_frictionloss[dofs_of(model, actuators)] = dry_friction(law, limit, speed)


class StandIns:
    """Turns drawn coefficients of laws that were put aside into the friction that stands in for them.

    Args:
        model: compiled; torque limits are those it has now.
        speed: the largest that is looked at [rad/s].
    """

    def __init__(self, model: mujoco.MjModel, speed: float) -> None:
        self._laws, self._speed = laws_aside(model), speed
        self._limits = {
            servo: float(model.actuator_forcerange[actuators_of(model, servo)[0], 1]) for servo in self._laws
        }

    def exchange(self, drawn: dict[str, float]) -> dict[str, float]:
        """What was drawn, with `<servo>.frictionloss` in place of all numbers of its law."""
        kept = dict(drawn)
        for servo, law in self._laws.items():
            given = {name: kept.pop(f"{servo}.{name}") for name in _FIELDS if f"{servo}.{name}" in kept}
            if given:
                changed = law.changed({LAW_COEFFICIENTS[name]: value for name, value in given.items()})
                kept[f"{servo}.frictionloss"] = dry_friction(changed, self._limits[servo], self._speed)
        return kept


_FIELDS = ("frictionloss", *LAW_FIELDS)

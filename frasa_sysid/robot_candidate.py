"""What a whole-robot fit changes, and how it is written into a model: zeros, scales, the trunk.

Zeros and trunk are written as published models have them (`calibration.bodies`), scales as `robot_numbers` says.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import mujoco

from frasa_sysid.calibration import (
    actuators_of,
    bodies,
    dofs_of,
    number,
    read,
    servo_classes,
    servo_law,
    stepping,
    trunk_of,
)
from frasa_sysid.calibration.apply import PRESENT_SUPPLY
from frasa_sysid.calibration.parameters import LAW_COEFFICIENTS
from frasa_sysid.robot_numbers import SCALES

_TORQUES = tuple(LAW_COEFFICIENTS[name] for name in SCALES["friction_scale"])


@dataclass(frozen=True)
class Candidate:
    """Numbers of one simulated robot.

    Attributes:
        command_delay: [s].
        command_delays: of single servo classes by name, where it is another one [s].
        zeros: of joints by name [rad]; those not named are zero.
        gain, damping, friction: scales of each servo class by name [1], on what the model holds.
        trunk_mass: [kg]; None as the model has it.
        trunk_shift: of the centre of mass from where the model has it [m], shape (3,).
        ages: of channels by name [s].
    """

    command_delay: float = 0.0
    zeros: Mapping[str, float] = field(default_factory=dict)
    gain: Mapping[str, float] = field(default_factory=dict)
    damping: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    trunk_mass: float | None = None
    trunk_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ages: Mapping[str, float] = field(default_factory=dict)
    command_delays: Mapping[str, float] = field(default_factory=dict)


def candidate_of(model: mujoco.MjModel) -> Candidate:
    """The delays that a model itself has, as they are physically; everything else stays in the model.

    A MuJoCo model acts on a command half a step early, and its speeds are half a step old already, so its own
    delays are half a step longer and shorter than these. On a command delay below a step it acts as on a step.

    Args:
        model: with its sensors and histories.
    """
    step = float(model.opt.timestep)

    def acts(name: str) -> float:
        delay = read(model, name)
        return max(delay, step) if delay > 0.0 else 0.0

    ages = {name: acts(f"sensor.{name}_delay") for name in ("position", "velocity", "gyro", "orientation")}
    return Candidate(
        command_delays={servo: acts(f"{servo}.delay") - 0.5 * step for servo in servo_classes(model)},
        ages={name: age + (0.5 * step if name in ("velocity", "gyro") else 0.0) for name, age in ages.items()},
    )


class Writer:
    """Writes candidates into copies of one model.

    Args:
        model: the robot with frozen fits applied; never changed.

    Attributes:
        servos: indices of the actuators of each servo class.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._trunk = model, trunk_of(model)
        self._scratch = mujoco.MjData(model)
        self.servos = {servo: actuators_of(model, servo) for servo in servo_classes(model)}
        self._dofs = {servo: dofs_of(model, actuators) for servo, actuators in self.servos.items()}
        self._laws = {servo: servo_law.law(model, servo) for servo in self.servos}
        self.stated_supply = number(model, "servo_supply_voltage")
        self._held_supply = _supply_of(model)
        self.stated_gain = number(model, "servo_firmware_gain")

    def write(self, model: mujoco.MjModel, one: Candidate, supply: float, firmware_gain: float | None) -> None:
        """Make a copy of the model that candidate's robot at a supply [V] and firmware gain."""
        original = self._model
        volts = supply / self._held_supply
        firmware = (firmware_gain or self.stated_gain) / self.stated_gain
        model.qpos0[:] = original.qpos0
        for name, zero in one.zeros.items():
            bodies.set_zero(model, name, bodies.zero_of(original, name) + zero)
        for servo, actuators in self.servos.items():
            scale = one.gain.get(servo, 1.0) * volts
            gain = original.actuator_gainprm[actuators, 0] * scale * firmware
            model.actuator_gainprm[actuators, 0] = gain
            model.actuator_biasprm[actuators, 1] = -gain
            model.actuator_forcerange[actuators] = original.actuator_forcerange[actuators] * scale
            self._write_friction(model, servo, one.damping.get(servo, 1.0), one.friction.get(servo, 1.0))
        self._write_trunk(model, one)
        mujoco.mj_setConst(model, self._scratch)

    def _write_friction(self, model: mujoco.MjModel, servo: str, damping: float, friction: float) -> None:
        dofs, law = self._dofs[servo], self._laws[servo]
        # From the original each time: what a copy was before must not show, not even in its roundings.
        for name in ("dof_damping", "dof_armature"):
            getattr(model, name)[dofs] = getattr(self._model, name)[dofs]
        stepping.set_damping(model, dofs, self._model.dof_damping[dofs] * damping)
        model.dof_frictionloss[dofs] = self._model.dof_frictionloss[dofs] * friction
        if law is not None:
            scaled = {name: getattr(law, name) * friction for name in _TORQUES}
            servo_law.set_law(model, servo, replace(law, viscous=law.viscous * damping, **scaled))

    def _write_trunk(self, model: mujoco.MjModel, one: Candidate) -> None:
        body, original = self._trunk, self._model
        for name in ("body_mass", "body_inertia", "body_ipos"):
            getattr(model, name)[body] = getattr(original, name)[body]
        if one.trunk_mass is not None:
            bodies.set_trunk(model, body, "mass", one.trunk_mass)
        for axis, shift in zip("xyz", one.trunk_shift, strict=True):
            if shift:
                field = f"com_{axis}"
                bodies.set_trunk(model, body, field, bodies.trunk_number(original, body, field) + shift)


def _supply_of(model: mujoco.MjModel) -> float:
    """Supply [V] that a model's gains and torque limits hold at, which a published one may have changed."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, PRESENT_SUPPLY) >= 0:
        return read(model, "supply_voltage")
    return number(model, "servo_supply_voltage")

"""What a whole-robot fit changes, and how it is written into a model: zeros, scales, the trunk.

A joint's zero z [rad] is what its encoder says too much: measured = true + z. The servo closes its loop
on what it measures, so a model whose angle is the measured one needs only its geometry turned back by z.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from frasa_sysid.calibration import actuators_of, dofs_of, number, read, servo_classes, servo_law
from frasa_sysid.calibration.apply import PRESENT_SUPPLY
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_rig import actuated_joints

_TORQUES = (
    "coulomb", "stribeck", "load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck",
    "quad_motor", "quad_external",
)  # fmt: skip


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
        trunk: its root body.

    Attributes:
        servos: indices of the actuators of each servo class.
    """

    def __init__(self, model: mujoco.MjModel, trunk: int) -> None:
        self._model, self._trunk = model, trunk
        self._scratch = mujoco.MjData(model)
        self.servos = {servo: actuators_of(model, servo) for servo in servo_classes(model)}
        self._dofs = {servo: dofs_of(model, actuators) for servo, actuators in self.servos.items()}
        self._laws = {servo: servo_law.law(model, servo) for servo in self.servos}
        self._joints = dict(zip(actuated_joints(model), model.actuator_trnid[:, 0], strict=True))
        self.stated_supply = number(model, "servo_supply_voltage")
        self._held_supply = _supply_of(model)
        self.stated_gain = number(model, "servo_firmware_gain")

    def write(self, model: mujoco.MjModel, one: Candidate, supply: float, firmware_gain: float | None) -> None:
        """Make a copy of the model that candidate's robot at a supply [V] and firmware gain."""
        original = self._model
        volts = supply / self._held_supply
        firmware = (firmware_gain or self.stated_gain) / self.stated_gain
        model.body_quat[:] = original.body_quat
        for name, zero in one.zeros.items():
            if zero:
                self._turn(model, int(self._joints[name]), -zero)
        for servo, actuators in self.servos.items():
            scale = one.gain.get(servo, 1.0) * volts
            gain = original.actuator_gainprm[actuators, 0] * scale * firmware
            model.actuator_gainprm[actuators, 0] = gain
            model.actuator_biasprm[actuators, 1] = -gain
            model.actuator_forcerange[actuators] = original.actuator_forcerange[actuators] * scale
            self._write_friction(model, servo, one.damping.get(servo, 1.0), one.friction.get(servo, 1.0))
        self._write_trunk(model, one)
        mujoco.mj_setConst(model, self._scratch)

    def _turn(self, model: mujoco.MjModel, joint: int, angle: float) -> None:
        """Turn a joint's body about the joint's own axis."""
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, self._model.jnt_axis[joint], angle)
        body = self._model.jnt_bodyid[joint]
        turned: FloatArray = np.zeros(4)
        mujoco.mju_mulQuat(turned, self._model.body_quat[body], turn)
        model.body_quat[body] = turned

    def _write_friction(self, model: mujoco.MjModel, servo: str, damping: float, friction: float) -> None:
        dofs, law = self._dofs[servo], self._laws[servo]
        model.dof_damping[dofs] = self._model.dof_damping[dofs] * damping
        model.dof_frictionloss[dofs] = self._model.dof_frictionloss[dofs] * friction
        if law is not None:
            scaled = {name: getattr(law, name) * friction for name in _TORQUES}
            servo_law.set_law(model, servo, replace(law, viscous=law.viscous * damping, **scaled))

    def _write_trunk(self, model: mujoco.MjModel, one: Candidate) -> None:
        body, original = self._trunk, self._model
        mass = original.body_mass[body] if one.trunk_mass is None else one.trunk_mass
        model.body_mass[body] = mass
        model.body_inertia[body] = original.body_inertia[body] * mass / original.body_mass[body]
        model.body_ipos[body] = original.body_ipos[body] + np.array(one.trunk_shift)


def _supply_of(model: mujoco.MjModel) -> float:
    """Supply [V] that a model's gains and torque limits hold at, which a published one may have changed."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, PRESENT_SUPPLY) >= 0:
        return read(model, "supply_voltage")
    return number(model, "servo_supply_voltage")

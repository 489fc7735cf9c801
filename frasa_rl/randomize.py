"""One robot an episode: measured ranges where there are any, assumed ones for the rest.

Every draw starts from the stored originals, so nothing accumulates over episodes.
"""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.config import Assumed, Task
from frasa_rl.robot import Robot
from frasa_sysid.calibration import (
    Calibration,
    actuators_of,
    apply,
    dofs_of,
    number,
    read,
    servo_classes,
    servo_law,
    stepping,
)

# What a draw writes to, and what mj_setConst derives from it.
_TOUCHED = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_sameframe",
    "qpos0",  # zeros of joints
    "geom_friction",
    "geom_priority",
    "dof_damping",
    "dof_frictionloss",
    "dof_armature",
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_forcerange",
    "actuator_delay",
    "sensor_delay",
    "numeric_data",  # friction laws, present supply
)


class Randomizer:
    """Writes a randomly drawn robot into a model.

    Args:
        model: changed in place by `draw`; as it is now, it is the original.
        robot: where things are in the model.
        task: holds the assumed ranges.
        calibration: the measured ranges; None for a nominal model.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, task: Task, calibration: Calibration | None) -> None:
        self._model, self._robot, self._ranges = model, robot, task.assumed
        self._calibration = calibration
        self._data = mujoco.MjData(model)
        self._originals = {name: getattr(model, name).copy() for name in _TOUCHED}
        self._servos = {name: actuators_of(model, name) for name in servo_classes(model)}
        # Beyond frictionloss: the Coulomb part of each law.
        laws = {name: servo_law.law(model, name) for name in self._servos} if servo_law.has_law(model) else {}
        self._coulomb = {f"{name}.frictionloss": law.coulomb for name, law in laws.items() if law is not None}
        self._voltage = number(model, "servo_supply_voltage")

    def restore(self) -> None:
        """Make the model the original again."""
        for name, value in self._originals.items():
            getattr(self._model, name)[:] = value
        mujoco.mj_setConst(self._model, self._data)

    def draw(self, rng: Generator) -> dict[str, float]:
        """Write one random robot into the model.

        Returns:
            The numbers drawn, by name: ratios for masses and servos, SI units for the rest.
        """
        for name, value in self._originals.items():
            getattr(self._model, name)[:] = value
        drawn = self._draw_measured(rng)
        if "supply_voltage" not in drawn:
            drawn["supply_voltage"] = self._draw_voltage(rng)
        drawn["floor_friction"] = self._draw_floor(rng)
        drawn["trunk_mass"] = self._draw_trunk(rng, drawn)
        # Masses, frames and armatures have changed: inverse weights and the like follow.
        apply(self._model, self._draw_joint_zeros(rng, drawn))
        return drawn

    def _draw_measured(self, rng: Generator) -> dict[str, float]:
        """Calibrated parameters from their ranges; damping and friction loss by assumed ratios elsewhere."""
        measured = self._calibration.sample(rng) if self._calibration else {}
        ratios = {name: _uniform(rng, getattr(self._ranges, name)) for name in ("damping", "frictionloss")}
        for field, ratio in ratios.items():
            values = getattr(self._model, f"dof_{field}")
            for servo, actuators in self._servos.items():
                dofs = dofs_of(self._model, actuators)
                if f"{servo}.{field}" in measured:
                    continue
                if field == "damping":  # what a joint weighs stays as it is
                    stepping.set_damping(self._model, dofs, values[dofs] * ratio)
                else:
                    values[dofs] *= ratio
        assumed = {name: value * ratios["frictionloss"] for name, value in self._coulomb.items()}
        if assumed or measured:
            apply(self._model, {**assumed, **measured})
        return {**ratios, **measured}

    def _draw_voltage(self, rng: Generator) -> float:
        """Gain and torque limit of a position servo scale with its supply voltage; damping does not."""
        voltage = _uniform(rng, self._ranges.supply_voltage)
        ratio = voltage / self._voltage
        self._model.actuator_gainprm[:, 0] *= ratio
        self._model.actuator_biasprm[:, 1] *= ratio
        self._model.actuator_forcerange *= ratio
        return voltage

    def _draw_floor(self, rng: Generator) -> float:
        friction = _uniform(rng, self._ranges.floor_friction)
        self._model.geom_friction[self._robot.floor, 0] = friction
        # A higher priority makes the floor's friction hold whatever the other geom's is.
        self._model.geom_priority[self._robot.floor] = 1
        return friction

    def _draw_trunk(self, rng: Generator, measured: Mapping[str, float]) -> float:
        """Mass and centre of mass that were not measured, around those of the model; returns the ratio of masses."""
        ratio, trunk = _uniform(rng, self._ranges.trunk_mass), self._robot.trunk
        if "trunk.mass" not in measured:
            self._model.body_mass[trunk] *= ratio
            self._model.body_inertia[trunk] *= ratio
        for axis, name in enumerate(("trunk.com_x", "trunk.com_y", "trunk.com_z")):
            offset = _uniform(rng, self._ranges.trunk_com)
            if name not in measured:
                self._model.body_ipos[trunk, axis] += offset
        return float(self._model.body_mass[trunk] / self._originals["body_mass"][trunk])

    def _draw_joint_zeros(self, rng: Generator, measured: Mapping[str, float]) -> dict[str, float]:
        """Zero errors that were not measured, around those of the model: a servo horn mounted a little off."""
        drawn = {}
        for joint in np.unique(self._model.actuator_trnid[:, 0]):
            name, offset = f"{self._model.joint(joint).name}.zero", _uniform(rng, self._ranges.joint_zero)
            if name not in measured:
                drawn[name] = read(self._model, name) + offset
        return drawn


def _uniform(rng: Generator, assumed: Assumed) -> float:
    return float(rng.uniform(assumed.low, assumed.high))

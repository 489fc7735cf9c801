"""One robot an episode: measured ranges where there are any, assumed ones for the rest.

Every draw starts from the stored originals, so nothing accumulates over episodes.
"""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.assumed_delays import AssumedDelays
from frasa_rl.config import Assumed, Task
from frasa_rl.friction_stand_in import StandIns, laws_aside
from frasa_rl.robot import Robot
from frasa_rl.servo_ratios import FIELDS, ServoRatios, driven
from frasa_rl.supply import assumed_supply, nominal_voltage, scale_supply
from frasa_sysid.calibration import Calibration, assign, read

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

    Raises:
        ModelError: an assumed range does not suit the model.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, task: Task, calibration: Calibration | None) -> None:
        self._model, self._robot, self._ranges = model, robot, task.assumed
        self._calibration = calibration
        measured = set(calibration.ranges) if calibration else set()
        self._data = mujoco.MjData(model)
        self._originals = {name: getattr(model, name).copy() for name in _TOUCHED}
        # Friction laws that the task has put aside are drawn as what stands in for them.
        self._stand_ins = StandIns(model, task.rate_limit) if laws_aside(model) else None
        self._ratios = ServoRatios(model, self._ranges, measured)
        self._delays = AssumedDelays(model, robot, self._ranges, measured)
        self._supply = None if "supply_voltage" in measured else assumed_supply(model, task)
        self._volts = nominal_voltage(model, task)
        joints = [model.joint(int(i)).name for i in np.unique(model.actuator_trnid[driven(model), 0])]
        self._zeros = {f"{name}.zero": read(model, f"{name}.zero") for name in joints}
        others = np.delete(model.geom_priority, robot.floor)
        self._floor_priority = int(others.max(initial=0)) + 1

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
        model = self._model
        for name, value in self._originals.items():
            getattr(model, name)[:] = value
        measured = self._draw_measured(rng)
        drawn = dict(measured) | self._draw_floor(rng)
        self._draw_trunk(rng, measured)
        spreads = {field: self._ratios.draw(rng, field) for field in FIELDS}
        values = self._draw_joint_zeros(rng, measured)
        for one in spreads.values():
            drawn |= one.told
            values |= one.values
        drawn |= values
        assign(model, {**values, **measured})
        for field, one in spreads.items():
            self._ratios.multiply(model, field, one.ratios)
        drawn |= self._draw_supply(rng) | self._delays.draw(rng, model)
        drawn["trunk_mass"] = float(
            model.body_mass[self._robot.trunk] / self._originals["body_mass"][self._robot.trunk]
        )
        mujoco.mj_setConst(model, self._data)  # inverse weights and the like follow masses, frames and armatures
        return drawn

    def _draw_measured(self, rng: Generator) -> dict[str, float]:
        """Calibrated parameters from their ranges, together where the calibration says so."""
        measured = self._calibration.sample(rng) if self._calibration else {}
        return self._stand_ins.exchange(measured) if self._stand_ins else measured

    def _draw_supply(self, rng: Generator) -> dict[str, float]:
        """Told in volts where they are known, else as a ratio."""
        if self._supply is None:
            return {}
        ratio = _uniform(rng, self._supply)
        scale_supply(self._model, ratio)
        return {"supply_voltage": ratio * self._volts} if self._volts is not None else {"supply_ratio": ratio}

    def _draw_floor(self, rng: Generator) -> dict[str, float]:
        """A higher priority makes the floor's friction hold whatever the other geom's is."""
        if self._ranges.floor_friction is None:
            return {}
        friction = _uniform(rng, self._ranges.floor_friction)
        self._model.geom_friction[self._robot.floor, 0] = friction
        self._model.geom_priority[self._robot.floor] = self._floor_priority
        return {"floor_friction": friction}

    def _draw_trunk(self, rng: Generator, measured: Mapping[str, float]) -> None:
        """Mass and centre of mass that were not measured, around those of the model; inertia goes with the mass."""
        model, trunk, ranges = self._model, self._robot.trunk, self._ranges
        if ranges.trunk_mass is not None:
            ratio = _uniform(rng, ranges.trunk_mass)
            if "trunk.mass" not in measured:
                model.body_mass[trunk] *= ratio
                model.body_inertia[trunk] *= ratio
        if ranges.trunk_com is None:
            return
        for axis, name in enumerate(("trunk.com_x", "trunk.com_y", "trunk.com_z")):
            offset = _uniform(rng, ranges.trunk_com)
            if name not in measured:
                model.body_ipos[trunk, axis] += offset

    def _draw_joint_zeros(self, rng: Generator, measured: Mapping[str, float]) -> dict[str, float]:
        """Zero errors that were not measured, around those of the model: a servo horn mounted a little off."""
        one = self._ranges.joint_zero
        if one is None:
            return {}
        offsets = rng.uniform(one.low, one.high, len(self._zeros))
        drawn = zip(self._zeros.items(), offsets, strict=True)
        return {name: zero + float(offset) for (name, zero), offset in drawn if name not in measured}


def _uniform(rng: Generator, assumed: Assumed) -> float:
    return float(rng.uniform(assumed.low, assumed.high))

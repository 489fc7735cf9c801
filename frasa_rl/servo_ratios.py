"""Assumed spreads of damping and dry friction: one ratio for the robot, for each servo class, or for each joint."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.config import AssumedRanges
from frasa_rl.robot import Floats, Indices
from frasa_sysid.calibration import ModelError, actuators_of, dofs_of, servo_classes, servo_law, stepping

Field = Literal["damping", "frictionloss"]
FIELDS: tuple[Field, ...] = ("damping", "frictionloss")
OTHERS = "others"  # what drawn numbers call the servos outside of all classes


@dataclass(frozen=True)
class Drawn:
    """What a draw of one field brought.

    Attributes:
        told: by name.
        ratios: of every driven joint, shape (n,).
        values: `<class>.frictionloss` where it is a number of the class' friction law.
    """

    told: dict[str, float]
    ratios: Floats
    values: dict[str, float]


class ServoRatios:
    """Draws ratios for every driven joint, and multiplies what a model has.

    Args:
        model: as it is now, it is the original.
        ranges: the assumed ones.
        measured: names of the parameters that have a measured range.

    Raises:
        ModelError: joints shall differ in a friction that belongs to their class' law.
    """

    def __init__(self, model: mujoco.MjModel, ranges: AssumedRanges, measured: Collection[str]) -> None:
        groups = _groups(model)
        self._classes = list(groups)
        self._dofs = np.concatenate([*groups.values(), np.zeros(0, dtype=np.int64)])
        self._class_of = np.repeat(np.arange(len(groups)), [len(dofs) for dofs in groups.values()])
        names = {int(model.jnt_dofadr[i]): model.joint(i).name for i in range(model.njnt)}
        self._joints = [names[int(dof)] for dof in self._dofs]
        self._shared = {"damping": ranges.damping, "frictionloss": ranges.frictionloss}
        self._own = {"damping": ranges.joint_damping, "frictionloss": ranges.joint_frictionloss}
        self._measured = {
            field: np.array([f"{name}.{field}" in measured for name in groups], dtype=bool) for field in FIELDS
        }
        laws = {name: servo_law.law(model, name) for name in groups} if servo_law.has_law(model) else {}
        self._coulomb = {name: law.coulomb for name, law in laws.items() if law is not None}
        self._lawful = np.array([name in self._coulomb for name in groups], dtype=bool)
        self._check_laws()

    def draw(self, rng: Generator, field: Field) -> Drawn:
        """Draw one field for every joint."""
        told, shared = self._draw_shared(rng, field)
        first = {name: int(np.flatnonzero(self._class_of == i)[0]) for i, name in enumerate(self._classes)}
        of_laws = {
            f"{name}.{field}": self._coulomb[name] * float(shared[first[name]])
            for name, measured in zip(self._classes, self._measured[field], strict=True)
            if field == "frictionloss" and name in self._coulomb and not measured
        }
        own = self._own[field]
        if own is None:
            return Drawn(told, shared, of_laws)
        each = rng.uniform(own.low, own.high, len(self._dofs))
        more = {f"joint_{field}.{name}": float(one) for name, one in zip(self._joints, each, strict=True)}
        return Drawn({**told, **more}, shared * each, of_laws)

    def multiply(self, model: mujoco.MjModel, field: Field, ratios: Floats) -> None:
        """Apply ratios, shape (n,), to what the model has; an armature stays what it is."""
        values = getattr(model, f"dof_{field}")
        if field == "damping":
            stepping.set_damping(model, self._dofs, values[self._dofs] * ratios)
        else:  # a law's own number was set with the law
            values[self._dofs] *= np.where(self._lawful[self._class_of], 1.0, ratios)

    def _draw_shared(self, rng: Generator, field: Field) -> tuple[dict[str, float], Floats]:
        """Ratios of everything that was not measured; those of measured classes are 1."""
        spread = self._shared[field]
        if spread is None:
            return {}, np.ones(len(self._dofs))
        kinds: dict[str, tuple[list[str], Indices]] = {
            "robot": ([field], np.zeros(len(self._dofs), dtype=np.int64)),
            "class": ([f"{field}.{name}" for name in self._classes], self._class_of),
            "joint": ([f"{field}.{name}" for name in self._joints], np.arange(len(self._dofs))),
        }
        names, which = kinds[spread.per]
        each = rng.uniform(spread.low, spread.high, len(names))
        told = dict(zip(names, each.tolist(), strict=True))
        return told, np.where(self._measured[field][self._class_of], 1.0, each[which])

    def _check_laws(self) -> None:
        shared = self._shared["frictionloss"]
        by_joint = shared is not None and shared.per == "joint"
        wanted = self._lawful & ~self._measured["frictionloss"] if by_joint else np.zeros_like(self._lawful)
        wanted = self._lawful if self._own["frictionloss"] is not None else wanted
        if wanted.any():
            names = ", ".join(name for name, one in zip(self._classes, wanted, strict=True) if one)
            raise ModelError(
                f"assumed dry friction differs by joint, but {names} has a friction law, which all joints of a class "
                "share: set physics.friction_law to coulomb_viscous, or the spread per class"
            )


def driven(model: mujoco.MjModel) -> Indices:
    """Actuators that are position servos of hinges, shape (n,)."""
    found = [
        index
        for index in range(model.nu)
        if model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_JOINT
        and model.jnt_type[model.actuator_trnid[index, 0]] == mujoco.mjtJoint.mjJNT_HINGE
        and model.actuator_biasprm[index, 1] < 0.0
    ]
    return np.array(found, dtype=np.int64)


def _groups(model: mujoco.MjModel) -> dict[str, Indices]:
    """Degrees of freedom by servo class, those of no class last."""
    classes = {name: actuators_of(model, name) for name in servo_classes(model)}
    listed = np.concatenate([*classes.values(), np.zeros(0, dtype=np.int64)])
    rest = np.setdiff1d(driven(model), listed)
    groups = {name: dofs_of(model, actuators) for name, actuators in classes.items()}
    return groups if not rest.size else {**groups, OTHERS: dofs_of(model, rest)}

"""A foreign humanoid's model looked at: what of it can be trained, and what would be in the way, in one line each."""

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import mujoco
import numpy as np

from frasa_rl.own_checks import check_actuators, check_collision, floor_of, limits_of
from frasa_sysid.calibration import (
    ModelError,
    UsageError,
    actuators_of,
    calibration_id,
    load_model,
    number,
    servo_classes,
)
from frasa_sysid.calibration.anatomy import Hinge, hinges, trunk_body

SERVO_NAME = re.compile(r"[a-z][a-z0-9_]*")
# Where a model has 0: hobby servos run at about 6 rad/s without load, lose some 1.3 % of their stall torque to dry
# friction, and their rotors take some 30 ms against their damping.
_SPEED, _DRY, _RISE = 6.0, 0.013, 0.03
_CARRIES = 0.08  # share of the mass above which a joint on the midline is worth moving


@dataclass(frozen=True)
class OwnServo:
    """A servo class as the model has it.

    Attributes:
        name: of the class.
        kp: [N m/rad].
        force: torque limit [N m].
        damping, friction, armature: of the joint [N m s/rad, N m, kg m^2].
        guessed: which of these are 0 in the model and were guessed, since fits and ranges are multiples of them.
    """

    name: str
    kp: float
    force: float
    damping: float
    friction: float
    armature: float
    guessed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Looked:
    """A robot that can be trained.

    Attributes:
        path: of its model.
        model: compiled.
        trunk, floor: body and geom.
        hinges: joints with a servo, in the model's order.
        moved: names of left joints (or joints on the midline) that the policy moves.
        limits: of commands, by joint [rad].
        servo_of: name of the servo class, by joint.
        servos: numbers of each class, by name.
        told: whether the model itself names its servo classes.
    """

    path: Path
    model: mujoco.MjModel
    trunk: int
    floor: int
    hinges: tuple[Hinge, ...]
    moved: tuple[str, ...]
    limits: dict[str, tuple[float, float]]
    servo_of: dict[str, str]
    servos: dict[str, OwnServo]
    told: bool

    def hinge(self, name: str) -> Hinge:
        """The joint of that name."""
        return next(one for one in self.hinges if one.name == name)


def look(path: Path, named: dict[str, str]) -> Looked:
    """See what a model is of.

    Args:
        path: MuJoCo XML file.
        named: servo class by pattern of joint names, such as `{"*knee*": "mx106"}`; the first that fits counts.

    Raises:
        ModelError: what cannot be trained, and what to do about it.
        UsageError: a pattern that fits no joint.
    """
    model = load_model(path)
    if calibration_id(model) is not None:
        raise ModelError(f"{path} is calibrated already; start from the nominal model it was made from")
    trunk = trunk_body(model)
    if not model.body(trunk).name:
        raise ModelError(f"{path}: the body with the free joint has no name: give the trunk one")
    floor = floor_of(path, model)
    check_actuators(path, model)
    found = hinges(model, trunk)
    if not found:
        raise ModelError(f"{path}: no actuator turns a hinge of '{model.body(trunk).name}': nothing could be trained")
    check_collision(path, model, trunk, floor)
    limits = {one.name: limits_of(path, model, one) for one in found}
    told = _told_classes(model, found) if not named else {}
    servo_of = told or _classes(model, found, named)
    servos = {name: _servo(path, model, found, servo_of, name) for name in dict.fromkeys(servo_of.values())}
    moved = tuple(one.name for one in found if _worth_moving(one))
    if not any(name for name in moved if _hinge(found, name).side == "left"):
        raise ModelError(
            f"{path}: no pair of mirrored joints turns about the trunk's y axis (left); the trunk's axes have to be x "
            "forward, y left, z up with all joints at 0"
        )
    return Looked(path, model, trunk, floor, found, moved, limits, servo_of, servos, bool(told))


def _worth_moving(one: Hinge) -> bool:
    if one.turns != "pitch":
        return False
    return one.side == "left" if one.partner is not None else one.carries > _CARRIES


def _hinge(found: tuple[Hinge, ...], name: str) -> Hinge:
    return next(one for one in found if one.name == name)


def _told_classes(model: mujoco.MjModel, found: tuple[Hinge, ...]) -> dict[str, str]:
    """The model's own servo classes, where they name every servo and say at which supply and gain they hold."""
    of = {int(i): name for name in servo_classes(model) for i in actuators_of(model, name)}
    if not all(one.actuator in of for one in found):
        return {}
    try:
        number(model, "servo_supply_voltage"), number(model, "servo_firmware_gain")
    except ModelError:
        return {}
    return {one.name: of[one.actuator] for one in found}


def _numbers(model: mujoco.MjModel, one: Hinge) -> tuple[float, float, float, float, float]:
    """kp, torque limit, damping, friction and armature."""
    dof = int(model.jnt_dofadr[one.joint])
    limit = np.inf
    if model.actuator_forcelimited[one.actuator]:
        limit = min(limit, *np.abs(model.actuator_forcerange[one.actuator]))
    if model.jnt_actfrclimited[one.joint]:
        limit = min(limit, *np.abs(model.jnt_actfrcrange[one.joint]))
    kp = float(model.actuator_gainprm[one.actuator, 0])
    return (
        kp, float(limit), float(model.dof_damping[dof]), float(model.dof_frictionloss[dof]),
        float(model.dof_armature[dof]),
    )  # fmt: skip


def _classes(model: mujoco.MjModel, found: tuple[Hinge, ...], named: dict[str, str]) -> dict[str, str]:
    """Servo class by joint: as the user says; the others are alike where all their numbers are."""
    for pattern in named:
        if not any(fnmatchcase(one.name, pattern) for one in found):
            raise UsageError(
                f"--servo: no joint is called '{pattern}'; there are {', '.join(one.name for one in found)}"
            )
    kinds: dict[tuple[float, ...], str] = {}
    servo_of = {}
    for one in found:
        said = next((name for pattern, name in named.items() if fnmatchcase(one.name, pattern)), None)
        key = tuple(float(f"{value:.6g}") for value in _numbers(model, one))
        if said is None:
            said = kinds.setdefault(key, f"servo_{chr(ord('a') + len(kinds))}")
        servo_of[one.name] = said
    return servo_of


def _servo(
    path: Path, model: mujoco.MjModel, found: tuple[Hinge, ...], servo_of: dict[str, str], name: str
) -> OwnServo:
    """The numbers of a class; all its joints must have the same."""
    joints = [one for one in found if servo_of[one.name] == name]
    numbers = np.array([_numbers(model, one) for one in joints])
    words = ("kp", "torque limit (forcerange)", "damping", "frictionloss", "armature")
    units = ("N m/rad", "N m", "N m s/rad", "N m", "kg m^2")
    for word, unit, column in zip(words, units, numbers.T, strict=True):
        other = np.flatnonzero(~np.isclose(column, column[0], rtol=1e-6))
        if other.size:
            raise ModelError(
                f"{path}: joints {joints[0].name} and {joints[int(other[0])].name} are both servo '{name}' and differ "
                f"in {word}, {column[0]:.4g} and {column[other[0]]:.4g} {unit}: one class has one number"
            )
    kp, force, damping, friction, armature = (float(value) for value in numbers[0])
    if not np.isfinite(force) or force <= 0.0:
        raise ModelError(
            f"{path}: the actuator of joint {joints[0].name} has no torque limit: give it a forcerange [N m], the "
            "servo's stall torque"
        )
    guesses = {"damping": force / _SPEED, "friction": _DRY * force, "armature": _RISE * (damping or force / _SPEED)}
    had = {"damping": damping, "friction": friction, "armature": armature}
    guessed = tuple(word for word, value in had.items() if value <= 0.0)
    values = {word: value if value > 0.0 else float(f"{guesses[word]:.3g}") for word, value in had.items()}
    return OwnServo(name, kp, force, **values, guessed=guessed)

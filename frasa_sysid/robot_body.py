"""The virtual robot's body: the model file compiled without its servos, held by the trunk or on the ground.

Everything a model says about servos, sensors and their delays is taken out: the simulation brings its own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration import actuators_of, load_model, load_spec, number, servo_classes
from frasa_sysid.calibration.anatomy import Hinge, Leg, hinges, legs, trunk_body
from frasa_sysid.errors import ModelError
from frasa_sysid.robot_servos import servo_types
from frasa_sysid.robot_truth import RobotTruth
from frasa_sysid.servo import Servo

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
HEIGHT = 1.0  # [m] of the held trunk: nothing reaches the ground
KEY = "neutral"


@dataclass(frozen=True)
class Joints:
    """The joints of a model that have a servo, in the model's order, n of them.

    Attributes:
        names: of the joints.
        servos: class of each.
        trunk: name of the body that is held or floats.
        low, high: command limits [rad], shape (n,).
        neutral: angles of the keyframe `neutral`, else 0 within the limits [rad], shape (n,).
        supply_voltage: at which the model's gains hold [V].
        firmware_gain: P at which they do.
        types: what the classes are, for simulation.
        hinges: where the joints are and what they turn about, in the model's order.
        legs: those of a humanoid; empty where two are not found.
    """

    names: tuple[str, ...]
    servos: tuple[str, ...]
    trunk: str
    low: FloatArray
    high: FloatArray
    neutral: FloatArray
    supply_voltage: float
    firmware_gain: float
    types: Mapping[str, Servo]
    hinges: tuple[Hinge, ...]
    legs: tuple[Leg, ...]

    @property
    def classes(self) -> tuple[str, ...]:
        """Servo classes, each once."""
        return tuple(sorted(set(self.servos)))


@dataclass(frozen=True)
class Body:
    """A compiled body without servos.

    Attributes:
        model: steps with `mj_step`; whoever simulates owns it.
        qpos: index of each servo joint in qpos, shape (n,).
        dof: index of each servo joint in qvel, shape (n,).
        start: qpos at the start, shape (nq,).
        trunk_mass: [kg].
        trunk_com: [m], trunk frame.
    """

    model: Any
    qpos: IntArray
    dof: IntArray
    start: FloatArray
    trunk_mass: float
    trunk_com: tuple[float, float, float]


def joints_of(path: Path) -> Joints:
    """The servo joints of a robot's model.

    Raises:
        ModelError: no model, no free joint to hold or free, an actuator that no servo class names, or no supply and
            firmware gain at which its numbers hold.
    """
    model = load_model(path)
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if free.size != 1:
        raise ModelError(f"{path}: expected a robot with one free joint, found {free.size}")
    trunk = trunk_body(model)
    servo_of = {int(i): name for name in servo_classes(model) for i in actuators_of(model, name)}
    order = np.argsort(model.actuator_trnid[:, 0], kind="stable")
    unnamed = [model.actuator(int(i)).name for i in order if int(i) not in servo_of]
    if unnamed:
        raise ModelError(
            f"{path}: no servo class names actuator {', '.join(unnamed)}; frasa-rl init makes classes of servos"
        )
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, KEY)
    low, high = model.actuator_ctrlrange[order].T
    joints = model.actuator_trnid[order, 0]
    rest = model.key_qpos[key][model.jnt_qposadr[joints]] if key >= 0 else np.clip(0.0, low, high)
    pose = model.key_qpos[key] if key >= 0 else None
    return Joints(
        tuple(model.joint(int(j)).name for j in joints),
        tuple(servo_of[int(i)] for i in order),
        model.body(trunk).name,
        np.array(low),
        np.array(high),
        np.array(rest),
        number(model, "servo_supply_voltage"),
        number(model, "servo_firmware_gain"),
        servo_types(path, model),
        hinges(model, trunk),
        legs(model, trunk, pose),
    )


def build(path: Path, truth: RobotTruth, joints: Joints, timestep: float) -> Body:
    """Compile the body of a robot.

    Args:
        path: MuJoCo XML file.
        truth: base, tilt, trunk and servos.
        joints: of that model.
        timestep: physics step [s].
    """
    spec = load_spec(path)
    # Tuples name actuators and keys have a size: they go first.
    for several in (spec.tuples, spec.keys, spec.sensors, spec.actuators):
        for one in list(several):
            spec.delete(one)
    trunk = spec.body(joints.trunk)
    if not trunk.explicitinertial:
        raise ModelError(
            f"{path}: the trunk '{joints.trunk}' has no <inertial>, so its mass cannot be another one; frasa-rl init "
            "writes one"
        )
    trunk.mass *= truth.trunk_mass
    trunk.inertia = trunk.inertia * truth.trunk_mass
    trunk.ipos = trunk.ipos + np.array(truth.trunk_com)
    if truth.base == "fixed":
        hold(spec, trunk, tilt_quaternion(truth.roll, truth.pitch))
    armature = {name: truth.servo(name).armature for name in joints.classes}
    for name, servo in zip(joints.names, joints.servos, strict=True):
        spec.joint(name).armature = armature[servo]
    spec.option.timestep = timestep
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)  # the friction rows are written by number
    model = spec.compile()
    body = model.body(joints.trunk)
    com = tuple(float(one) for one in body.ipos)
    qpos = np.array([model.joint(name).qposadr[0] for name in joints.names], dtype=np.int64)
    dof = np.array([model.joint(name).dofadr[0] for name in joints.names], dtype=np.int64)
    return Body(model, qpos, dof, _start(path, model, qpos, joints), float(body.mass[0]), (com[0], com[1], com[2]))


def hold(spec: Any, trunk: Any, orientation: Sequence[float]) -> None:  # noqa: ANN401 (mujoco's own types)
    """Fix a specification's trunk in the air and take away the floor.

    Args:
        spec: changed in place.
        trunk: its body with the free joint.
        orientation: of the trunk (w, x, y, z).
    """
    for joint in list(trunk.joints):
        spec.delete(joint)
    trunk.pos = [0.0, 0.0, HEIGHT]
    trunk.quat = orientation
    # MuJoCo lets a body pass through its parent only while the parent moves.
    for child in list(trunk.bodies):
        spec.add_exclude(bodyname1=trunk.name, bodyname2=child.name)
    for geom in list(spec.worldbody.geoms):
        spec.delete(geom)


def bare(path: Path, held: bool, plain: bool = True) -> Any:  # noqa: ANN401
    """The compiled model of a file without key frames.

    Args:
        path: the model.
        held: with its trunk fixed in the air and no floor, if it has a free joint.
        plain: without sensors and command delays, which only make the state larger.
    """
    spec = load_spec(path)
    for one in [*spec.keys, *(spec.sensors if plain else ())]:
        spec.delete(one)
    if plain:
        for actuator in spec.actuators:
            actuator.delay, actuator.nsample = 0.0, 0
    if held:
        for joint in [one for one in spec.joints if one.type == mujoco.mjtJoint.mjJNT_FREE]:
            hold(spec, joint.parent, (1.0, 0.0, 0.0, 0.0))
    return spec.compile()


def tilt_quaternion(roll: float, pitch: float) -> tuple[float, float, float, float]:
    """Rotation about x, then about the world's y [rad] -> (w, x, y, z)."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return cp * cr, cp * sr, sp * cr, -sp * sr


def _start(path: Path, model: Any, qpos: IntArray, joints: Joints) -> FloatArray:  # noqa: ANN401
    start = np.array(model.qpos0)
    whole = load_model(path)
    key = mujoco.mj_name2id(whole, mujoco.mjtObj.mjOBJ_KEY, KEY)
    if key >= 0 and model.nq == whole.nq:
        start = np.array(whole.key_qpos[key])
    start[qpos] = joints.neutral
    return start

"""Where the task's joints, sensors and bodies are in a compiled model; every name is resolved once, here."""

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_rl.config import Names, Task
from frasa_sysid.calibration import ModelError

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Sensors:
    """Sensors of one kind: what the robot reads. Empty where it is taken to read the truth.

    Attributes:
        ids: shape (...,).
        start: addresses of their first numbers in `sensordata`, shape (...,).
    """

    ids: Indices
    start: Indices

    def __bool__(self) -> bool:
        return bool(self.ids.size)


@dataclass(frozen=True)
class Robot:
    """Indices into a model, for n joints on two sides (left, right).

    Attributes:
        actuators: shape (n, 2).
        qpos, dofs: addresses of joint positions and velocities, shape (n, 2).
        mirror: sign of the right side, shape (n, 2), ones on the left.
        weights: of left and right in what is said of a joint, shape (2,).
        limits: control range both sides share, seen from the left, shape (n, 2).
        held: command of every actuator that the policy does not move [rad], shape (nu,).
        position, velocity: sensors of the joints, shape (n, 2) or empty.
        orientation, gyro: sensors of the trunk, shape (1,) or empty.
        self_contact: forces between parts of the robot, shape (3 k,) of `sensordata`.
        support: centre of mass and feet, shape (3 + 7 feet,) of `sensordata`; None where the task does not ask.
        trunk, floor: body and geom.
        root_qpos, root_dof: where the trunk's free joint starts.
    """

    actuators: Indices
    qpos: Indices
    dofs: Indices
    mirror: Floats
    weights: Floats
    limits: Floats
    held: Floats
    position: Sensors
    velocity: Sensors
    orientation: Sensors
    gyro: Sensors
    self_contact: slice
    support: slice | None
    trunk: int
    floor: int
    root_qpos: int
    root_dof: int

    def both_sides(self, joint_values: Floats) -> Floats:
        """Commands for actuators from the left-side values (..., n): shape (..., n, 2)."""
        return joint_values[..., None] * self.mirror

    def mean_of_sides(self, values: Floats) -> Floats:
        """One number a joint from the two sides (..., n, 2), mirrored: shape (..., n)."""
        return np.asarray((values * self.mirror) @ self.weights)


def find_robot(model: mujoco.MjModel, task: Task) -> Robot:
    """Resolve every name the task needs.

    Raises:
        ModelError: some are missing (all are listed, with what the model has), a joint is no hinge or has no position
            actuator with a control range, a pose is outside of that range, the trunk has no free joint, or a
            sensor is not aligned with it.
    """
    names = task.names
    joints = [list(names.pair(one)) for one in task.joints]
    flat = [name for pair in joints for name in pair]
    _require(model, "joint", flat)
    _require(model, "actuator", [name for name, _ in task.held_deg])
    _require(model, "sensor", sensor_names(task))
    _require(model, "body", [names.trunk])
    _require(model, "geom", [names.floor])
    trunk = int(model.body(names.trunk).id)
    root = _root(model, trunk, names)
    ids = np.array([[model.joint(name).id for name in pair] for pair in joints])
    actuators = np.vectorize(lambda joint: _actuator_of(model, int(joint)))(ids)
    mirror = np.array([[1.0, one.mirror] for one in task.joints])
    ranges = model.actuator_ctrlrange[actuators] * mirror[:, :, None]
    ranges.sort(axis=2)
    limits = np.stack([ranges[:, :, 0].max(axis=1), ranges[:, :, 1].min(axis=1)], axis=1)
    _check_targets(task, limits)
    return Robot(
        actuators=actuators,
        qpos=model.jnt_qposadr[ids].astype(np.int64),
        dofs=model.jnt_dofadr[ids].astype(np.int64),
        mirror=mirror,
        weights=np.array([1.0, 0.0] if task.compat else [0.5, 0.5]),
        limits=limits,
        held=_held(model, task, actuators),
        position=_joint_sensors(model, names.position, joints),
        velocity=_joint_sensors(model, names.velocity, joints),
        orientation=_trunk_sensor(model, names.orientation, trunk, 4),
        gyro=_trunk_sensor(model, names.gyro, trunk, 3),
        self_contact=_slice(model, names.self_contact or ADDED_SELF_CONTACT),
        support=_support(model),
        trunk=trunk,
        floor=int(model.geom(names.floor).id),
        root_qpos=int(model.jnt_qposadr[root]),
        root_dof=int(model.jnt_dofadr[root]),
    )


ADDED_SELF_CONTACT = "frasa_self_contact"
ADDED_SUPPORT = "frasa_support_{}"  # 0: centre of mass; then place and turn of each foot


def sensor_names(task: Task) -> list[str]:
    """Every sensor the task reads."""
    names = task.names
    joints = [name for one in task.joints for name in names.pair(one)]
    of_joints = [pattern.format(joint) for pattern in (names.position, names.velocity) if pattern for joint in joints]
    return [*of_joints, *(one for one in (names.orientation, names.gyro, names.self_contact) if one)]


def pitch_of(quaternion: Floats) -> Floats:
    """Trunk pitch [rad], forward positive, of quaternions w x y z (..., 4): atan2(-R[2, 0], R[2, 2]), shape (...,)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    # Free of the quaternion's norm: an interpolated one is not quite 1.
    return np.asarray(np.arctan2(2.0 * (w * y - x * z), w * w - x * x - y * y + z * z))


def _require(model: mujoco.MjModel, kind: str, names: Iterable[str]) -> None:
    count = {"joint": "njnt", "actuator": "nu", "sensor": "nsensor", "body": "nbody", "geom": "ngeom"}[kind]
    present = [getattr(model, kind)(i).name for i in range(getattr(model, count))]
    missing = [name for name in dict.fromkeys(names) if name not in present]
    if missing:
        known = ", ".join(name for name in present if name) or "none with a name"
        raise ModelError(f"the model lacks {kind} {', '.join(missing)}; it has {known}")


def _root(model: mujoco.MjModel, trunk: int, names: Names) -> int:
    joint = int(model.body_jntadr[trunk])
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        raise ModelError(f"body {names.trunk} has no free joint: the trunk must be the body that can move freely")
    return joint


def _actuator_of(model: mujoco.MjModel, joint: int) -> int:
    """The position actuator of a joint."""
    name = model.joint(joint).name
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        raise ModelError(f"joint {name} is no hinge: the task moves hinges only")
    drives = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    found = np.flatnonzero(drives & (model.actuator_biasprm[:, 1] < 0.0))
    if found.size != 1:
        raise ModelError(f"joint {name} has {found.size} position actuators: expected one")
    if not model.actuator_ctrllimited[found[0]]:
        raise ModelError(f"the actuator of joint {name} has no ctrlrange: the task needs to know how far it may go")
    if model.actuator_gear[found[0], 0] != 1.0:
        raise ModelError(
            f"the actuator of joint {name} has gear {model.actuator_gear[found[0], 0]:g}: expected 1, so that "
            "its command is the joint's angle"
        )
    return int(found[0])


def _check_targets(task: Task, limits: Floats) -> None:
    """The standing pose must be one that can be commanded, on both sides."""
    for one, (low, high) in zip(task.joints, np.degrees(limits), strict=True):
        left, right = task.names.pair(one)
        if low > high - 1e-6:
            raise ModelError(
                f"{left} and {right} have no range in common with mirror {one.mirror}: is the mirror right, and are "
                "their ctrlranges?"
            )
        if not low - 1e-6 <= one.target_deg <= high + 1e-6:
            raise ModelError(
                f"target_deg of {one.name} is {one.target_deg:g}: the ctrlrange of {left} and {right} allows "
                f"{low:.1f} .. {high:.1f} deg (seen from the left); is its sign right?"
            )


def _held(model: mujoco.MjModel, task: Task, moved: Indices) -> Floats:
    """The commands of all actuators that the policy does not move, shape (nu,)."""
    commands = np.zeros(model.nu)
    for name, angle in task.held_deg:
        index, value = int(model.actuator(name).id), float(np.radians(angle))
        low, high = model.actuator_ctrlrange[index]
        if index in moved:
            raise ModelError(f"actuator {name} is in held_deg, and is one that the policy moves: take one of the two")
        if model.actuator_ctrllimited[index] and not low - 1e-9 <= value <= high + 1e-9:
            raise ModelError(
                f"held_deg of {name} is {angle:g}: its ctrlrange allows {np.degrees(low):.1f} .. "
                f"{np.degrees(high):.1f} deg"
            )
        commands[index] = value
    return commands


def _joint_sensors(model: mujoco.MjModel, pattern: str | None, joints: list[list[str]]) -> Sensors:
    if pattern is None:
        return Sensors(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    ids = np.array([[model.sensor(pattern.format(name)).id for name in pair] for pair in joints])
    return Sensors(ids, model.sensor_adr[ids].astype(np.int64))


def _trunk_sensor(model: mujoco.MjModel, name: str | None, trunk: int, size: int) -> Sensors:
    if name is None:
        return Sensors(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    ids = np.array([model.sensor(name).id])
    index = int(ids[0])
    if model.sensor_dim[index] != size:
        raise ModelError(f"sensor {name} has {model.sensor_dim[index]} numbers, expected {size}")
    kind, object_id = model.sensor_objtype[index], int(model.sensor_objid[index])
    site = kind == mujoco.mjtObj.mjOBJ_SITE
    body = int(model.site_bodyid[object_id]) if site else object_id
    if body != trunk or (site and not np.allclose(np.abs(model.site_quat[object_id]), [1, 0, 0, 0], atol=1e-6)):
        raise ModelError(f"sensor {name} is not fixed to the trunk with its axes: turn its site as the trunk is")
    return Sensors(ids, model.sensor_adr[ids].astype(np.int64))


def _slice(model: mujoco.MjModel, name: str) -> slice:
    index = model.sensor(name).id
    start = int(model.sensor_adr[index])
    return slice(start, start + int(model.sensor_dim[index]))


def _support(model: mujoco.MjModel) -> slice | None:
    """The sensors that `support` added, one after the other."""
    names = {model.sensor(i).name for i in range(model.nsensor)}
    count = sum(name.startswith(ADDED_SUPPORT.format("")) for name in names)
    if not count:
        return None
    first, last = (_slice(model, ADDED_SUPPORT.format(number)) for number in (0, count - 1))
    return slice(first.start, last.stop)

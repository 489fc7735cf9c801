"""Poses of a robot on the floor: where its trunk and its lowest point are in them."""

import mujoco
import numpy as np

from frasa_rl.config import Task
from frasa_rl.robot import Floats, Robot


def standing(task: Task) -> tuple[Floats, float]:
    """Joints (n,) and pitch of the standing pose [rad]."""
    return np.radians([one.target_deg for one in task.joints]), float(np.radians(task.target_pitch_deg))


def place(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, joints: Floats, pitch: float, gap: float = 0.0
) -> None:
    """Put the robot in a pose on the floor, nothing moving: `qpos` and `ctrl`.

    What MuJoCo computes from `qpos` is not up to date afterwards: its heights differ by one number for all parts.

    Args:
        model: any of the robot's.
        data: of the same sizes, overwritten.
        robot: where things are.
        joints: commands of the moved joints, seen from the left, and where they are [rad], shape (n,).
        pitch: of the trunk [rad].
        gap: between the lowest point and the floor [m].
    """
    mujoco.mj_resetData(model, data)
    data.ctrl[:] = robot.held
    data.ctrl[robot.actuators] = robot.both_sides(joints)
    turning = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    data.qpos[model.jnt_qposadr[model.actuator_trnid[turning, 0]]] = data.ctrl[turning]
    root = robot.root_qpos
    data.qpos[root : root + 7] = (0.0, 0.0, 1.0, np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0)
    mujoco.mj_kinematics(model, data)
    data.qpos[root + 2] += data.geom_xpos[robot.floor, 2] + gap - lowest_point(model, data, robot)


def trunk_heights(model: mujoco.MjModel, robot: Robot, task: Task) -> tuple[float, float]:
    """Where the floor is, and the trunk in the standing pose [m], both in the world."""
    data = mujoco.MjData(model)
    place(model, data, robot, *standing(task))
    return float(data.geom_xpos[robot.floor, 2]), float(data.qpos[robot.root_qpos + 2])


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, body: int | None = None) -> float:
    """Height of the lowest point of the bounding boxes of the robot, or of a body [m]; exact for boxes, else safe."""
    own = model.body_rootid[model.geom_bodyid] == robot.trunk if body is None else model.geom_bodyid == body
    rotation = data.geom_xmat[own].reshape(-1, 3, 3)
    centre, half = model.geom_aabb[own, :3], model.geom_aabb[own, 3:]
    heights = data.geom_xpos[own, 2] + np.einsum("ni,ni->n", rotation[:, 2], centre)
    return float((heights - np.einsum("ni,ni->n", np.abs(rotation[:, 2]), half)).min())

"""The state a piece of a robot's run starts from: joints from the encoders, the trunk from IMU and ground.

On the ground nothing measures where the trunk is: its orientation is roughly the IMU's and its height that
at which the lowest point touches the floor; `robot_settle` then lets it stand.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.holds import up_of
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_rig import RobotRun, local_states

_BURIED = 5e-4  # [m] how deep the lowest point of a standing robot is in MuJoCo's soft floor


def start_states(model: mujoco.MjModel, trunk: int, run: RobotRun, first: int, ages: Mapping[str, float]) -> FloatArray:
    """Positions and velocities at a physics step as measured, shape (nq + nv,).

    On the ground the trunk's orientation and rate are there, but not yet its height and speed: see `put_down`.

    Args:
        model: the robot, of one kind of base.
        trunk: its root body.
        run: measured on it.
        first: physics step.
        ages: of channels by name [s].
    """
    time = first * float(model.opt.timestep)
    qpos, qvel = np.array(model.qpos0), np.zeros(model.nv)
    joints = model.actuator_trnid[:, 0]
    q, dq = local_states(run.channels["position"], np.array([time + ages.get("position", 0.0)]))
    qpos[model.jnt_qposadr[joints]], qvel[model.jnt_dofadr[joints]] = q[0], dq[0]
    if run.base == "floating":
        joint = model.body_jntadr[trunk]
        place, speed = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        turned, rate = (_trunk_reading(run, name, time + ages.get(name, 0.0)) for name in ("orientation", "gyro"))
        qpos[place + 3 : place + 7] = turned / np.linalg.norm(turned)
        qvel[speed + 3 : speed + 6] = rate
    return np.concatenate([qpos, qvel])


def _trunk_reading(run: RobotRun, name: str, time: float) -> FloatArray:
    if name not in run.channels:
        raise LogError(f"{run.name}: on the ground the trunk is known from the IMU, and the log has no {name}")
    return np.asarray(local_states(run.channels[name], np.array([time]))[0][0])


def put_down(model: mujoco.MjModel, data: mujoco.MjData, trunk: int, qpos: FloatArray) -> FloatArray:
    """The same positions (nq,) with the trunk at the height at which the lowest point touches the floor.

    Args:
        model: with the zeros of the robot at hand.
        data: scratch.
        trunk: root body.
        qpos: joints and the trunk's orientation, shape (nq,).
    """
    place = model.jnt_qposadr[model.body_jntadr[trunk]]
    placed = np.array(qpos)
    placed[place : place + 3] = 0.0
    placed[place + 2] = -bottoms(model, data, placed).min() - _BURIED
    return placed


def bottoms(model: mujoco.MjModel, data: mujoco.MjData, qpos: FloatArray) -> FloatArray:
    """Height of the lowest corner of the box around each geom of the robot that collides [m], shape (g,)."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero((model.geom_bodyid > 0) & (model.geom_contype > 0))
    up = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
    centre, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    return np.asarray(data.geom_xpos[geoms, 2] + np.sum(up * centre - np.abs(up) * half, axis=1))


def gravity_of(run: RobotRun, model: mujoco.MjModel) -> FloatArray:
    """Gravity in the model's world [m/s^2], shape (3,): of a trunk that is held, from its mean orientation.

    A held trunk stands upright in its model, so it is the world that is tilted. Without an orientation in the log
    the trunk counts as upright.
    """
    if run.base == "floating" or "orientation" not in run.channels:
        return np.array(model.opt.gravity)
    up = up_of(run.channels["orientation"].y).mean(axis=0)
    return np.asarray(-up / np.linalg.norm(up) * np.linalg.norm(model.opt.gravity))

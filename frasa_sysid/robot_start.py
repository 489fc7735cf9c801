"""The state a piece of a robot's run starts from: joints from the encoders, the trunk from IMU and ground.

On the ground nothing measures where the trunk is: its orientation and rate are the IMU's, its height
is that at which the lowest point touches the floor, and its speed the one with which that point rests.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_rig import RobotRun, local_states

_BURIED = 5e-4  # [m] how deep the lowest point of a standing robot is in MuJoCo's soft floor
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def start_states(model: mujoco.MjModel, trunk: int, run: RobotRun, first: int, ages: Mapping[str, float]) -> FloatArray:
    """Positions and velocities at a physics step, shape (nq + nv,).

    Args:
        model: the robot, of one kind of base.
        trunk: its root body.
        run: measured on it.
        first: physics step.
        ages: of channels by name [s].
    """
    time = first * float(model.opt.timestep)
    data = mujoco.MjData(model)
    joints = model.actuator_trnid[:, 0]
    channel = run.channels["position"]
    q, dq = local_states(channel, np.array([time + ages.get("position", 0.0)]))
    data.qpos[model.jnt_qposadr[joints]] = q[0]
    data.qvel[model.jnt_dofadr[joints]] = dq[0]
    if run.base == "floating":
        _place_trunk(model, data, trunk, run, time, ages)
    return np.concatenate([data.qpos, data.qvel])


def gravity_of(run: RobotRun, model: mujoco.MjModel) -> FloatArray:
    """Gravity in the model's world [m/s^2], shape (3,): of a trunk that is held, from its mean orientation.

    A held trunk stands upright in its model, so it is the world that is tilted. Without an orientation in the log
    the trunk counts as upright.
    """
    if run.base == "floating" or "orientation" not in run.channels:
        return np.array(model.opt.gravity)
    w, x, y, z = run.channels["orientation"].y.T
    # The third row of the rotation: the world's vertical as the trunk sees it.
    up = np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z]).mean(axis=1)
    return np.asarray(-up / np.linalg.norm(up) * np.linalg.norm(model.opt.gravity))


def _place_trunk(
    model: mujoco.MjModel, data: mujoco.MjData, trunk: int, run: RobotRun, time: float, ages: Mapping[str, float]
) -> None:
    missing = [name for name in ("gyro", "orientation") if name not in run.channels]
    if missing:
        raise LogError(f"{run.name}: on the ground the trunk is known from the IMU, and the log has no {missing[0]}")
    turned = local_states(run.channels["orientation"], np.array([time + ages.get("orientation", 0.0)]))[0][0]
    rate = local_states(run.channels["gyro"], np.array([time + ages.get("gyro", 0.0)]))[0][0]
    joint = model.body_jntadr[trunk]
    q, v = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
    data.qpos[q : q + 3] = 0.0
    data.qpos[q + 3 : q + 7] = turned / np.linalg.norm(turned)
    data.qvel[v : v + 3], data.qvel[v + 3 : v + 6] = 0.0, rate
    mujoco.mj_forward(model, data)
    point, body = _lowest(model, data)
    data.qpos[q + 2] = -point[2] - _BURIED
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, point, body)
    data.qvel[v : v + 3] = -(jacobian @ data.qvel)


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[FloatArray, int]:
    """Lowest corner of all boxes around what collides, and its body."""
    best, owner = np.array([0.0, 0.0, np.inf]), 0
    for geom in np.flatnonzero((model.geom_bodyid > 0) & (model.geom_contype > 0)):
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        corners = data.geom_xpos[geom] + (centre + _CORNERS * half) @ data.geom_xmat[geom].reshape(3, 3).T
        low = corners[np.argmin(corners[:, 2])]
        if low[2] < best[2]:
            best, owner = low, int(model.geom_bodyid[geom])
    return best, owner

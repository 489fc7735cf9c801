"""Trying an excitation on the nominal model: torques, speeds, and whether the robot touches itself.

The model runs as it stands in its file (position actuators, its own step), held by the trunk.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration import hold_history, number
from frasa_sysid.excitation import Excitation
from frasa_sysid.holds import down
from frasa_sysid.robot_body import Joints, bare

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
CLEARANCE = 0.008  # [m]
FAR = 4  # joints between two parts that are not neighbours


@dataclass(frozen=True)
class Trial:
    """What an excitation asks of the nominal robot.

    Attributes:
        torque: largest torque of each joint by part, as a share of its force range, shape (parts, n).
        speed: largest speed likewise, as a share of the no-load speed (force range over damping).
        touching: how much each joint moves a point of contact towards another part of the robot, as a share
            of the most that a joint does, the largest of all contacts, shape (parts, n).
        apart: direction in which each joint would separate what touched, summed over contacts and scaled to
            at most 1, shape (n,).
    """

    torque: FloatArray
    speed: FloatArray
    touching: FloatArray
    apart: FloatArray


def order_of(model: Any, joints: Joints) -> tuple[IntArray, IntArray, IntArray]:  # noqa: ANN401
    """Actuator, qpos and dof of each joint, in the joints' order, each of shape (n,)."""
    wanted = [model.joint(name).id for name in joints.names]
    driven = model.actuator_trnid[:, 0].tolist()
    actuators = np.array([driven.index(joint) for joint in wanted], dtype=np.int64)
    return actuators, np.array(model.jnt_qposadr[wanted]), np.array(model.jnt_dofadr[wanted])


def as_recorded(model: Any, excitation: Excitation) -> Any:  # noqa: ANN401
    """A held model, changed in place: gravity of its hold, gain of its firmware."""
    model.opt.gravity[:] = np.linalg.norm(model.opt.gravity) * down(excitation.hold)
    if excitation.firmware_gain is not None:
        ratio = excitation.firmware_gain / number(model, "servo_firmware_gain")
        model.actuator_gainprm[:, 0] *= ratio
        model.actuator_biasprm[:, 1] *= ratio
    return model


def try_out(path: Path, joints: Joints, excitation: Excitation) -> Trial:
    """Run an excitation on the nominal robot, held as the excitation says."""
    model = as_recorded(bare(path, held=True, plain=False), excitation)
    # Near is taken for touching, without a force: the robot that records is not quite the nominal one.
    model.geom_gap[:] = CLEARANCE
    actuators, qpos, dof = order_of(model, joints)
    data = mujoco.MjData(model)
    data.qpos[qpos] = excitation.goals[0]
    if (model.actuator_delay > 0.0).any():  # else servos would be told to go to zero first
        data.ctrl[actuators] = excitation.goals[0]
        hold_history(model, data)
    h = float(model.opt.timestep)
    t = np.asarray(np.arange(round(excitation.seconds / h)) * h, dtype=np.float64)
    goals = excitation.at(t)
    part = np.searchsorted([one.end for one in excitation.parts[:-1]], t, side="right")
    n = len(joints.names)
    torque, speed, touching = (np.zeros((len(excitation.parts), n)) for _ in range(3))
    apart = np.zeros(n)
    for k in range(t.size):
        row = part[k]
        data.ctrl[actuators] = goals[k]
        mujoco.mj_step(model, data)
        np.maximum(torque[row], np.abs(data.actuator_force[actuators]), out=torque[row])
        np.maximum(speed[row], np.abs(data.qvel[dof]), out=speed[row])
        for i in range(data.ncon):
            if data.contact.dist[i] > 0.0 and not _far(model, data, i):
                continue
            lever = _lever(model, data, i)[dof]
            lever /= max(float(np.abs(lever).max()), 1e-9)
            np.maximum(touching[row], np.abs(lever), out=touching[row])
            apart += lever
    limit = model.actuator_forcerange[actuators, 1]
    apart /= max(float(np.abs(apart).max()), 1e-9)
    return Trial(torque / limit, speed / (limit / model.dof_damping[dof]), touching, apart)


def _far(model: Any, data: Any, i: int) -> bool:  # noqa: ANN401
    """Whether what comes near is not built close together: several joints lie between."""
    chains = []
    for geom in data.contact.geom[i]:
        body, chain = int(model.geom_bodyid[geom]), set()
        while body:
            chain |= {body} if model.body_dofnum[body] else set()
            body = int(model.body_parentid[body])
        chains.append(chain)
    return len(chains[0] ^ chains[1]) >= FAR


def _lever(model: Any, data: Any, i: int) -> FloatArray:  # noqa: ANN401
    """How much each dof opens a contact [m/rad], shape (nv,)."""
    contact = data.contact[i]
    jacobians = []
    for geom in (contact.geom1, contact.geom2):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, contact.pos, int(model.geom_bodyid[geom]))
        jacobians.append(jacobian)
    # The contact's normal points from the first geom to the second.
    return np.asarray(contact.frame[:3] @ (jacobians[1] - jacobians[0]))


def largest(trial: Trial) -> dict[str, FloatArray]:
    """Largest torque and speed of each joint over all parts, by name, each of shape (n,)."""
    return {one.name: getattr(trial, one.name).max(axis=0) for one in fields(trial) if one.name in ("torque", "speed")}

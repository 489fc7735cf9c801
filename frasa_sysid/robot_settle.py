"""How a robot of known joint angles stands on the floor: settled as a statue, moving as its feet let it.

An IMU's orientation is milliradians off, and a robot put down with that error falls onto its feet; the
bump lets joints slip that friction held. So the robot first settles on MuJoCo's own floor with all joints
stiff, from the IMU's orientation on, and then moves so that what touches the floor rests.
"""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import rollout

from frasa_sysid.recording import FloatArray

SETTLE = 0.06  # [s] in which a stiff robot comes to rest on the floor
_STIFF = 1e6  # [kg m^2] armature with which a joint does not turn
_ARM = 0.02  # [m] that turns a gyro's rate into a speed to be weighed against those of the feet
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


class Settler:
    """Settles robots of one model on the floor.

    Args:
        model: with a free trunk.
        trunk: body.
        jobs: robots settled in one call at most.
    """

    def __init__(self, model: mujoco.MjModel, trunk: int, jobs: int) -> None:
        root = int(model.body_jntadr[trunk])
        self._root = int(model.jnt_dofadr[root]) + np.arange(6)
        self._joints = np.setdiff1d(np.arange(model.nv), self._root)
        self.statues = [copy.copy(model) for _ in range(jobs)]
        self._scratch = mujoco.MjData(model)

    def settle(
        self, rollouts: rollout.Rollout, data: Sequence[mujoco.MjData], starts: FloatArray, speeds: FloatArray
    ) -> FloatArray:
        """States in which m robots stand, shape (m, nq + nv).

        The first m of `statues` must hold the candidates; they are made stiff here.

        Args:
            rollouts: thread pool.
            data: one of each of its threads.
            starts: qpos to settle from, shape (m, nq).
            speeds: measured qvel: of the joints, and the trunk's angular rate, shape (m, nv).
        """
        statues = self.statues[: len(starts)]
        for one in statues:
            self._stiffen(one)
        first = statues[0]
        state = np.zeros((len(starts), mujoco.mj_stateSize(first, _STATE)))
        state[:, 1 : 1 + first.nq] = starts
        steps = max(round(SETTLE / float(first.opt.timestep)), 1)
        paths, _ = rollouts.rollout(statues, data, state, np.zeros((len(starts), steps, first.nu)))
        rest = np.array(paths[:, -1, 1 : 1 + first.nq])
        found = [self._moving(model, qpos, speed) for model, qpos, speed in zip(statues, rest, speeds, strict=True)]
        return np.hstack([rest, np.array(found)])

    def _stiffen(self, model: mujoco.MjModel) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        model.dof_armature[self._joints] = _STIFF
        model.dof_frictionloss[self._joints] = 0.0

    def _moving(self, model: mujoco.MjModel, qpos: FloatArray, speed: FloatArray) -> FloatArray:
        """Speeds (nv,) with which the points of contact rest; the gyro decides on what they leave open."""
        data = self._scratch
        data.qpos[:], data.qvel[:] = qpos, 0.0
        mujoco.mj_fwdPosition(model, data)
        rows = np.zeros((3 * data.ncon + 3, model.nv))
        for i in range(data.ncon):
            contact = data.contact[i]
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
            if 0 in bodies:  # touches the floor, not another part of the robot
                mujoco.mj_jac(model, data, rows[3 * i : 3 * i + 3], None, contact.pos, int(bodies.max()))
        rest = -rows[:, self._joints] @ speed[self._joints]
        rows[-3:, self._root[3:]] = _ARM * np.eye(3)
        rest[-3:] = _ARM * speed[self._root[3:]]
        found = np.array(speed)
        found[self._root] = np.linalg.lstsq(rows[:, self._root], rest, rcond=None)[0]
        return found

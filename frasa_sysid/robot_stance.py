"""Zeros that put a standing robot's feet flat on the floor: where a fit on the ground starts.

With zeros a degree off a simulated robot stands on the edges of its feet, and from there slopes lead
nowhere. Without any simulation the log says which zeros bring all soles down to one plane at once.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_candidate import Candidate, Writer
from frasa_sysid.robot_rig import RobotRun
from frasa_sysid.robot_start import bottoms, start_states

_POSES = 60  # of a log
_SOLE = 0.015  # [m] above the lowest point up to which something is a part of a sole
_UNEVEN, _PRIOR = 0.0015, 0.02  # [m] of the soles of a robot at work, [rad] of zeros: standard deviations
_WORTH = 0.2  # a pose says little that the one before did not
_ROUNDS, _STEP = 6, 2e-3


def level_zeros(
    model: mujoco.MjModel, writer: Writer, trunk: int, run: RobotRun, ages: Mapping[str, float]
) -> dict[str, float]:
    """Zeros by joint [rad] that best bring the soles to one height in all poses of a run.

    Args:
        model: with a free trunk; changed in place.
        writer: of its candidates.
        trunk: root body.
        run: on the ground.
        ages: of channels by name [s].
    """
    steps = np.linspace(0.02, 0.98, _POSES) * run.steps
    poses = np.array([start_states(model, trunk, run, int(k), ages)[: model.nq] for k in steps])
    data = mujoco.MjData(model)

    def heights(zeros: FloatArray) -> FloatArray:
        writer.write(model, Candidate(zeros=dict(zip(run.joints, zeros.tolist(), strict=True))), 1.0, None)
        return np.array([bottoms(model, data, pose) for pose in poses])

    count = len(run.joints)
    first = heights(np.zeros(count))
    soles = np.median(first - first.min(axis=1, keepdims=True), axis=0) < _SOLE

    def unevenness(zeros: FloatArray) -> FloatArray:
        found = heights(zeros)[:, soles]
        return np.asarray((found - found.mean(axis=1, keepdims=True)).ravel())

    zeros = np.zeros(count)
    for _ in range(_ROUNDS):
        now = unevenness(zeros)
        slopes = np.array([(unevenness(zeros + _STEP * one) - now) / _STEP for one in np.eye(count)])
        weights = _WORTH / _UNEVEN**2 / np.sqrt(1.0 + (now / _UNEVEN / 3.0) ** 2)
        A = (slopes * weights) @ slopes.T + np.eye(count) / _PRIOR**2
        zeros -= np.linalg.solve(A, slopes @ (weights * now) + zeros / _PRIOR**2)
    return dict(zip(run.joints, zeros.tolist(), strict=True))

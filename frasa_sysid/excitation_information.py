r"""What excitations will tell: Fisher information of each parameter, on the nominal model held by the trunk.

With J the change of all readings by a parameter, each in its own noise unit, the information is
:math:`J^T J`, summed over the logs of all holds, and the predicted intervals are those of its inverse.
Finite differences run through `mujoco.rollout`. Noise is what fits leave over rather than what sensors
add: neighbouring errors of a model go together, so only one sample in `CORRELATED` counts.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import rollout

from frasa_sysid.calibration import actuators_of, dofs_of
from frasa_sysid.excitation import PERIOD, Excitation
from frasa_sysid.excitation_trial import as_recorded, order_of
from frasa_sysid.robot_body import Joints, bare

FloatArray = npt.NDArray[np.float64]
POSITION_NOISE = 0.0015  # [rad] a typical residual of fitted servo logs
VELOCITY_NOISE = 0.03  # [rad/s] two and a half counts
CORRELATED = 50  # samples at 100 Hz
BATCH = 8  # simulations side by side
# What is known before any log, as a standard deviation: an interval as wide as that was not excited at all.
PRIOR: Mapping[str, float] = {
    "gain_scale": 0.5,
    "damping_scale": 0.5,
    "friction_scale": 1.0,
    "delay": 0.1,
    "velocity_delay": 0.1,
    "zero": 0.03,
}
STEP: Mapping[str, float] = {
    "gain_scale": 0.02,
    "damping_scale": 0.02,
    "friction_scale": 0.1,
    "delay": 0.002,
    "zero": 0.01,
}
SCALES = ("gain_scale", "damping_scale", "friction_scale")


@dataclass(frozen=True)
class Information:
    """Predicted knowledge of P parameters.

    Attributes:
        names: of the parameters.
        sd: predicted standard deviations, in the parameters' units, shape (P,).
        shares: of each parameter's information by part, those of all excitations in turn, shape (parts, P).
    """

    names: tuple[str, ...]
    sd: FloatArray
    shares: FloatArray


def parameters_of_held(joints: Joints) -> tuple[str, ...]:
    """All parameters that a log of a held robot may tell.

    Command delay and age of the position are one parameter, `<servo>.delay`, by their sum.
    """
    names = [f"{servo}.{field}" for servo in joints.classes for field in (*SCALES, "delay")]
    return (*names, "sensor.velocity_delay", *(f"{joint}.zero" for joint in joints.names))


def share_of(progress: Callable[[float], None], i: int, count: int) -> Callable[[float], None]:
    """What to call with the share done of the i-th of some equal pieces of work."""
    return lambda share: progress((i + share) / count)


def information(
    path: Path,
    joints: Joints,
    excitations: Sequence[Excitation],
    progress: Callable[[float], None] = lambda share: None,
) -> Information:
    """Predict what logs of some excitations will tell together.

    Args:
        path: the nominal model.
        joints: of the model.
        excitations: goals to send, each in its own hold.
        progress: called with the share done.
    """
    names, count = parameters_of_held(joints), len(excitations)
    known = np.array([PRIOR[_field(name)] for name in names])
    total, shares = np.eye(len(names)), []
    for i, one in enumerate(excitations):
        slopes = _slopes(path, joints, one, names, share_of(progress, i, count)) * known
        total += np.einsum("tip,tiq->pq", slopes, slopes)
        shares.append(_by_part(slopes, one))
    sd = np.sqrt(np.diag(np.linalg.inv(total))) * known
    own = np.concatenate(shares)
    return Information(names, sd, own / np.maximum(own.sum(axis=0), 1e-300))


def _by_part(slopes: FloatArray, excitation: Excitation) -> FloatArray:
    """Information of each parameter in each part, from slopes (T, 2 n, P), shape (parts, P)."""
    t = np.arange(len(slopes)) * PERIOD
    part = np.searchsorted([one.end for one in excitation.parts[:-1]], t, side="right")
    return np.stack([(slopes[part == i] ** 2).sum(axis=(0, 1)) for i in range(len(excitation.parts))])


def _slopes(
    path: Path, joints: Joints, excitation: Excitation, names: Sequence[str], progress: Callable[[float], None]
) -> FloatArray:
    """Change of all readings, in their noise units, by each parameter, shape (T, 2 n, P)."""
    varied = [name for name in names if name != "sensor.velocity_delay"]
    model = as_recorded(bare(path, held=True), excitation)
    # Readings come after whole steps: the next shorter one that divides their period.
    model.opt.timestep = PERIOD / max(1, math.ceil(PERIOD / model.opt.timestep - 1e-9))
    cases = [_case(model, joints, excitation, name) for name in ["", *varied]]
    readings = []
    for i in range(0, len(cases), BATCH):
        readings += list(_run(joints, cases[i : i + BATCH]))
        progress(min(1.0, (i + BATCH) / len(cases)))
    weights = np.repeat([1.0 / POSITION_NOISE, 1.0 / VELOCITY_NOISE], len(joints.names)) / np.sqrt(CORRELATED)
    slopes = {name: (readings[i + 1] - readings[0]) / STEP[_field(name)] * weights for i, name in enumerate(varied)}
    slopes["sensor.velocity_delay"] = _of_velocity_delay(readings[0], len(joints.names)) * weights
    return np.stack([slopes[name] for name in names], axis=-1)


def _field(name: str) -> str:
    return name.rpartition(".")[2]


@dataclass(frozen=True)
class _Case:
    model: Any
    goals: FloatArray
    zero: FloatArray


def _case(model: Any, joints: Joints, excitation: Excitation, name: str) -> _Case:  # noqa: ANN401
    """The simulation with one parameter changed by its step; "" for none."""
    n = len(joints.names)
    owner, _, field = name.rpartition(".")
    one, zero, delay = model, np.zeros(n), np.zeros(n)
    if field in SCALES:
        one = _scaled(model, owner, field, 1.0 + STEP[field])
    elif field == "delay":
        delay = np.where(np.array(joints.servos) == owner, STEP[field], 0.0)
    elif field == "zero":
        zero[joints.names.index(owner)] = STEP[field]
    t = np.asarray(np.arange(round(excitation.seconds / model.opt.timestep)) * model.opt.timestep, dtype=np.float64)
    goals = excitation.at(t)
    late = delay > 0.0
    if late.any():
        goals[:, late] = excitation.at(t - delay.max())[:, late]
    return _Case(one, goals - zero, zero)


def _scaled(model: Any, servo: str, field: str, ratio: float) -> Any:  # noqa: ANN401
    """A copy of a model with one servo class changed."""
    changed = copy.copy(model)
    actuators = actuators_of(model, servo)
    dofs = dofs_of(model, actuators)
    if field == "gain_scale":
        changed.actuator_gainprm[actuators, 0] *= ratio
        changed.actuator_biasprm[actuators, 1] *= ratio
        changed.actuator_forcerange[actuators] *= ratio
    elif field == "damping_scale":
        changed.dof_damping[dofs] *= ratio
    else:
        changed.dof_frictionloss[dofs] *= ratio
    return changed


def _run(joints: Joints, cases: Sequence[_Case]) -> FloatArray:
    """Angles and speeds as read every period, shape (cases, T, 2 n)."""
    first = cases[0].model
    actuators, qpos, dof = order_of(first, joints)
    skip = round(PERIOD / first.opt.timestep)
    data = mujoco.MjData(first)
    data.qpos[qpos] = cases[0].goals[0]
    size = mujoco.mj_stateSize(first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.empty((len(cases), size))
    control = np.empty((len(cases), len(cases[0].goals), first.nu))
    for i, case in enumerate(cases):
        data.qpos[qpos] = case.goals[0]
        mujoco.mj_getState(first, data, start[i], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        control[i][:, actuators] = case.goals
    states, _ = rollout.rollout([case.model for case in cases], [data], start, control)
    kept = states[:, skip - 1 :: skip]
    # A full state is the time, then positions, then speeds.
    zeros = np.stack([case.zero for case in cases])[:, None]
    return np.concatenate([kept[..., 1 + qpos] + zeros, kept[..., 1 + first.nq + dof]], axis=-1)


def _of_velocity_delay(readings: FloatArray, n: int) -> FloatArray:
    """Change of all readings by the age of velocities, shape (T, 2 n)."""
    slope = np.zeros_like(readings)
    slope[:, n:] = -np.gradient(readings[:, n:], PERIOD, axis=0)
    return slope

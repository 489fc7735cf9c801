"""What a foreign model must have to be trained: a floor, a servo on each hinge, parts that collide, limits."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from frasa_sysid.calibration import ModelError
from frasa_sysid.calibration.anatomy import Hinge, lowest_points

_FREE = 1e6  # [rad] stands for no command limit


def floor_of(path: Path, model: mujoco.MjModel) -> int:
    """The geom that is the floor.

    Raises:
        ModelError: there is none, or it has no name.
    """
    plane = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    solid = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    geoms = np.flatnonzero(plane & solid)
    if not geoms.size:
        raise ModelError(f'{path} has no floor: add <geom name="floor" type="plane" size="0 0 0.05"/> to its worldbody')
    if not model.geom(int(geoms[0])).name:
        raise ModelError(f'{path}: the floor has no name: write <geom name="floor" type="plane" .../>')
    return int(geoms[0])


def check_actuators(path: Path, model: mujoco.MjModel) -> None:
    """See that every actuator is a plain position servo of a hinge of its own.

    Raises:
        ModelError: one that is not.
    """
    if not model.nu:
        raise ModelError(f"{path} has no actuators: give each joint that a servo turns a <position> one")
    seen: set[int] = set()
    for i in range(model.nu):
        joint = int(model.actuator_trnid[i, 0])
        name = model.actuator(i).name or f"number {i + 1}"
        if (
            model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT
            or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE
        ):
            raise ModelError(f"{path}: actuator {name} turns no hinge; only servos of hinges can be trained")
        where = model.joint(joint).name
        if not where:
            raise ModelError(f"{path}: actuator {name} turns a joint without a name: give it one")
        if model.actuator_biasprm[i, 1] >= 0.0 or model.actuator_gainprm[i, 0] <= 0.0:
            raise ModelError(
                f"{path}: actuator {name} of joint {where} is a torque motor without a position gain: a servo is "
                f'<position joint="{where}" kp="..." forcerange="..."/>'
            )
        if model.actuator_dyntype[i] != mujoco.mjtDyn.mjDYN_NONE:
            raise ModelError(f"{path}: actuator {name} has activation dynamics: expected a plain position servo")
        if model.actuator_gear[i, 0] != 1.0:
            raise ModelError(
                f"{path}: actuator {name} has gear {model.actuator_gear[i, 0]:g}: expected 1, so that its command is "
                "the joint's angle"
            )
        if joint in seen:
            raise ModelError(f"{path}: joint {where} has more than one actuator: expected one servo each")
        seen.add(joint)


def check_collision(path: Path, model: mujoco.MjModel, trunk: int, floor: int) -> None:
    """See that trunk and feet can touch the floor.

    Args:
        path: for messages.
        model: compiled.
        trunk: body.
        floor: geom.

    Raises:
        ModelError: they go through it.
    """
    own = model.body_rootid[model.geom_bodyid] == trunk
    kind, meets = model.geom_contype, model.geom_conaffinity
    touches = ((kind & meets[floor]) | (kind[floor] & meets)) != 0
    bodies = np.unique(model.geom_bodyid[own & touches])
    if trunk not in model.body_weldid[bodies]:
        raise ModelError(
            f"{path}: nothing of the trunk '{model.body(trunk).name}' collides with the floor: give it a geom that "
            "does (contype and conaffinity), or it falls through"
        )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = lowest_points(model, data, trunk)
    every = _lowest_of_all(model, data, own)
    if not solid or min(solid.values()) > every + 0.02:
        raise ModelError(
            f"{path}: what collides ends {min(solid.values(), default=0.0) - every:.2f} m above the robot's lowest "
            "point: give its feet geoms that collide"
        )


def _lowest_of_all(model: mujoco.MjModel, data: mujoco.MjData, own: NDArray[np.bool_]) -> float:
    up = data.geom_xmat[own].reshape(-1, 3, 3)[:, 2]
    centre, half = model.geom_aabb[own, :3], model.geom_aabb[own, 3:]
    return float((data.geom_xpos[own, 2] + np.sum(up * centre - np.abs(up) * half, axis=1)).min())


def limits_of(path: Path, model: mujoco.MjModel, one: Hinge) -> tuple[float, float]:
    """How far a joint may be commanded [rad]: as its actuator says, else as the joint does.

    Raises:
        ModelError: nobody limits it.
    """
    low, high = model.actuator_ctrlrange[one.actuator] if model.actuator_ctrllimited[one.actuator] else (-_FREE, _FREE)
    if model.jnt_limited[one.joint]:
        low, high = max(low, model.jnt_range[one.joint, 0]), min(high, model.jnt_range[one.joint, 1])
    if high - low >= _FREE:
        raise ModelError(f"{path}: neither joint {one.name} nor its actuator has a range: give one of them a limit")
    if not low < high:
        raise ModelError(f"{path}: joint {one.name} and its actuator have no range in common")
    return float(low), float(high)

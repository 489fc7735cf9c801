"""Where an episode starts: a robot that fell and came to rest, one that is nearly standing, or one that still falls.

Every start is simulated under the model of its own episode, after every delay buffer was filled with the
released robot at rest: whatever a drawn delay is, no reading is of another episode or of none.
"""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.config import Task
from frasa_rl.robot import Floats, Robot, pitch_of
from frasa_sysid.calibration import ModelError, hold_history

Kind = Literal["any", "random", "prone", "supine", "target", "falling"]

_LYING_DEG = 45.0  # a robot on its front or back has at least this pitch, whatever props it up
_ATTEMPTS = 50


@dataclass(frozen=True)
class Start:
    """How the robot is released.

    Attributes:
        joints: commands of the moved joints, seen from the left [rad], shape (n,).
        pitch: trunk pitch [rad].
        settle_s: longest time before the episode starts [s].
    """

    joints: Floats
    pitch: float
    settle_s: float


def draw_start(robot: Robot, task: Task, rng: Generator, kind: Kind = "any") -> Start:
    """A random start.

    `any` is what training uses: a share near the standing pose, a share still falling, the rest `random`.
    """
    if kind == "any":
        chance = rng.random() - np.cumsum([task.near_target_share, task.falling_share])
        kind = "target" if chance[0] < 0.0 else "falling" if chance[1] < 0.0 else "random"
    if kind == "target":
        return _near_target(robot, task, rng)
    return _falling(robot, task, rng) if kind == "falling" else _random(robot, task, rng, kind)


def _near_target(robot: Robot, task: Task, rng: Generator) -> Start:
    """The standing pose with a small offset on every joint."""
    offsets = rng.uniform(-task.near_target_spread, task.near_target_spread, len(task.joints))
    pose, pitch = _standing(task)
    return Start(np.clip(pose + offsets, robot.limits[:, 0], robot.limits[:, 1]), pitch, task.settle_max_s)


def _falling(robot: Robot, task: Task, rng: Generator) -> Start:
    """Anywhere between the standing pose and a random start, released and caught in mid-fall."""
    (pose, pitch), other, share = _standing(task), _random(robot, task, rng, "random"), rng.random()
    return Start(pose + share * (other.joints - pose), pitch + share * (other.pitch - pitch), task.falling_s)


def _random(robot: Robot, task: Task, rng: Generator, kind: Kind) -> Start:
    """Joints uniform inside the command limits, pitch as the kind asks."""
    half = task.start_pitch_deg
    pitch = rng.uniform(*{"prone": (60.0, 90.0), "supine": (-90.0, -60.0)}.get(kind, (-half, half)))
    joints: Floats = rng.uniform(robot.limits[:, 0], robot.limits[:, 1])
    return Start(joints, float(np.radians(pitch)), task.settle_max_s)


def _standing(task: Task) -> tuple[Floats, float]:
    """Joints (n,) and pitch of the standing pose [rad]."""
    return np.radians([one.target_deg for one in task.joints]), float(np.radians(task.target_pitch_deg))


def settle_start(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, task: Task, rng: Generator, kind: Kind = "any"
) -> None:
    """Put the robot into a start of that kind and leave `data` after `mj_forward`.

    A draw that diverges, or comes to rest where the episode would already be over or
    on another side than asked, is drawn again.

    Raises:
        ModelError: no draw came to rest as asked.
    """
    for _ in range(_ATTEMPTS):
        start = draw_start(robot, task, rng, kind)
        release(model, data, robot, task, start)
        if settle(model, data, task, robot.substeps, start.settle_s) and _as_asked(robot, data, task, kind):
            return
    raise ModelError(f"none of {_ATTEMPTS} random '{kind}' starts came to rest as it should: does the model stand?")


def release(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, task: Task, start: Start) -> None:
    """Place the robot at rest, its lowest point a small gap above the floor, its servos commanded to hold."""
    mujoco.mj_resetData(model, data)
    data.ctrl[:] = robot.held
    data.ctrl[robot.actuators] = robot.both_sides(start.joints)
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = data.ctrl
    root = model.jnt_qposadr[model.body_jntadr[robot.trunk]]
    data.qpos[root : root + 7] = (0.0, 0.0, 1.0, np.cos(start.pitch / 2), 0.0, np.sin(start.pitch / 2), 0.0)
    mujoco.mj_kinematics(model, data)
    floor = data.geom_xpos[robot.floor, 2]
    data.qpos[root + 2] += floor + task.release_height - lowest_point(model, data)
    hold_history(model, data)


def settle(model: mujoco.MjModel, data: mujoco.MjData, task: Task, substeps: int, longest_s: float) -> bool:
    """Simulate until the robot has been at rest for `still_s`, at most `longest_s`.

    Returns:
        Whether the simulation stayed finite.
    """
    quiet = 0
    for _ in range(round(longest_s / task.control_period_s)):
        mujoco.mj_step(model, data, nstep=substeps)
        if diverged(data):
            return False
        quiet = quiet + 1 if np.abs(data.qvel).max() < task.still_speed else 0
        if quiet * task.control_period_s >= task.still_s:
            break
    mujoco.mj_forward(model, data)
    return True


def diverged(data: mujoco.MjData) -> bool:
    """Whether MuJoCo has found a position, velocity or acceleration that is not finite or huge since the reset."""
    bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    if any(data.warning[one].number for one in bad):
        return True
    return not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all())


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Height of the lowest point of the robot's bounding boxes [m]; exact for boxes, safe for the rest."""
    robot = model.geom_bodyid != 0
    rotation = data.geom_xmat[robot].reshape(-1, 3, 3)
    centre, half = model.geom_aabb[robot, :3], model.geom_aabb[robot, 3:]
    heights = data.geom_xpos[robot, 2] + np.einsum("ni,ni->n", rotation[:, 2], centre)
    return float((heights - np.einsum("ni,ni->n", np.abs(rotation[:, 2]), half)).min())


def _as_asked(robot: Robot, data: mujoco.MjData, task: Task, kind: Kind) -> bool:
    pitch = np.degrees(pitch_of(data.sensordata[robot.orientation]))
    if abs(pitch) > task.end_pitch_deg:
        return False
    if kind == "prone":
        return bool(pitch > _LYING_DEG)
    return bool(pitch < -_LYING_DEG) if kind == "supine" else True

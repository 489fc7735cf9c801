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
from frasa_rl.poses import place, standing
from frasa_rl.robot import Floats, Robot, pitch_of
from frasa_rl.simulation import Start, fresh, set_state, state_of
from frasa_sysid.calibration import hold_history

Kind = Literal["any", "random", "prone", "supine", "target", "falling"]

LYING_DEG = 45.0  # a robot on its front or back has at least this pitch, whatever props it up


@dataclass(frozen=True)
class Release:
    """How the robot is let go.

    Attributes:
        joints: commands of the moved joints, seen from the left [rad], shape (n,).
        pitch: trunk pitch [rad].
        settle_s: longest time before the episode starts [s].
        kind: which of the kinds it is.
    """

    joints: Floats
    pitch: float
    settle_s: float
    kind: Kind = "random"


def draw_release(robot: Robot, task: Task, rng: Generator, kind: Kind = "any") -> Release:
    """A random release.

    `any` is what training uses: a share near the standing pose, a share still falling, the rest `random`.
    """
    if kind == "any":
        chance = rng.random() - np.cumsum([task.near_target_share, task.falling_share])
        kind = "target" if chance[0] < 0.0 else "falling" if chance[1] < 0.0 else "random"
    if kind == "target":
        return _near_target(robot, task, rng)
    return _falling(robot, task, rng) if kind == "falling" else _random(robot, task, rng, kind)


def _near_target(robot: Robot, task: Task, rng: Generator) -> Release:
    """The standing pose with a small offset on every joint."""
    offsets = rng.uniform(-task.near_target_spread, task.near_target_spread, len(task.joints))
    pose, pitch = standing(task)
    joints = np.clip(pose + offsets, robot.limits[:, 0], robot.limits[:, 1])
    return Release(joints, pitch, task.settle_max_s, "target")


def _falling(robot: Robot, task: Task, rng: Generator) -> Release:
    """Anywhere between the standing pose and a random start, released and caught in mid-fall."""
    (pose, pitch), other, share = standing(task), _random(robot, task, rng, "random"), rng.random()
    joints, pitch = pose + share * (other.joints - pose), pitch + share * (other.pitch - pitch)
    return Release(joints, pitch, task.falling_s, "falling")


def _random(robot: Robot, task: Task, rng: Generator, kind: Kind) -> Release:
    """Joints uniform inside the command limits, pitch as the kind asks."""
    half = task.start_pitch_deg
    pitch = rng.uniform(*{"prone": (60.0, 90.0), "supine": (-90.0, -60.0)}.get(kind, (-half, half)))
    joints: Floats = rng.uniform(robot.limits[:, 0], robot.limits[:, 1])
    return Release(joints, float(np.radians(pitch)), task.settle_max_s, kind)


def let_go(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, task: Task, how: Release, drawn: dict[str, float]
) -> Start:
    """A robot at rest, its lowest point a small gap above the floor, its servos commanded to hold.

    Args:
        model: the robot's own; its sensors are made `fresh` here unless they are already.
        data: of the same sizes, overwritten.
        robot: where things are.
        task: the gap.
        how: joints and pitch.
        drawn: what was randomized.
    """
    place(model, data, robot, how.joints, how.pitch, task.release_height)
    hold_history(model, data)
    ages = fresh(model)
    return Start(model, state_of(model, data), data.ctrl.copy(), data.sensordata.copy(), ages, drawn, kind=how.kind)


def pushed(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, task: Task, state: Floats, rng: Generator
) -> Floats:
    """A state right after a push at the trunk's centre of mass, forward or back, as hard as the task says.

    The momentum is the whole robot's mass times the drawn speed. Until the next step the floor does not push back.

    Args:
        model: the robot's own.
        data: of the same sizes, overwritten.
        robot: where things are.
        task: the largest speed.
        state: before.
        rng: draws the speed.
    """
    set_state(model, data, state)
    momentum = rng.uniform(-task.near_target_push, task.near_target_push) * model.body_subtreemass[robot.trunk]
    force, change = np.zeros(model.nv), np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, [momentum, 0, 0], np.zeros(3), data.xipos[robot.trunk], robot.trunk, force)
    mujoco.mj_solveM(model, data, change[None], force[None])
    after = state.copy()
    after[1 + model.nq : 1 + model.nq + model.nv] += change
    return after


def as_asked(robot: Robot, state: Floats, task: Task, kind: Kind) -> bool:
    """Whether a robot came to rest where the episode is not over, on the side that was asked for."""
    start = 1 + robot.root_qpos + 3
    pitch = float(np.degrees(pitch_of(state[start : start + 4])))
    if abs(pitch) > task.end_pitch_deg:
        return False
    if kind == "prone":
        return pitch > LYING_DEG
    return pitch < -LYING_DEG if kind == "supine" else True

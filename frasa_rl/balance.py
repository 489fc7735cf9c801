"""Robots that stand in their target pose: the commands that hold them there, found by simulation.

A servo without an integral term sags: commanding the target pose leaves the Sigmaban's knees 9 deg off. A slow
correction of the commands by the joints' errors finds what to command instead; every trial's robot has its own.
"""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.batch import Batch
from frasa_rl.config import Task
from frasa_rl.falls import Release, let_go
from frasa_rl.poses import standing
from frasa_rl.robot import Floats, Robot
from frasa_rl.simulation import Start

SPREAD = 0.01  # half-width of the joint offsets that make trials differ [rad]: half a degree
_GAIN = 0.4  # share of the error that is corrected in a second; from 1 on the Sigmaban rocks until it falls
_FIRST_S = 6.0  # for a robot that starts from the target pose as its command
_THEN_S = 4.0  # for one that starts from the commands of another


def goals(task: Task, chances: Sequence[Generator]) -> Floats:
    """The joint angles each trial shall stand in, near the target pose [rad], shape (trials, n)."""
    pose, _ = standing(task)
    return np.stack([pose + one.uniform(-SPREAD, SPREAD, pose.size) for one in chances])


def first_correction(model: mujoco.MjModel, robot: Robot, task: Task, threads: int | None) -> Floats:
    """What to add to the target pose so that the robot of the model file stands in it [rad], shape (n,)."""
    pose, _ = standing(task)
    batch = Batch(model, task, 1, threads)
    try:
        batch.put(0, upright(model, robot, task, pose, np.zeros_like(pose)))
        balance(batch, pose[None], _FIRST_S)
        return np.asarray(batch.commands[0] - pose)
    finally:
        batch.close()


def upright(model: mujoco.MjModel, robot: Robot, task: Task, pose: Floats, correction: Floats) -> Start:
    """A robot put on its feet in a pose.

    Args:
        model: its own; `fresh` when it comes back.
        robot: where things are.
        task: pitch of the trunk.
        pose: joints, seen from the left [rad], shape (n,).
        correction: of the commands [rad], shape (n,).
    """
    _, pitch = standing(task)
    start = let_go(model, mujoco.MjData(model), robot, task, Release(pose, pitch, 0.0), {})
    ctrl = start.ctrl.copy()
    commands = np.clip(pose + correction, robot.limits[:, 0], robot.limits[:, 1])
    ctrl[robot.actuators] = robot.both_sides(commands)
    return replace(start, ctrl=ctrl)


def balance(batch: Batch, wanted: Floats, seconds: float = _THEN_S) -> None:
    """Correct the commands of all robots until their joints are where they shall be, shape (count, n) [rad]."""
    rate = batch.task.rate_limit
    for _ in range(round(seconds / batch.period_s)):
        error = wanted - batch.robot.mean_of_sides(batch.now.positions)
        batch.act(np.clip(_GAIN * error / rate, -1.0, 1.0))

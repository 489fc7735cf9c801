"""The four terms of the reward, each a pure function of what is true (undelayed) in the simulation.

    posture       exp(-20 |psi - psi*|^2)   psi: 5 joint angles, mean of both sides, and the trunk pitch [rad]
    action        0.10 exp(-|a|)            a: commanded joint rates [rad/s]; in the published code, not in the paper
    variation     0.05 exp(-|a - a_prev|)
    self_contact  0.10 exp(-sum of forces)  contact forces between parts of the robot [N]: nearly 1 or 0

At most 1.25 a step. Source: FRASA, arXiv 2410.08655, and its published environment.
"""

import mujoco
import numpy as np

from frasa_rl.config import Reward, Task
from frasa_rl.robot import Floats, Robot, pitch_of


def errors(robot: Robot, data: mujoco.MjData, task: Task) -> Floats:
    """The joint errors (mean of both sides) and the pitch error to the standing pose [rad], shape (6,)."""
    target = np.radians([*(one.target_deg for one in task.joints), task.target_pitch_deg])
    now = [*robot.mean_of_sides(data.qpos[robot.qpos]), pitch_of(data.sensordata[robot.orientation])]
    return np.asarray(now - target, dtype=np.float64)


def self_contact_force(robot: Robot, data: mujoco.MjData) -> float:
    """Sum of the contact force norms between parts of the robot [N]."""
    return float(np.linalg.norm(data.sensordata[robot.self_contact].reshape(-1, 3), axis=1).sum())


def posture(weights: Reward, error: Floats) -> float:
    """1 in the standing pose, from the errors [rad], shape (6,)."""
    return weights.posture * float(np.exp(-weights.posture_slope * error @ error))


def action(weights: Reward, rates: Floats) -> float:
    """Largest for standing still, from the commanded rates [rad/s], shape (5,)."""
    return weights.action * float(np.exp(-weights.action_slope * np.linalg.norm(rates)))


def variation(weights: Reward, rates: Floats, previous: Floats) -> float:
    """Largest for a steady command, from two successive rates [rad/s], shape (5,) each."""
    return weights.variation * float(np.exp(-weights.action_slope * np.linalg.norm(rates - previous)))


def self_contact(weights: Reward, force: float) -> float:
    """Largest when no part of the robot touches another, from the sum of forces [N]."""
    return weights.self_contact * float(np.exp(-weights.contact_slope * force))

"""The four terms of the reward, each a pure function of what is true (undelayed) in the simulation.

    posture       exp(-20 |psi - psi*|^2)   psi: 5 joint angles, mean of both sides, and the trunk pitch [rad]
    action        0.10 exp(-|a|)            a: commanded joint rates [rad/s]; in the published code, not in the paper
    variation     0.05 exp(-|a - a_prev|)
    self_contact  0.10 exp(-sum of forces)  contact forces between parts of the robot [N]: nearly 1 or 0

At most 1.25 a step. Arrays of any leading shape. Source: FRASA, arXiv 2410.08655, and its published environment.
"""

import numpy as np

from frasa_rl.config import Reward, Task
from frasa_rl.readings import Truth
from frasa_rl.robot import Floats, Robot


def target(task: Task) -> Floats:
    """Joint angles and trunk pitch of the standing pose [rad], shape (6,)."""
    return np.radians([*(one.target_deg for one in task.joints), task.target_pitch_deg])


def errors(robot: Robot, now: Truth, task: Task) -> Floats:
    """The joint errors (mean of both sides) and the pitch error to the standing pose [rad], shape (count, 6)."""
    pose = np.concatenate([robot.mean_of_sides(now.positions), now.pitch[:, None]], axis=1)
    return np.asarray(pose - target(task))


def posture(weights: Reward, error: Floats) -> Floats:
    """1 in the standing pose, from the errors [rad], shape (..., 6)."""
    return np.asarray(weights.posture * np.exp(-weights.posture_slope * np.sum(error**2, axis=-1)))


def action(weights: Reward, rates: Floats) -> Floats:
    """Largest for standing still, from the commanded rates [rad/s], shape (..., 5)."""
    return np.asarray(weights.action * np.exp(-weights.action_slope * np.linalg.norm(rates, axis=-1)))


def variation(weights: Reward, rates: Floats, previous: Floats) -> Floats:
    """Largest for a steady command, from two successive rates [rad/s], shape (..., 5) each."""
    return np.asarray(weights.variation * np.exp(-weights.action_slope * np.linalg.norm(rates - previous, axis=-1)))


def self_contact(weights: Reward, force: Floats) -> Floats:
    """Largest when no part of the robot touches another, from the sum of forces [N]."""
    return np.asarray(weights.self_contact * np.exp(-weights.contact_slope * force))

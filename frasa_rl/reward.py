"""The terms of the reward, each a pure function of what is true (undelayed) in the simulation.

    posture       exp(-20 |psi - psi*|^2)   psi: 5 joint angles, mean of both sides, and the trunk pitch [rad]
    action        0.10 exp(-|a|)            a: commanded joint rates [rad/s]; in the published code, not in the paper
    variation     0.05 exp(-|a - a_prev|)
    self_contact  0.10 exp(-sum of forces)  contact forces between parts of the robot [N]: nearly 1 or 0

At most 1.25 a step. Arrays of any leading shape. Source: FRASA, arXiv 2410.08655, and its published environment.

Away from the standing pose these are flat: 25 deg off in pitch alone, the posture term is 0.02. Two more, with weights
of 0 unless a training preset says otherwise, lead there:

    gathering     exp(-|c - c*|^2 / 0.72) (0.3 + 0.7 f) (0.3 + 0.7 v)     c: centre of mass seen from the feet, as a
                                                                  share of its height when standing (c* = 0, 0, 1)
    approach      h u (exp(-2 e) + exp(-8 e) + exp(-64 e) (1 - b)) / 3      e: |psi - psi*|^2, b: a's root
                                                                  mean square, as a share of the largest rate

h is the height of the trunk, u and v how upright it is (v without a peak), f how flat the feet are, from 0 to 1. They
know where standing is and nothing of the way: no expert, no key pose. What has its mass above flat feet is on its way
up, from the front and from the back; paid for height and an upright trunk alone, robots sit with their legs out, kneel
or bridge, and stay so. `tests/benchmarks/bench_recipe.py` has training without each of them.
"""

import numpy as np

from frasa_rl.config import Reward, Task
from frasa_rl.readings import Truth
from frasa_rl.robot import Floats, Robot

_GATHERED = 0.6  # how far off the centre of mass may be, as a share of its height when standing
_LYING = 0.25  # share of the standing height at which a trunk lies flat
PAPER_TERMS = ("posture", "action", "variation", "self_contact")
TERMS = (*PAPER_TERMS, "gathering", "approach")


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


def height_share(height: Floats, standing: float) -> Floats:
    """How high the trunk is, from 0 (lying: a quarter of the standing height) to 1 (standing or higher).

    Args:
        height: of the trunk above the floor [m], shape (...,).
        standing: the same in the standing pose [m].
    """
    return np.asarray(np.clip((height / standing - _LYING) / (1.0 - _LYING), 0.0, 1.0))


def upright_share(pitch_error: Floats) -> Floats:
    """How upright the trunk is, from 0 (upside down) to 1, from the pitch error [rad], shape (...,).

    Half of it has a slope everywhere, the other half only within some 40 deg, so that leaning on the arms
    (50 deg) is worth well below standing.
    """
    return np.asarray(0.25 * (1.0 + np.cos(pitch_error)) + 0.5 * np.exp(-4.0 * pitch_error**2))


def gathering(weights: Reward, above: Floats, flat: Floats, pitch_error: Floats) -> Floats:
    """Largest with the centre of mass straight above flat feet, as high as when standing, and an upright trunk.

    Getting up from a squat on the back leans far forward first, so that the trunk's share must have no sharp peak.

    Args:
        weights: of the terms.
        above: the centre of mass seen from between the feet, as a share of its height when standing, shape (..., 3).
        flat: how flat the feet are, from 0 to 1, shape (...,); kneeling is no standing.
        pitch_error: of the trunk [rad], shape (...,).
    """
    near = np.exp(-np.sum((above - [0.0, 0.0, 1.0]) ** 2, axis=-1) / (2.0 * _GATHERED**2))
    upright = (1.0 + np.cos(pitch_error)) / 2.0
    return np.asarray(weights.gathering * near * (0.3 + 0.7 * flat) * (0.3 + 0.7 * upright))


def approach(weights: Reward, high: Floats, upright: Floats, error: Floats, shares: Floats) -> Floats:
    """Largest standing still in the standing pose, felt from further away than the posture term.

    Of three widths: no pose half a radian off looks like the end of the way, and none that is 6 deg off either. The
    last is for robots that hold still: beside all that leads, the action term is too small, and too flat where rates
    are large, to keep a policy from shaking its joints to and fro where it stands.

    Args:
        weights: of the terms.
        high: how high the trunk is, from 0 to 1, shape (...,).
        upright: how upright it is, likewise.
        error: to the standing pose [rad], shape (..., 6).
        shares: commanded rates as shares of the rate limit, shape (..., 5).
    """
    square = weights.approach_slope * np.sum(error**2, axis=-1)
    wide, middle, narrow = (np.exp(-factor * square) for factor in (1.0, 4.0, 32.0))
    still = 1.0 - np.sqrt(np.mean(shares**2, axis=-1))
    return np.asarray(weights.approach * high * upright * (wide + middle + narrow * still) / 3.0)

"""Each term of the reward equals what a person computes with the published formula."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl import reward
from frasa_rl.config import Reward, Task

WEIGHTS = Reward()


def test_posture():
    """exp(-20 |e|^2): 1 in the pose, 1/e at an error of 1/sqrt(20) rad."""
    assert reward.posture(WEIGHTS, np.zeros(6)) == 1.0
    assert reward.posture(WEIGHTS, np.array([0.1, 0, 0, -0.2, 0, 0])) == pytest.approx(np.exp(-1.0))


def test_action():
    """0.10 exp(-|a|) with a in rad/s."""
    assert reward.action(WEIGHTS, np.zeros(5)) == 0.10
    assert reward.action(WEIGHTS, np.array([3.0, 0, -4.0, 0, 0])) == pytest.approx(0.1 * np.exp(-5.0))


def test_variation():
    """0.05 exp(-|a - a_prev|) with a in rad/s."""
    a = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert reward.variation(WEIGHTS, a, a) == 0.05
    assert reward.variation(WEIGHTS, a, a - [0, 2.0, 0, 0, 0]) == pytest.approx(0.05 * np.exp(-2.0))


def test_self_contact():
    """0.10 exp(-force): 0.1 without contact, practically nothing from a few newtons on."""
    assert reward.self_contact(WEIGHTS, 0.0) == 0.10
    assert reward.self_contact(WEIGHTS, 2.0) == pytest.approx(0.1 * np.exp(-2.0))


GUIDED = Reward(gathering=0.4, approach=1.0)


def test_gathering():
    """Full with flat feet under the mass of an upright trunk; each share lost is lost of all."""
    right = np.array([0.0, 0.0, 1.0])
    assert reward.gathering(GUIDED, right, 1.0, 0.0) == pytest.approx(0.4)
    assert reward.gathering(GUIDED, right, 0.5, 0.0) == pytest.approx(0.4 * 0.65)
    assert reward.gathering(GUIDED, right, 1.0, np.pi / 2) == pytest.approx(0.4 * 0.65)
    assert reward.gathering(GUIDED, right, 0.0, np.pi) == pytest.approx(0.4 * 0.3 * 0.3)
    for off in ([0.6, 0.0, 0.0], [0.0, -0.6, 0.0], [0.0, 0.0, -0.6], [0.36, 0.48, 0.0]):
        assert reward.gathering(GUIDED, right + off, 1.0, 0.0) == pytest.approx(0.4 * np.exp(-0.5))


def test_approach():
    """Means of exp(-2 k |e|^2), k 1, 4, 32, times h u: felt half a radian away; and stillness."""
    error = np.array([0.5, 0, 0, 0, 0, 0])
    mean = (np.exp(-0.5) + np.exp(-2.0) + np.exp(-16.0)) / 3
    still = np.zeros(5)
    assert reward.approach(GUIDED, 1.0, 1.0, error, still) == pytest.approx(mean)
    assert reward.approach(GUIDED, 0.5, 0.5, error, still) == pytest.approx(0.25 * mean)
    moving = np.array([0.0, 0.0, 0.3, 0.0, 0.4])
    assert reward.approach(GUIDED, 1.0, 1.0, 0.0 * error, moving) == pytest.approx((3.0 - 0.5 / np.sqrt(5)) / 3)
    assert reward.posture(GUIDED, error) < 0.01


def test_height_and_uprightness():
    """Lying flat and standing are 0 and 1; leaning on the arms at 50 deg is worth half of standing upright."""
    np.testing.assert_allclose(reward.height_share(np.array([0.05, 0.08, 0.2, 0.32, 0.4]), 0.32), [0, 0, 0.5, 1, 1])
    np.testing.assert_allclose(
        reward.upright_share(np.radians([0.0, 50.0, 180.0])), [1.0, 0.4107 + 0.5 * np.exp(-4 * 0.7615), 0.0], atol=1e-3
    )


def test_the_height_is_that_of_the_trunk_over_the_floor(plain_env):
    """In the standing pose the trunk is as high as standing, within what it sinks and settles."""
    plain_env.reset(seed=0, options={"start": "target"})
    core = plain_env.core
    assert core.batch.now.height[0] - core._floor == pytest.approx(core._standing_height, abs=0.01)


def test_forces_are_summed_over_contacts(plain_env, start_by_hand):
    """The self-contact force is the sum of the norms of all its slots."""
    plain_env.reset(seed=0)
    start, slots = start_by_hand(plain_env), np.zeros((8, 3))
    slots[0], slots[3] = (3.0, 0.0, 4.0), (0.0, 2.0, 0.0)
    sensors = start.sensors.copy()
    sensors[plain_env.robot.self_contact] = slots.ravel()
    plain_env.core.begin(0, replace(start, sensors=sensors))
    assert plain_env.core.batch.now.contact[0] == pytest.approx(7.0)


def test_errors_use_both_sides_and_forward_pitch(plain_env, start_by_hand):
    """The errors are mean joint angles minus the pose, then the pitch minus +8.5 deg, leaning forward positive."""
    env = plain_env
    env.reset(seed=0)
    qpos, half = env.data.qpos.copy(), np.radians(10.5) / 2
    qpos[env.robot.qpos] = np.radians([[one.target_deg - 1, one.target_deg + 3] for one in Task().joints])
    qpos[3:7] = (np.cos(half), 0.0, np.sin(half), 0.0)
    env.core.begin(0, start_by_hand(env, qpos))
    np.testing.assert_allclose(np.degrees(env.errors()), [1, 1, 1, 1, 1, 2], atol=1e-9)


def test_a_step_pays_the_sum_of_its_terms(plain_env):
    """The reward is the sum of its terms of the applied action in rad/s."""
    plain_env.reset(seed=0, options={"start": "target"})
    action = np.array([0.05, 0, 0, 0, 0])
    _, paid, _, _, info = plain_env.step(action)
    assert paid == pytest.approx(sum(info["terms"].values()))
    assert info["terms"]["action"] == pytest.approx(0.10 * np.exp(-0.05 * 2 * np.pi))
    assert info["terms"]["variation"] == pytest.approx(0.05 * np.exp(-0.05 * 2 * np.pi))
    assert set(info["terms"]) == set(reward.TERMS)
    assert info["terms"]["gathering"] == info["terms"]["approach"] == 0.0  # the paper has no such terms

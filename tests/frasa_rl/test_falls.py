"""Episodes start with a robot at rest, settled under its own model."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.falls import draw_start, lowest_point, release
from frasa_rl.robot import pitch_of
from frasa_rl.standup_env import StandUp


def pitch_deg(env):
    return np.degrees(pitch_of(env.data.sensordata[env.robot.orientation]))


def test_released_above_the_ground(env):
    """Whatever the drawn pose, the lowest point is released a centimetre above the floor, touching nothing."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        release(env.model, env.data, env.robot, env.task, draw_start(env.robot, env.task, rng))
        mujoco.mj_forward(env.model, env.data)
        assert lowest_point(env.model, env.data) == pytest.approx(env.task.release_height, abs=1e-9)
        assert not (env.data.contact.geom == env.robot.floor).any()


def test_joints_are_uniform_inside_their_limits(env):
    """Random joints are uniform inside the command limits, not piled up on them as upstream."""
    rng = np.random.default_rng(1)
    starts = [draw_start(env.robot, replace(env.task, near_target_share=0.0), rng) for _ in range(2000)]
    low, high = env.robot.limits.T
    shares = (np.array([one.joints for one in starts]) - low) / (high - low)
    assert shares.min() >= 0.0
    assert shares.max() <= 1.0
    np.testing.assert_allclose(
        np.quantile(shares, [0.25, 0.5, 0.75], axis=0).mean(axis=1), [0.25, 0.5, 0.75], atol=0.03
    )
    assert np.degrees([one.pitch for one in starts]).min() < -85
    assert np.degrees([one.pitch for one in starts]).max() > 85


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
def test_the_share_of_near_starts_is_the_tasks(env, share):
    """The share of starts near the standing pose is what the task says (upstream bug B9)."""
    rng = np.random.default_rng(2)
    starts = [draw_start(env.robot, replace(env.task, near_target_share=share), rng) for _ in range(2000)]
    target = np.radians([one.target_deg for one in Task().joints])
    near = [np.abs(one.joints - target).max() <= env.task.near_target_spread + 1e-12 for one in starts]
    assert np.mean(near) == pytest.approx(share, abs=0.03)


def test_falling_starts_reach_from_standing_to_anything(env):
    """Starts still falling lie between the standing pose and a random one, and last shorter than a settled fall."""
    rng = np.random.default_rng(3)
    task = replace(env.task, near_target_share=0.0, falling_share=1.0)
    starts = [draw_start(env.robot, task, rng) for _ in range(500)]
    low, high = env.robot.limits.T
    assert all((low <= one.joints).all() and (one.joints <= high).all() for one in starts)
    away = np.abs(np.degrees([one.pitch for one in starts]) - Task().target_pitch_deg)
    assert away.min() < 2.0
    assert away.max() > 70.0
    assert {one.settle_s for one in starts} == {task.falling_s}
    assert task.falling_s > env.model.sensor_delay.max()


def test_the_first_observation_is_of_a_robot_at_rest(env):
    """Most starts are still, and none is more than the settling time old."""
    speeds = []
    for seed in range(12):
        env.reset(seed=seed)
        speeds.append(np.abs(env.data.qvel).max())
        assert env.data.time <= env.task.settle_max_s + 1e-9
    assert np.mean(np.array(speeds) < env.task.still_speed) > 0.7


def test_the_drawn_robot_has_settled_before_the_episode(env):
    """Nothing is changed after settling: one more look at the same state sees the same (upstream bug B6)."""
    first, _ = env.reset(seed=3)
    mujoco.mj_setConst(env.model, mujoco.MjData(env.model))
    mujoco.mj_forward(env.model, env.data)
    np.testing.assert_array_equal(env._observe(), first)


def test_a_robot_at_rest_stays_at_rest(env):
    """The first control period moves nothing: the episode runs on the robot that has settled (upstream bug B6)."""
    speeds = []
    for seed in range(12):
        env.reset(seed=seed, options={"start": "random"})
        if np.abs(env.data.qvel).max() < env.task.still_speed:
            env.step(np.zeros(5))
            speeds.append(np.abs(env.data.qvel).max())
    assert len(speeds) > 6
    assert max(speeds) < 2 * env.task.still_speed


def test_no_stale_samples_after_a_reset(env):
    """Delay buffers hold the settled robot: what is measured of a robot at rest is what is true."""
    for seed in range(8):
        env.reset(seed=seed)
        if np.abs(env.data.qvel).max() > env.task.still_speed:
            continue
        sensed, robot = env.data.sensordata, env.robot
        np.testing.assert_allclose(sensed[robot.measured_gyro], sensed[robot.gyro], atol=2 * env.task.still_speed)
        np.testing.assert_allclose(sensed[robot.measured_orientation], sensed[robot.orientation], atol=0.01)
        np.testing.assert_allclose(sensed[robot.position], env.data.qpos[robot.qpos], atol=1e-6)


def test_delayed_servos_hold_from_the_first_instant(calibrated):
    """A servo with a delay is released holding its pose, not told to go to zero first."""
    env = StandUp(calibrated, randomize=False)
    servos = env.robot.actuators
    env.model.actuator_delay[:] = 0.02
    release(
        env.model, env.data, env.robot, env.task, draw_start(env.robot, env.task, np.random.default_rng(0), "target")
    )
    mujoco.mj_step(env.model, env.data)
    np.testing.assert_allclose(env.data.actuator_force[servos], 0.0, atol=1e-6)


@pytest.mark.parametrize(("kind", "low", "high"), [("prone", 45, 135), ("supine", -135, -45)])
def test_lying_starts_lie(env, kind, low, high):
    """Prone starts lie on the front and supine ones on the back, at rest."""
    for seed in range(4):
        env.reset(seed=seed, options={"start": kind})
        assert low < pitch_deg(env) < high


def test_arms_hold_their_roll(env):
    """Joints the policy does not move hold: shoulder rolls 5 deg inward, all others 0."""
    env.reset(seed=0)
    held = {env.model.actuator(i).name: np.degrees(env.data.ctrl[i]) for i in range(env.model.nu)}
    moved = {f"{side}_{one.name}" for side in ("left", "right") for one in Task().joints}
    assert held.pop("left_shoulder_roll") == pytest.approx(-5.0)
    assert held.pop("right_shoulder_roll") == pytest.approx(5.0)
    assert not any(value for name, value in held.items() if name not in moved)

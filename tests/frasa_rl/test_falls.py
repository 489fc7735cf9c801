"""Episodes start with a robot at rest, settled under its own model."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.falls import draw_release, let_go, pushed
from frasa_rl.poses import lowest_point
from frasa_rl.readings import read
from frasa_rl.robot import pitch_of
from frasa_rl.simulation import set_state, state_of
from frasa_rl.standup_env import StandUp
from frasa_rl.starts import StartMaker


def pitch_deg(env):
    return np.degrees(pitch_of(env.data.qpos[3:7]))


def released(env, how):
    """A model of its own and the data of a robot that has just been let go."""
    model = copy.copy(env._maker.original)
    data = mujoco.MjData(model)
    start = let_go(model, data, env.robot, env.task, how, {})
    set_state(model, data, start.state)
    data.ctrl[:] = start.ctrl
    return model, data


def test_released_above_the_ground(env):
    """Whatever the drawn pose, the lowest point is released a centimetre above the floor, touching nothing."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        model, data = released(env, draw_release(env.robot, env.task, rng))
        assert lowest_point(model, data, env.robot) == pytest.approx(env.task.release_height, abs=1e-9)
        assert not (data.contact.geom == env.robot.floor).any()


def test_joints_are_uniform_inside_their_limits(env):
    """Random joints are uniform inside the command limits, not piled up on them as upstream."""
    rng = np.random.default_rng(1)
    starts = [draw_release(env.robot, replace(env.task, near_target_share=0.0), rng) for _ in range(2000)]
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
    starts = [draw_release(env.robot, replace(env.task, near_target_share=share), rng) for _ in range(2000)]
    target = np.radians([one.target_deg for one in Task().joints])
    near = [np.abs(one.joints - target).max() <= env.task.near_target_spread + 1e-12 for one in starts]
    assert np.mean(near) == pytest.approx(share, abs=0.03)


def test_falling_starts_reach_from_standing_to_anything(env):
    """Starts still falling lie between the standing pose and a random one, and last shorter than a settled fall."""
    rng = np.random.default_rng(3)
    task = replace(env.task, near_target_share=0.0, falling_share=1.0)
    starts = [draw_release(env.robot, task, rng) for _ in range(500)]
    low, high = env.robot.limits.T
    assert all((low <= one.joints).all() and (one.joints <= high).all() for one in starts)
    away = np.abs(np.degrees([one.pitch for one in starts]) - Task().target_pitch_deg)
    assert away.min() < 2.0
    assert away.max() > 70.0
    assert {one.settle_s for one in starts} == {task.falling_s}
    assert task.falling_s > env._maker.original.sensor_delay.max() > 0.0


def test_a_push_is_a_momentum_at_the_trunk(env):
    """Its centre of mass moves as fast as drawn, forward or back, nothing is moved yet; without one nothing changes."""
    model, data = released(
        env, draw_release(env.robot, replace(env.task, near_target_share=1.0), np.random.default_rng(4))
    )
    state = state_of(model, data)
    speeds = []
    for seed in range(40):
        task = replace(env.task, near_target_push=0.5)
        after = pushed(model, mujoco.MjData(model), env.robot, task, state, np.random.default_rng(seed))
        set_state(model, data, after)
        mujoco.mj_subtreeVel(model, data)
        speeds.append(data.subtree_linvel[env.robot.trunk].copy())
        moved = slice(1 + model.nq, 1 + model.nq + model.nv)
        np.testing.assert_array_equal(np.delete(after, moved), np.delete(state, moved))
    forward, *aside = np.array(speeds).T
    np.testing.assert_allclose(aside, 0.0, atol=1e-9)
    np.testing.assert_allclose([forward.min(), forward.max()], [-0.5, 0.5], atol=0.06)
    # The trunk is above the centre of mass: a push tips it over forward as it moves forward.
    set_state(model, data, after)
    assert np.sign(data.qvel[env.robot.root_dof + 4]) == np.sign(forward[-1])


def test_only_starts_near_the_pose_are_pushed(env):
    """Robots that lie or fall start as they did."""
    task = replace(env.task, near_target_share=0.4, falling_share=0.3)
    still, moving = (
        StartMaker(env._maker.original, replace(task, near_target_push=push), None, randomize=False)
        for push in (0.0, 0.5)
    )
    rngs = [[np.random.default_rng(seed) for seed in range(12)] for _ in range(2)]
    both = [maker.make(own, ["any"] * 12) for maker, own in zip((still, moving), rngs, strict=True)]
    kinds = [one.kind for one in both[0]]
    assert set(kinds) == {"target", "falling", "random"}
    for before, after in zip(*both, strict=True):
        assert np.array_equal(before.state, after.state) == (after.kind != "target")


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
    model, sim = copy.copy(env.model), env.core.batch.sim
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for name in ("body_subtreemass", "dof_invweight0", "body_invweight0", "tendon_invweight0"):
        np.testing.assert_allclose(getattr(model, name), getattr(env.model, name), rtol=1e-12)
    # What the sensors said in the last step of settling is what they say now of a robot that lies.
    data = env.data
    np.testing.assert_allclose(data.sensordata, sim.sensors[0], atol=2e-3)
    assert np.abs(data.qvel).max() < env.task.still_speed
    env.core.batch.look()
    np.testing.assert_array_equal(env.core.batch.observation[0], first)


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
    still = 0
    for seed in range(8):
        env.reset(seed=seed)
        if np.abs(env.data.qvel).max() > env.task.still_speed:
            continue
        still += 1
        batch = env.core.batch
        seen = read(batch.robot, batch.sim, batch.now, batch._ages)
        np.testing.assert_allclose(seen.pitch_rate, batch.now.turning[:, 1], atol=2 * env.task.still_speed)
        np.testing.assert_allclose(seen.pitch, batch.now.pitch, atol=0.01)
        np.testing.assert_allclose(seen.positions, batch.now.positions, atol=1e-6)
        np.testing.assert_allclose(seen.velocities, batch.now.velocities, atol=2 * env.task.still_speed)
    assert still > 3


def test_delayed_servos_hold_from_the_first_instant(calibrated):
    """A servo with a delay is released holding its pose, not told to go to zero first."""
    env = StandUp(calibrated, randomize=False)
    servos = env.robot.actuators
    env._maker.original.actuator_delay[:] = 0.02
    model, data = released(env, draw_release(env.robot, env.task, np.random.default_rng(0), "target"))
    assert (model.actuator_history[:, 0] > 10).all()  # there is room for the delay
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.actuator_force[servos], 0.0, atol=1e-6)


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

"""The observation holds what its layout says, as old as the model's sensors say."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.config import Joint, Task
from frasa_rl.observation import bounds, layout
from frasa_rl.robot import find_robot, pitch_of
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import load_model

PARTS = {part.name: part for part in layout(Task())}
STARTS = dict(zip(PARTS, np.cumsum([0, *(part.size for part in PARTS.values())]), strict=False))
WAVE = [np.sin(0.7 * k + np.arange(5)) for k in range(12)]


def part(observation, name):
    return observation[STARTS[name] : STARTS[name] + PARTS[name].size]


def test_there_are_22_numbers_in_the_published_order():
    """q, dq, command, pitch, pitch rate, previous action."""
    assert list(PARTS) == ["position", "velocity", "command", "pitch", "pitch_rate", "previous_action"]
    assert bounds(Task()).shape == (22,)


def test_the_action_just_applied_is_seen(plain_env):
    """The observation after an action holds that action, not the one before (upstream bug B5)."""
    plain_env.reset(seed=0)
    action = np.array([0.1, -0.2, 0.3, -0.4, 0.5], dtype=np.float32)
    np.testing.assert_array_equal(part(plain_env.step(action)[0], "previous_action"), action)
    assert not part(plain_env.reset(seed=1)[0], "previous_action").any()


def test_positions_are_the_mean_of_both_sides(plain_env, start_by_hand):
    """A left-right difference does not show: the mean does (upstream discrepancy D1)."""
    plain_env.reset(seed=0)
    qpos = plain_env.data.qpos.copy()
    qpos[plain_env.robot.qpos[3]] = (1.0, 2.0)
    plain_env.core.begin(0, start_by_hand(plain_env, qpos))
    assert part(plain_env.core.batch.observation[0], "position")[3] == pytest.approx(1.5)


def test_mirrored_joints_are_averaged_with_their_sign(nominal):
    """A joint whose sides turn in opposite directions is averaged and commanded with the sign of each side."""
    task = replace(Task(), joints=(Joint("hip_roll", 0.0, mirror=-1),))
    robot = find_robot(load_model(nominal), task)
    assert robot.mean_of_sides(np.array([[0.3, -0.5]]))[0] == pytest.approx(0.4)
    np.testing.assert_array_equal(robot.both_sides(np.array([0.2])), [[0.2, -0.2]])
    np.testing.assert_allclose(robot.limits, [[-0.523599, 0.610865]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_everything_observed_lies_in_the_declared_space(plain_env, start_by_hand, sign):
    """Numbers beyond the declared bounds are clipped, so that the space is true."""
    plain_env.reset(seed=0)
    start = start_by_hand(plain_env)
    plain_env.core.begin(0, replace(start, sensors=np.full_like(start.sensors, sign * 1e6)))
    seen = plain_env.core.batch.observation[0]
    assert plain_env.observation_space.contains(seen)
    assert (np.abs(part(seen, "velocity")) == 30.0).all()


def true_and_seen(env, name):
    """What is true and what is seen of the pitch or its rate after each action."""
    env.reset(seed=4)
    true, seen = [], []
    for action in WAVE:
        observation = env.step(action)[0]
        truth = {
            "pitch": pitch_of(env.data.qpos[3:7]),
            "pitch_rate": env.data.qvel[4],
        }
        true.append(truth[name])
        seen.append(part(observation, name)[0])
    return np.array(true), np.array(seen)


@pytest.mark.parametrize(("name", "tolerance"), [("pitch", 1e-5), ("pitch_rate", 1e-5)])
def test_the_trunk_is_seen_one_control_period_late(nominal, name, tolerance):
    """The nominal 50 ms are exactly one control period: what is seen now was true one action ago."""
    true, seen = true_and_seen(StandUp(nominal, randomize=False), name)
    np.testing.assert_allclose(seen[1:], true[:-1], atol=tolerance)
    assert np.abs(true[1:] - true[:-1]).max() > 100 * tolerance


@pytest.mark.parametrize("name", ["pitch", "pitch_rate"])
def test_the_delay_is_the_models(model_copy, name):
    """Without a delay in the model, the observation has none: nothing is buffered elsewhere."""
    file = model_copy.with_name("measurements_nominal.xml")
    file.write_text(file.read_text().replace('delay="0.05"', 'delay="0"'))
    true, seen = true_and_seen(StandUp(model_copy, randomize=False), name)
    np.testing.assert_allclose(seen, true, atol=1e-5)


def test_velocities_are_30_ms_old(plain_env):
    """A joint's velocity is seen as it was 30 ms ago, at the instant of the observation, not a substep off."""
    plain_env.reset(seed=4)
    for action in WAVE[:4]:
        seen = part(plain_env.step(action)[0], "velocity")
    robot, sim = plain_env.robot, plain_env.core.batch.sim
    history = sim.path[0][:, 1 + sim.nq + robot.dofs].mean(axis=2)  # after each of the last 25 substeps
    np.testing.assert_allclose(seen, history[-1 - 15], atol=1e-6)
    assert np.abs(history[-15] - seen).max() > 1e-3

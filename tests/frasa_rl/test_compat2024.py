"""What FRASA's published environment shows a policy, and what ours shows: each quirk a pair."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.batch import Batch
from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Task
from frasa_rl.robot import pitch_of
from frasa_rl.simulation import Start
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import UsageError

OURS, THEIRS = Task(), compat_task(Task())
ACTION = np.array([0.1, -0.2, 0.3, -0.4, 0.5], dtype=np.float32)
Q, V, PITCH, RATE, LAST = slice(0, 5), slice(5, 10), 15, 16, slice(17, 22)
STILL = np.zeros(5, dtype=np.float32)


@pytest.fixture
def pair(nominal):
    """Their environment and ours, of the robot as it is in its file, from the same start in mid-fall."""
    theirs, ours = (StandUp(nominal, task, randomize=False) for task in (THEIRS, OURS))
    (start,) = ours._maker.make([np.random.default_rng(3)], ["falling"])
    for env in (theirs, ours):
        env.core.begin(0, start)
    return theirs, ours


def seen(env):
    return env.core.batch.observation[0]


def path_of(env):
    """States after each of the last 25 substeps: positions and velocities of the joints (25, 5, 2), pitch, rate."""
    sim, robot = env.core.batch.sim, env.robot
    states = sim.path[0]
    speeds = states[:, 1 + sim.nq :]
    return states[:, 1 + robot.qpos], speeds[:, robot.dofs], pitch_of(states[:, 4:8]), speeds[:, 4]


def test_d1_the_left_side_alone(pair, start_by_hand):
    """They observe and reward the left side only, we the mean of both."""
    theirs, ours = pair
    qpos = ours.data.qpos.copy()
    qpos[ours.robot.qpos] = np.radians([[one.target_deg, one.target_deg + 20.0] for one in OURS.joints])
    start = start_by_hand(ours, qpos)
    pose = np.radians([one.target_deg for one in OURS.joints])
    for env, off in ((theirs, 0.0), (ours, np.radians(10.0))):
        env.core.begin(0, start)
        np.testing.assert_allclose(seen(env)[Q], pose + off, atol=1e-6)
        np.testing.assert_allclose(env.errors()[:5], off, atol=1e-9)


def test_d2_velocities(pair):
    """They take the difference of samples 28 ms apart for one of 30 ms; we the velocity of 30 ms ago."""
    for env in pair:
        env.step(ACTION)
        env.step(ACTION)
    (theirs, _, _, _), (_, ours, _, _) = (path_of(env) for env in pair)
    left = theirs[:, :, 0]
    np.testing.assert_allclose(seen(pair[0])[V], (left[-1] - left[-15]) / 0.030, atol=1e-6)
    np.testing.assert_allclose(seen(pair[1])[V], ours[-16].mean(axis=1), atol=1e-6)
    # A joint that turns evenly is seen 14/15 as fast by them.
    steady = np.abs(left[-1] - left[-15]).max() / 0.028
    assert np.abs(seen(pair[0])[V]).max() == pytest.approx(14 / 15 * steady, rel=1e-5)
    assert steady > 0.5


def test_d3_ages(pair, model_copy):
    """Their pitch and rate are exactly one control period old whatever the model says; ours as the model says."""
    for env in pair:
        before = []
        for action in (ACTION, -ACTION, ACTION):
            before.append((env.core.batch.now.pitch[0], env.core.batch.now.turning[0, 1]))
            env.step(action)
        np.testing.assert_allclose(seen(env)[[PITCH, RATE]], before[-1], atol=1e-5)
    file = model_copy.with_name("measurements_nominal.xml")
    file.write_text(file.read_text().replace('delay="0.05"', 'delay="0.02"'))
    ages = {}
    for name, task in (("theirs", THEIRS), ("ours", OURS)):
        env = StandUp(model_copy, task, randomize=False)
        (start,) = env._maker.make([np.random.default_rng(3)], ["falling"])
        env.core.begin(0, start)
        env.step(ACTION)
        first = env.core.batch.now.pitch[0]
        env.step(-ACTION)
        _, _, pitch, _ = path_of(env)
        pitches = [first, *pitch]  # 50, 48, ... 0 ms ago
        ages[name] = 50 - 2 * int(np.argmin(np.abs(pitches - seen(env)[PITCH])))
        assert np.abs(np.diff(pitches)).min() > 1e-6
    assert ages == {"theirs": 50, "ours": 20}


def test_d3_before_the_first_step(pair):
    """At reset their pitch is what is, and their rate zero though the robot falls; ours is the delayed reading."""
    theirs, ours = pair
    rate = theirs.core.batch.now.turning[0, 1]
    assert abs(rate) > 0.1
    assert seen(theirs)[PITCH] == pytest.approx(theirs.core.batch.now.pitch[0], abs=1e-6)
    assert seen(theirs)[RATE] == 0.0
    assert 0.0 < abs(seen(ours)[RATE]) < abs(rate)
    assert not seen(theirs)[V].any()
    theirs.step(STILL)
    assert seen(theirs)[RATE] == pytest.approx(rate, abs=1e-6)


@pytest.mark.parametrize(("ratio", "cut"), [(0.98, 0.98), (1.02, 1.0)])
def test_d4_the_time_ratio(nominal, ratio, cut):
    """Their time ratio leaves 25 substeps as they are, and cuts full actions only; ours has none."""
    for task, most in ((THEIRS, cut), (OURS, 1.0)):
        env = StandUp(nominal, task, randomize=False)
        (start,) = env._maker.make([np.random.default_rng(0)], ["target"])
        drawn = {"time_ratio": ratio} if task.compat else {}
        env.core.begin(0, replace(start, drawn=drawn))
        before, time = env.core.batch.commands[0].copy(), env.core.batch.sim.state[0, 0]
        env.step(np.array([0.5, 0.0, -1.0, 0.0, 0.0]))
        moved = (env.core.batch.commands[0] - before) / (2 * np.pi * 0.05)
        np.testing.assert_allclose(moved, [0.5, 0.0, -most, 0.0, 0.0], atol=1e-12)
        assert env.core.batch.sim.state[0, 0] - time == pytest.approx(0.05)
        env.step(STILL)
        env.step(STILL)
    assert {"time_ratio"} - set(StandUp(nominal, OURS).drawn)


def test_b5_the_action_shown(pair):
    """They show the action before the one just applied, we that one."""
    theirs, ours = pair
    for env in pair:
        env.step(ACTION)
    np.testing.assert_array_equal(seen(theirs)[LAST], STILL)
    np.testing.assert_array_equal(seen(ours)[LAST], ACTION)
    for env in pair:
        env.step(-ACTION)
    np.testing.assert_array_equal(seen(theirs)[LAST], ACTION)
    np.testing.assert_array_equal(seen(ours)[LAST], -ACTION)


@pytest.mark.parametrize(("task", "steps"), [(THEIRS, 101), (OURS, 100)])
def test_the_length_of_an_episode(nominal, task, steps):
    """Theirs ends after its time has passed, ours when it has."""
    env = StandUp(nominal, task, randomize=False)
    (start,) = StandUp(nominal, OURS, randomize=False)._maker.make([np.random.default_rng(0)], ["prone"])
    env.core.begin(0, start)
    flags = [env.step(STILL)[2:4] for _ in range(steps)]
    assert flags == [(False, False)] * (steps - 1) + [(False, True)]


def test_another_rate_is_refused(nominal):
    """Their readings are counted in steps of one control period."""
    env = StandUp(nominal, THEIRS, randomize=False)
    with pytest.raises(UsageError, match="once a control period"):
        Batch(env.model, THEIRS, 1, period_s=0.01)
    Batch(env.model, OURS, 1, period_s=0.01).close()


def test_one_of_many_is_replaced(nominal):
    """A robot that begins anew has its own memory emptied; the other's readings stay as they are."""
    env = StandUp(nominal, THEIRS, randomize=False)
    starts: list[Start] = env._maker.make([np.random.default_rng(seed) for seed in range(2)], ["falling"] * 2)
    batch = Batch(env.model, THEIRS, 2, threads=1)
    for index in range(2):
        batch.put(index, starts[index])
    first = batch.observation.copy()
    for action in (ACTION, -ACTION):
        batch.act(np.tile(action, (2, 1)))
    kept = batch.observation.copy()
    batch.put(1, starts[1])
    np.testing.assert_array_equal(batch.observation[0], kept[0])
    np.testing.assert_array_equal(batch.observation[1], first[1])
    assert not np.array_equal(kept[1], first[1])
    alone = Batch(env.model, THEIRS, 2, threads=1)
    for index in range(2):
        alone.put(index, starts[index])
    batch.act(np.tile(ACTION, (2, 1)))
    alone.act(np.tile(ACTION, (2, 1)))
    np.testing.assert_array_equal(batch.observation[1], alone.observation[1])
    np.testing.assert_array_equal(batch.observation[0, LAST], -ACTION)

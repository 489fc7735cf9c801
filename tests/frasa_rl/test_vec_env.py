"""Many robots as a VecEnv: the same as one alone, restarts, what a learner finds in its buffer."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.standup_env import StandUp

pytest.importorskip("stable_baselines3")
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecMonitor

from frasa_rl.vec_env import StandUpVecEnv

QUICK = replace(Task(), near_target_share=0.4, falling_share=0.4)


@pytest.fixture(autouse=True)
def _cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FRASA_CACHE", str(tmp_path / "cache"))


def make(path, task=QUICK, count=4, **more):
    return StandUpVecEnv(path, task, count, **{"pool": 6, "threads": 1, **more})


def run(env, steps, seed=0):
    """Observations, rewards, ends of random steps, terminal observations among them."""
    rng = np.random.default_rng(seed)
    seen, paid, ends, last = [env.reset()], [], [], []
    for _ in range(steps):
        observation, reward, over, infos = env.step(rng.uniform(-1, 1, (env.num_envs, 5)))
        seen.append(observation)
        paid.append(reward)
        ends.append(over)
        last += [info["terminal_observation"] for info in infos if "terminal_observation" in info]
    return np.array(seen), np.array(paid), np.array(ends), np.array(last)


def test_one_alone_is_one_of_many(calibrated):
    """From the same start, the single environment goes through the same numbers, to the last bit."""
    many, one = make(calibrated), StandUp(calibrated, QUICK)
    first = many.reset()
    rng = np.random.default_rng(2)
    told = rng.uniform(-1.0, 1.0, (30, 4, 5)).astype(np.float32)
    steps = [many.step(actions) for actions in told]
    many.reset()
    many.seed(0)
    many.reset()  # the same starts as at first
    for place in range(4):
        (start,) = [s for s in many.pool.starts if s.model is many.core.batch.sim.models[place]]
        one.core.begin(0, start)
        np.testing.assert_array_equal(one.core.batch.observation[0], first[place])
        for k in range(30):
            observation, reward, terminated, truncated, info = one.step(told[k, place])
            many_seen, many_paid, many_over, many_info = steps[k]
            assert many_over[place] == (terminated or truncated)
            assert many_paid[place] == np.float32(reward)
            if terminated:
                np.testing.assert_array_equal(observation, many_info[place]["terminal_observation"])
                assert many_info[place]["is_success"] == info["is_success"]
                break
            np.testing.assert_array_equal(observation, many_seen[place])


def test_a_robot_that_restarts_is_seen_at_its_start(calibrated):
    """What a step returns of it is the first sight of the new episode; of the others, what they see now."""
    env, one = make(calibrated, replace(QUICK, end_pitch_deg=60.0)), StandUp(calibrated, QUICK)
    env.reset()
    rng, restarts, mixed = np.random.default_rng(0), 0, 0
    for _ in range(60):
        seen, _, over, infos = env.step(rng.uniform(-1.0, 1.0, (4, 5)))
        np.testing.assert_array_equal(seen, env.core.batch.observation)
        for place in np.flatnonzero(over):
            (start,) = [s for s in env.pool.starts if s.model is env.core.batch.sim.models[place]]
            one.core.begin(0, start)
            np.testing.assert_array_equal(seen[place], one.core.batch.observation[0])
            assert not np.array_equal(seen[place], infos[place]["terminal_observation"])
        restarts += int(over.sum())
        mixed += over.any() and not over.all()
    assert restarts > 4
    assert mixed > 2


def test_the_same_seed_gives_the_same_numbers(calibrated):
    """Over restarts, with one thread or two, with the pool made or read; another seed gives others."""
    short = replace(QUICK, episode_s=0.5)
    runs = [
        run(make(calibrated, short, threads=threads, keep=keep), 40)
        for threads, keep in [(1, True), (2, True), (1, False)]
    ]
    for other in runs[1:]:
        for a, b in zip(runs[0], other, strict=True):
            np.testing.assert_array_equal(a, b)
    assert runs[0][2].sum() >= 16  # four restarts of each at least
    assert not np.array_equal(runs[0][0], run(make(calibrated, short, seed=1), 40)[0])


def test_seeding_again_repeats_the_episodes(calibrated):
    """`seed` restarts the choice of starts, and nothing else has a memory."""
    env = make(calibrated, replace(QUICK, episode_s=0.3))
    first = run(env, 20)
    assert not np.array_equal(first[0], run(env, 20)[0])
    assert env.seed(0) == [0] * 4
    for a, b in zip(first, run(env, 20), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_number_of_robots_does_not_change_a_robot(calibrated):
    """The first two of five robots are the two of two."""
    two, five = make(calibrated, count=2), make(calibrated, count=5)
    np.testing.assert_array_equal(two.reset(), five.reset()[:2])
    told = np.random.default_rng(0).uniform(-1, 1, (20, 5, 5))
    for actions in told:
        a, b = two.step(actions[:2]), five.step(actions)
        for x, y in zip(a[:3], b[:3], strict=True):
            np.testing.assert_array_equal(x, y[:2])


def test_robots_that_share_a_start_do_not_meet(calibrated):
    """Two places with the same robot, and the same model of it, told other things: each as alone."""
    env = make(calibrated, count=3, pool=1, threads=2)
    env.reset()
    assert env.core.batch.sim.models[0] is env.core.batch.sim.models[1]
    told = np.random.default_rng(0).uniform(-0.3, 0.3, (15, 3, 5))
    for actions in told:
        seen = env.step(actions)[0]
    alone = make(calibrated, count=1, pool=1)
    for place in range(3):
        alone.reset()
        for actions in told:
            one = alone.step(actions[place : place + 1])[0]
        np.testing.assert_array_equal(one[0], seen[place])
    assert len({row.tobytes() for row in seen}) == 3


def test_what_was_returned_stays_as_it_was(calibrated):
    """Observations, rewards and terminal observations of a step are not written to by the next ones."""
    env = make(calibrated, replace(QUICK, episode_s=0.2))
    clean = make(calibrated, replace(QUICK, episode_s=0.2))
    np.testing.assert_array_equal(env.reset(), clean.reset())
    kept, copies = [], []
    for _ in range(6):
        steps = [one.step(np.ones((4, 5))) for one in (env, clean)]
        for a, b in zip(steps[0][:3], steps[1][:3], strict=True):
            np.testing.assert_array_equal(a, b)
        arrays = [
            *steps[1][:3],
            *(info["terminal_observation"] for info in steps[1][3] if "terminal_observation" in info),
        ]
        kept += arrays
        copies += [one.copy() for one in arrays]
        for one in steps[0][:2]:  # nor does the environment care what becomes of them
            one[:] = 7.0
    assert len(kept) >= 6 * 3 + 4  # every robot ended once
    for a, b in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_learner_finds_the_ends_in_its_buffer(calibrated, monkeypatch):
    """Where time ran out the next observation is the last one and the end is none; where a robot fell it is one."""
    task = replace(QUICK, episode_s=0.5, end_pitch_deg=60.0)  # some fall, some run out of time
    env = VecMonitor(make(calibrated, task, pool=12))
    stored = []
    add = ReplayBuffer.add

    def spy(buffer, observation, following, action, reward, done, infos):
        stored.append((following.copy(), done.copy(), infos))
        add(buffer, observation, following, action, reward, done, infos)

    monkeypatch.setattr(ReplayBuffer, "add", spy)
    model = SAC("MlpPolicy", env, learning_starts=40, batch_size=8, buffer_size=1000, train_freq=4, seed=0,
                policy_kwargs={"net_arch": [8]}, device="cpu")  # fmt: skip
    model.learn(320)
    buffer = model.replay_buffer
    ends = {True: 0, False: 0}
    for row, (_, done, infos) in enumerate(stored):
        for place, info in enumerate(infos):
            following = buffer.next_observations[row, place]
            timeout = info.get("TimeLimit.truncated", False)
            if not done[place]:
                assert "terminal_observation" not in info
                if row + 1 < len(stored):
                    np.testing.assert_array_equal(following, buffer.observations[row + 1, place])
                continue
            ends[timeout] += 1
            np.testing.assert_array_equal(following, info["terminal_observation"])
            assert info["episode"]["l"] <= 10
            assert buffer.dones[row, place] == 1.0
            assert buffer.timeouts[row, place] == timeout
            assert info["episode"]["l"] == 10 or not timeout
    assert min(ends.values()) > 2, ends
    sample = buffer.sample(200)
    assert np.isfinite(sample.next_observations.numpy()).all()
    assert np.isfinite(buffer.rewards).all()


def test_the_methods_of_a_vec_env(calibrated):
    """Attributes and methods are those of the whole, once for every place that is asked for."""
    env = make(calibrated)
    assert env.get_attr("calibration_id") == ["c0ffee"] * 4
    assert env.get_attr("calibration_id", [0, 2]) == ["c0ffee"] * 2
    assert env.get_attr("render_mode", 1) == [None]
    env.set_attr("note", 5)
    assert env.get_attr("note", 3) == [5]
    assert [a.shape for a in env.env_method("reset", indices=0)] == [(4, 22)]
    assert env.env_is_wrapped(VecMonitor) == [False] * 4
    with pytest.raises(AttributeError):
        env.get_attr("no_such_thing")
    assert env.num_envs == env.count == 4
    assert env.seed(3) == [3] * 4
    env.step_async(np.zeros((4, 5), dtype=np.float32))
    observation, reward, over, infos = env.step_wait()
    assert (observation.shape, observation.dtype, reward.dtype, over.dtype) == ((4, 22), np.float32, np.float32, bool)
    assert reward.shape == over.shape == (4,)
    assert len(infos) == 4
    env.close()


@pytest.mark.parametrize("actions", [np.zeros((3, 5)), np.zeros(5), np.full((4, 5), np.nan)])
def test_broken_actions_are_refused(calibrated, actions):
    """Actions for another number of robots, or not finite, are a mistake; nothing has moved."""
    env = make(calibrated)
    env.reset()
    before = env.core.batch.sim.state.copy()
    with pytest.raises(ValueError, match="5 finite numbers for each of 4 robots"):
        env.step(actions)
    np.testing.assert_array_equal(env.core.batch.sim.state, before)

"""What the collector writes down is what the environment did, and its noise is what it says."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.actor import ActorLayers, Noise, uniform
from frasa_rl.collector import Collector
from frasa_rl.config import Task
from frasa_rl.curriculum import Curriculum, Shares
from frasa_rl.episodes import make_episodes

TASK = replace(Task(), near_target_share=0.4, falling_share=0.4, episode_s=0.5, end_pitch_deg=60.0)


def episodes(path, curriculum=None, task=TASK, pool=12):
    return make_episodes(path, task, 4, pool=pool, threads=1, curriculum=curriculum)


@pytest.fixture
def actor():
    rng = np.random.default_rng(0)

    def layer(out, into):
        return rng.normal(0.0, 0.3, (out, into)).astype(np.float32), np.zeros(out, dtype=np.float32)

    return ActorLayers((layer(8, 22),), layer(5, 8), layer(5, 8))


def test_transitions_are_what_the_environment_did(nominal, actor):
    """Next observations follow each other, but at ends, where the episode's last one is kept; sums are of episodes."""
    collector = Collector(episodes(nominal), 0.5, 3)
    rounds = [collector.collect(actor, steps) for steps in (1, 7, 20, 12)]
    joined = {
        name: np.concatenate([getattr(one.transitions, name) for one in rounds]) for name in vars(rounds[0].transitions)
    }
    twin = episodes(nominal)
    seen = twin.begin()
    for row in range(40):
        np.testing.assert_array_equal(joined["observations"][row], seen)
        step = twin.step(joined["actions"][row])
        np.testing.assert_array_equal(joined["next_observations"][row], step.out.observation)
        np.testing.assert_array_equal(joined["rewards"][row], step.reward.astype(np.float32))
        np.testing.assert_array_equal(joined["dones"][row], step.out.terminated)
        np.testing.assert_array_equal(joined["lasts"][row], step.over)
        seen = step.following
    late = joined["lasts"] - joined["dones"]
    assert min(late.sum(), joined["dones"].sum()) >= 2  # both sorts of ends
    assert late.min() == 0.0
    lasted = np.concatenate([one.lasted for one in rounds])
    assert lasted.size == joined["lasts"].sum()
    assert lasted.max() == 10
    row, robot = np.argwhere(joined["lasts"])[0]
    assert rounds[1].returned[0] == pytest.approx(joined["rewards"][: row + 1, robot].sum(), rel=1e-5)
    assert all(0.0 < one.posture < 1.0 for one in rounds)
    assert sum(one.diverged for one in rounds) == 0
    collector.episodes.close()
    twin.close()


def test_rounds_of_any_length_are_the_same(nominal, actor):
    """Forty steps at once and in parts give the same numbers; another seed gives others."""
    once, parts, other = (Collector(episodes(nominal), 0.5, seed) for seed in (3, 3, 4))
    whole = once.collect(actor, 40).transitions.actions
    split = np.concatenate([parts.collect(actor, steps).transitions.actions for steps in (13, 27)])
    np.testing.assert_array_equal(whole, split)
    assert not np.array_equal(whole, other.collect(actor, 40).transitions.actions)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_noise_is_normal_and_as_slow_as_asked(correlation):
    """Mean, spread and correlation of successive steps; an episode begins with numbers of its own."""
    noise = Noise(200, 5, correlation, 0)
    drawn = np.array([noise.next(np.zeros(200, dtype=bool)) for _ in range(200)])
    assert abs(drawn.mean()) < 0.02
    assert drawn.std() == pytest.approx(1.0, abs=0.02)
    between = np.corrcoef(drawn[:-1].ravel(), drawn[1:].ravel())[0, 1]
    assert between == pytest.approx(correlation, abs=0.02)
    before, fresh = drawn[-1], np.arange(200) < 100
    after = noise.next(fresh)
    shares = [np.corrcoef(before[one].ravel(), after[one].ravel())[0, 1] for one in (fresh, ~fresh)]
    assert shares == pytest.approx([0.0, correlation], abs=0.15)


def test_random_actions_are_uniform(nominal):
    """Whatever the correlation; in the warm-up they are what the robots are told."""
    drawn = uniform(np.random.default_rng(0).normal(size=(10_000, 5)))
    assert np.histogram(drawn, 4, (-1.0, 1.0))[0] == pytest.approx([12_500] * 4, rel=0.05)
    slow = Collector(episodes(nominal), 0.9, 0)
    actions = slow.collect(None, 200).transitions.actions
    assert np.abs(np.diff(actions, axis=0)).mean() < 0.35  # 0.67 for white noise
    assert actions.std() == pytest.approx(np.sqrt(1.0 / 3.0), abs=0.08)
    slow.episodes.close()


class Still(Curriculum):
    """Pays for turning slower than before."""

    def reward(self, core, before, out):
        return np.abs(before.turning[:, 1]) - np.abs(core.batch.now.turning[:, 1])


def test_a_curriculum_pays(nominal, actor):
    """What it returns is what is written down; robots move as before, and the paper's return is summed as before."""
    plain, paid = Collector(episodes(nominal), 0.0, 0), Collector(episodes(nominal, Still()), 0.0, 0)
    a, b = plain.collect(actor, 30), paid.collect(actor, 30)
    np.testing.assert_array_equal(a.transitions.actions, b.transitions.actions)
    assert b.transitions.rewards.min() < 0.0
    assert not np.array_equal(a.transitions.rewards, b.transitions.rewards)
    np.testing.assert_array_equal(a.returned, b.returned)
    for each in (plain, paid):
        each.episodes.close()


def test_a_curriculum_chooses_starts(nominal):
    """Shares of kinds, whatever the pool has; kinds that it lacks are left out."""
    one = episodes(nominal, pool=40)
    rng, shares = np.random.default_rng(0), Shares(0.5, 0.5, 0.0)
    kinds = [one.pool.starts[shares.choose(rng, one.pool)].kind for _ in range(400)]
    assert set(kinds) == {"target", "falling"}
    assert kinds.count("target") == pytest.approx(200, abs=50)
    other = Shares(0.0, 0.0, 1.0)
    other.restore(shares.snapshot())
    np.testing.assert_array_equal(other.shares, shares.shares)
    near = make_episodes(nominal, replace(TASK, near_target_share=1.0, falling_share=0.0), 2, pool=3, threads=1)
    assert {Shares(0.0, 0.0, 1.0).choose(rng, near.pool) for _ in range(60)} == {0, 1, 2}
    assert near.pool.starts[Shares(0.1, 0.0, 0.9).choose(rng, near.pool)].kind == "target"

"""The shipped keyframes stand the robot up, through the environment that policies are trained in."""

import numpy as np
import pytest

from frasa_rl.evaluate import evaluation_task
from frasa_rl.keyframe import load_controller
from frasa_rl.keyframe_trials import run_trial, run_trials
from frasa_rl.standup_env import StandUp


@pytest.fixture
def shipped(robot_model_dir):
    return load_controller(robot_model_dir / "keyframes.yaml", evaluation_task())


@pytest.fixture
def env(nominal):
    return StandUp(nominal, evaluation_task(), randomize=False)


class Still:
    """Every command held where it is."""

    name = "still"

    def start(self, count, period_s):
        self.count = count

    def act(self, observation):
        return np.zeros((self.count, 5), dtype=np.float32)


def test_the_nominal_robot_stands_up_from_both_sides(shipped, env):
    """Every one of four falls a side, in less than 6 s, without an episode's early end."""
    result = run_trials(shipped, env, trials=4, seed=10_000)
    for side in ("prone", "supine"):
        assert result[side]["success_rate"] == 1.0
        assert result[side]["ended"] == 0
        assert 1.0 < result[side]["time_max_s"] < 6.0


def test_holding_still_does_not_stand_up(env):
    """The measure is honest: the same trials fail without a routine."""
    result = run_trials(Still(), env, trials=1, seed=10_000)
    assert [result[side]["success_rate"] for side in ("prone", "supine")] == [0.0, 0.0]
    assert result["prone"]["time_mean_s"] is None


def test_a_trial_repeats(shipped, env):
    """The same seed gives the same time; another seed is another fall."""
    first, again, other = (run_trial(shipped, env, "prone", seed) for seed in (7, 7, 8))
    assert first == again
    assert first != other


def test_a_trial_can_give_up_early(shipped, env):
    """Failures say how far from the standing pose they ended."""
    trial = run_trial(shipped, env, "supine", 10_000, longest_s=1.0)
    assert np.isnan(trial.time_s)
    assert trial.lasted_s == pytest.approx(1.0)
    assert trial.worst_error > np.radians(45.0)
    assert not trial.ended

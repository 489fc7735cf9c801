"""The shipped keyframes stand the robot up, through the environment that policies are trained in."""

import numpy as np
import pytest

from frasa_rl.controllers import Nothing
from frasa_rl.keyframe import load_controller
from frasa_rl.keyframe_trials import run_trial
from frasa_rl.protocol import SIDES, evaluation_task
from frasa_rl.standup_env import StandUp


@pytest.fixture
def shipped(robot_model_dir):
    return load_controller(robot_model_dir / "keyframes.yaml", evaluation_task())


@pytest.fixture
def env(nominal):
    return StandUp(nominal, evaluation_task(), randomize=False)


@pytest.mark.parametrize("side", SIDES)
def test_the_nominal_robot_stands_up_from_both_sides(shipped, env, side):
    """Every one of four falls a side, in less than 6 s, without an episode's early end."""
    trials = [run_trial(shipped, env, side, 10_000 + one) for one in range(4)]
    assert not any(one.ended for one in trials)
    assert all(1.0 < one.time_s < 6.0 for one in trials)


@pytest.mark.parametrize("side", SIDES)
def test_holding_still_does_not_stand_up(env, side):
    """The measure is honest: the same trials fail without a routine."""
    assert np.isnan(run_trial(Nothing(env.task), env, side, 10_000).time_s)


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

"""The shipped keyframes stand the robot up, through the task that policies are trained on."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.controllers import Nothing
from frasa_rl.fall_trials import Falls
from frasa_rl.keyframe import KeyframeController
from frasa_rl.keyframe_file import load_keyframes
from frasa_rl.protocol import SIDES, evaluation_task
from frasa_rl.simulation import Simulation
from frasa_rl.standup_env import StandUp


@pytest.fixture
def shipped(robot_model_dir):
    return KeyframeController(load_keyframes(robot_model_dir / "keyframes.yaml"), evaluation_task())


@pytest.fixture
def falls(nominal):
    return Falls(nominal, evaluation_task())


@pytest.mark.parametrize("side", SIDES)
def test_the_nominal_robot_stands_up_from_both_sides(shipped, falls, side):
    """Every one of four falls a side, in less than 6 s, without an episode's early end."""
    trials = falls.run([shipped], falls.make(side, range(10_000, 10_004)), [10.0])[0]
    assert not any(one.ended for one in trials)
    assert all(1.0 < one.time_s < 6.0 for one in trials)


@pytest.mark.parametrize("side", SIDES)
def test_holding_still_does_not_stand_up(falls, side):
    """The measure is honest: the same trials fail without a routine."""
    assert np.isnan(falls.run([Nothing(falls.task)], falls.make(side, [10_000]), [10.0])[0][0].time_s)


def test_a_trial_is_an_episode_of_the_environment(shipped, falls, nominal):
    """The same seed alone in `StandUp` gives the same fall, time, and errors; among others nothing changes."""
    env, period = StandUp(nominal, evaluation_task(), randomize=False), falls.task.control_period_s
    observation, info = env.reset(seed=7, options={"start": "prone"})
    shipped.start(1, period)
    steps = 0
    while not info["is_success"]:
        observation, *_, info = env.step(shipped.act(observation[None])[0])
        steps += 1
    among = falls.run([Nothing(falls.task), shipped], falls.make("prone", [8, 7, 9]), [0.3, 10.0])[1]
    assert among[1].time_s == pytest.approx(steps * period - falls.task.success_hold_s)
    assert among[1].worst_error == np.abs(env.errors()).max()
    assert among[1] != among[0]


def test_a_trial_does_not_know_the_others(shipped, nominal):
    """Other falls, controllers and threads change nothing, also where every fall has its own robot."""
    one, two = (Falls(nominal, evaluation_task(), randomize=True, threads=threads) for threads in (1, 2))
    alone = one.run([shipped], one.make("supine", [3]), [10.0])[0][0]
    among = two.run([Nothing(two.task), shipped], two.make("supine", [4, 3, 5]), [1.0, 10.0])
    assert among[1][1] == alone
    assert [trial.lasted_s for trial in among[0]] == [1.0] * 3


def test_who_rests_is_left_alone(nominal):
    """It neither moves nor counts as diverged, and changes nothing for the others."""
    falls = Falls(nominal, evaluation_task())
    one, two = falls.make("prone", [1, 2])
    alone, both = Simulation(one.model, 1), Simulation(one.model, 2)
    alone.put(0, two)
    both.put(0, one)
    both.put(1, two)
    both.resting[0] = True
    commands = np.stack([np.tile(start.ctrl + 0.1, (5, 1)) for start in (one, two)])
    alone.advance(commands[1:])
    both.advance(commands)
    np.testing.assert_array_equal(both.state[0], one.state)
    np.testing.assert_array_equal(both.path[1], alone.path[0])
    np.testing.assert_array_equal(both.sensors[1], alone.sensors[0])
    assert not both.diverged.any()
    both.put(0, one)
    both.advance(commands)
    assert both.state[0, 0] > one.state[0]
    alone.close()
    both.close()


def test_a_trial_can_give_up_early(shipped, falls):
    """Failures say how far from the standing pose they ended."""
    trial = falls.run([shipped], falls.make("supine", [10_000]), [1.0])[0][0]
    assert np.isnan(trial.time_s)
    assert trial.lasted_s == pytest.approx(1.0)
    assert trial.worst_error > np.radians(45.0)
    assert not trial.ended


def test_a_trial_can_end_early(shipped, nominal):
    """A task that allows no speed ends at once: a failure that says so."""
    falls = Falls(nominal, replace(evaluation_task(), end_gyro=0.01))
    trial = falls.run([shipped], falls.make("prone", [1]), [10.0])[0][0]
    assert trial.ended
    assert trial.lasted_s < 3.0

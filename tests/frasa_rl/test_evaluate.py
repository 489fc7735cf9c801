"""Policies are judged by the paper's measure, on the model they were trained on."""

from dataclasses import asdict

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.evaluate import check_policy, evaluate, evaluation_task, run_trial
from frasa_rl.policy import Policy, PolicyError
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import CalibrationError, plain


def still_policy(**run):
    layer = (np.zeros((5, 22), dtype=np.float32), np.zeros(5, dtype=np.float32))
    return Policy((layer,), {"task": plain(asdict(Task())), "calibration_id": None, **run})


def test_doing_nothing_does_not_stand_up(nominal):
    """The measure is honest: held commands never stand a lying robot up."""
    result = evaluate(None, StandUp(nominal, evaluation_task()), trials=2, seed=0)
    nothing = {"trials": 2, "success_rate": 0.0, "time_mean_s": None, "time_std_s": None}
    assert result == {"prone": nothing, "supine": nothing}


def test_the_time_runs_to_the_start_of_the_hold(nominal, monkeypatch):
    """A robot whose errors are small from 1.0 s on is standing after 1.0 s, known at 1.5 s."""
    env = StandUp(nominal, evaluation_task(), randomize=False)
    steps = []

    def errors():
        steps.append(None)
        return np.full(6, 0.0 if len(steps) >= 20 else 1.0)

    monkeypatch.setattr(env, "errors", errors)
    assert run_trial(still_policy(), env, "prone", seed=0) == pytest.approx(1.0)
    assert len(steps) == 30


def test_results_do_not_depend_on_the_order_of_trials(nominal):
    """A trial is a function of its seed alone."""
    env = StandUp(nominal, evaluation_task())
    first = env.reset(seed=11, options={"start": "prone"})[0]
    run_trial(None, env, "supine", seed=3)
    np.testing.assert_array_equal(env.reset(seed=11, options={"start": "prone"})[0], first)


def test_a_policy_of_another_calibration_is_refused(calibrated, nominal):
    """A policy acts on another calibration only when that is meant."""
    env = StandUp(calibrated)
    with pytest.raises(CalibrationError, match=r"none \(nominal\).*c0ffee"):
        check_policy(still_policy(), env)
    check_policy(still_policy(), env, allow_other_model=True)
    check_policy(still_policy(calibration_id="c0ffee"), env)
    with pytest.raises(CalibrationError, match="other1"):
        check_policy(still_policy(calibration_id="other1"), StandUp(nominal))


def test_a_policy_of_another_task_is_refused(env):
    """A policy that sees another number of things or moves other joints is refused."""
    layer = (np.zeros((5, 21), dtype=np.float32), np.zeros(5, dtype=np.float32))
    with pytest.raises(PolicyError, match="21"):
        check_policy(Policy((layer,), {}), env)
    other = plain(asdict(Task()))
    other["joints"][0]["name"] = "wrist"
    with pytest.raises(PolicyError, match="another task"):
        check_policy(still_policy(task=other), env)

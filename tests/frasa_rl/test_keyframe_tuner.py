"""The tuner improves a routine on real trials, and saves as it goes."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.fall_trials import Falls, Trial
from frasa_rl.keyframe import KeyframeController
from frasa_rl.keyframe_file import load_keyframes
from frasa_rl.keyframe_tuner import Tuning, cost_of, decode, encode, tune
from frasa_rl.protocol import evaluation_task
from frasa_rl.routine import Key, Routine
from frasa_sysid.calibration import UsageError

LIMITS = np.array([[-90.0, 90.0], [0.0, 130.0]])
SHORT = Tuning(sigma=0.15, population=5, trials=1, checks=1, seed=2, sides=("prone",), generations=3)


@pytest.fixture
def shipped(robot_model_dir):
    return load_keyframes(robot_model_dir / "keyframes.yaml")


@pytest.fixture
def falls(nominal):
    return Falls(nominal, evaluation_task())


def test_a_routine_survives_the_search_numbers():
    """Routine to numbers and back is the same routine."""
    routine = Routine((Key(0.4, (-30.0, 90.0)), Key(0.25, (45.5, 10.0))), 0.7)
    assert encode(routine).shape == (7,)
    assert decode(encode(routine), LIMITS) == routine


def test_the_search_stays_in_the_limits():
    """Angles beyond the command limits are cut, durations too short are lengthened."""
    wild = encode(Routine((Key(0.0, (-200.0, 200.0)),), 0.0))
    assert decode(wild, LIMITS) == Routine((Key(0.05, (-90.0, 130.0)),), 0.05)


def test_no_failure_costs_less_than_a_success():
    """Among failures, the nearer to standing and the one the task did not end costs less."""
    late = Trial(9.5, 0.0, False, 10.0)
    near, far, ended = Trial(np.nan, 0.1, False, 4.0), Trial(np.nan, 1.5, False, 4.0), Trial(np.nan, 1.5, True, 1.0)
    costs = [cost_of(one) for one in (late, near, far, ended)]
    assert costs == sorted(costs)
    assert len(set(costs)) == 4


def test_a_spoilt_routine_gets_better(shipped, falls):
    """A routine made slow is quicker after three generations, and what was saved last is what is returned."""
    slow = Routine(
        tuple(replace(key, duration_s=2.0 * key.duration_s) for key in shipped.prone.keys), 2.0 * shipped.prone.rise_s
    )
    spoilt, saved, costs = replace(shipped, prone=slow), [], []
    # Small steps and enough of them: another processor's rounding changes single trials, and still some are quicker.
    short = replace(SHORT, sigma=0.08, population=8, seed=4)
    best = tune(spoilt, falls, short, saved.append, lambda now: costs.append(now.cost))
    assert saved
    assert best == saved[-1]
    assert best.prone != slow
    assert best.supine == shipped.supine
    assert costs == sorted(costs, reverse=True)
    before, after = falls.run(
        [KeyframeController(one, falls.task) for one in (spoilt, best)], falls.make("prone", [99]), [10.0, 10.0]
    )
    assert after[0].time_s < before[0].time_s  # on a fall that the search has not seen


def test_the_same_seed_tunes_the_same(shipped, nominal):
    """One generation on one thread and on two, and once with another seed."""
    first, again, other = [], [], []
    for saved, seed, threads in ((first, 3, 1), (again, 3, 2), (other, 4, 2)):
        falls = Falls(nominal, evaluation_task(), randomize=True, threads=threads)
        tuning = replace(SHORT, generations=1, population=4, checks=1, seed=seed)
        costs = []
        tune(shipped, falls, tuning, saved.append, lambda now, costs=costs: costs.append(now.cost))
        saved.append(costs)
    assert first == again
    assert first != other


def test_an_interrupted_search_has_saved_its_best(shipped, falls, monkeypatch):
    """Whatever was better before the interruption is there."""
    times = iter([5.0, 5.0, 4.0])  # the start, the first generation, its mean

    def run(controllers, starts, longest_s):
        try:
            time_s = next(times)
        except StopIteration:
            raise KeyboardInterrupt from None
        return [[Trial(time_s, 0.0, False, time_s)] * len(starts) for _ in controllers]

    monkeypatch.setattr(falls, "run", run)
    saved = []
    with pytest.raises(KeyboardInterrupt):
        tune(shipped, falls, SHORT, saved.append)
    assert len(saved) == 1


@pytest.mark.parametrize("wrong", [{"minutes": 0.0}, {"minutes": float("nan")}, {"seed": -1}, {"population": 2}])
def test_a_tuning_that_cannot_run_is_refused(wrong):
    with pytest.raises(UsageError):
        Tuning(**wrong)

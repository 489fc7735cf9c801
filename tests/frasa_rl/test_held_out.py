"""Held-out falls are the same for every run, none of training's, and say who stands up."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.evaluations import Evaluations, shown
from frasa_rl.fall_trials import Trial
from frasa_rl.held_out import SEED, HeldOut, Result
from frasa_rl.policy import Policy
from frasa_rl.snapshots import part
from frasa_rl.starts import StartMaker
from frasa_rl.tables import EVALUATIONS
from frasa_rl.task_model import build_model

STILL = Policy(((np.zeros((5, 22), dtype=np.float32), np.zeros(5, dtype=np.float32)),))


def test_falls_are_fixed_and_of_no_training(nominal):
    """Prone ones first, the same again and for other shares of starts; another set, and training's seeds, differ."""
    one = HeldOut(nominal, Task(), 2, "fast")
    again = HeldOut(nominal, replace(Task(), near_target_share=0.9), 2, "fast")
    assert [start.kind for start in one.starts(0)] == ["prone", "prone", "supine", "supine"]
    for mine, theirs, other in zip(one.starts(0), again.starts(0), one.starts(1), strict=True):
        np.testing.assert_array_equal(mine.state, theirs.state)
        assert mine.drawn == theirs.drawn
        assert mine.drawn != other.drawn
    maker = StartMaker(build_model(nominal, Task()), Task(), None)
    for seed in (0, SEED):
        rngs = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,))) for i in range(4)]
        drawn = [maker.draw_robot(rng)[1] for rng in rngs]
        assert not [each for each in drawn if each in [start.drawn for start in one.starts(0)]]


@pytest.mark.parametrize("physics", ["model", "fast"])
def test_who_holds_still_does_not_stand_up(nominal, physics):
    """A policy that does nothing: 0 of both sides, no time; the physics are those that are asked for."""
    held_out = HeldOut(nominal, Task(), 1, physics)
    got = held_out.run(STILL, 0)
    assert (got.prone, got.supine) == (0.0, 0.0)
    assert np.isnan(got.time_s)
    timestep = held_out.starts(0)[0].model.opt.timestep
    assert (timestep == pytest.approx(0.00625)) == (physics == "fast")


@pytest.mark.parametrize(
    ("stands", "tried", "expected"),
    [
        ([0, 2, 5, 7], 8, Result(0.5, 0.5, 3.0)),
        ([1, 2, 3, 5, 6, 7], 2, Result(0.0, 0.0, float("nan"))),  # none of the first of each side
        ([4], 8, Result(0.0, 0.25, 3.0)),
    ],
)
def test_shares_are_of_sides(nominal, monkeypatch, stands, tried, expected):
    """Successes are counted for each side, times over all of them; hopeless policies are not asked for everything."""
    held_out = HeldOut(nominal, Task(), 4, "fast")
    starts, seen = held_out.starts(0), []

    def run(self, controllers, some, longest_s):
        assert longest_s == [Task().episode_s]
        places = [[one is start for one in starts].index(True) for start in some]
        seen.extend(places)
        return [[Trial(3.0 if place in stands else np.nan, 0.1, False, 5.0) for place in places]]

    monkeypatch.setattr("frasa_rl.fall_trials.Falls.run", run)
    got = held_out.run(STILL, 0)
    assert str(got) == str(expected)
    assert got.success == (got.prone + got.supine) / 2
    assert len(seen) == len(set(seen)) == tried


def test_the_best_is_by_success_then_time_then_the_newer(tmp_path):
    """A table that comes back as it was; with what was asked for, success is tried twice on different falls."""
    kept = Evaluations(tmp_path, 0.9)
    nan = float("nan")
    for steps, (prone, supine, time_s), best in [
        (10, (0.0, 0.0, nan), True),
        (20, (0.0, 0.0, nan), True),
        (30, (0.5, 0.0, 3.0), True),
        (40, (0.0, 0.5, 3.5), False),
        (50, (0.0, 0.5, 2.5), True),
    ]:
        assert kept.add(steps, 0.5, prone, supine, time_s) == best
        assert not kept.holds
    assert kept.best[0] == 50
    assert kept.evaluated_steps == 50
    assert kept.next_set == 0
    kept.add(60, 0.6, 0.8, 1.0, 2.0)
    assert (kept.next_set, kept.holds) == (1, False)
    kept.add(70, 0.7, 1.0, 0.9, 2.0)
    assert (kept.next_set, kept.holds) == (0, True)
    assert shown(kept.last) == "held-out 100 % prone 90 % supine"
    other = Evaluations(tmp_path / "other", None)
    other.restore(part("e", {f"e.{name}": one for name, one in kept.snapshot().items()}))
    np.testing.assert_array_equal(other.rows, kept.rows)
    assert not other.holds
    np.testing.assert_array_equal(EVALUATIONS.read(tmp_path / "other"), kept.rows)

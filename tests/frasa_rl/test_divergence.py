"""A robot whose simulation blows up ends its episode and is counted; the others do not notice."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl import starts as module
from frasa_rl.batch_env import StandUpBatch
from frasa_rl.config import Task
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model

STILL = np.zeros((3, 5))


@pytest.fixture
def sound(nominal, tmp_path, monkeypatch):
    """A batch of three, and starts of it."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it runs
    model = build_model(nominal, Task())
    maker = StartMaker(model, Task(), None, threads=1)
    starts = maker.make([np.random.default_rng(seed) for seed in range(3)], ["falling"] * 3)
    return lambda: StandUpBatch(model, Task(), 3, threads=2), starts


def spoilt(start, what):
    """A start with one number of its state replaced."""
    state = start.state.copy()
    index, value = {
        "nan speed": (1 + 27 + 8, np.nan),
        "huge speed": (1 + 27 + 8, 1e12),
        "infinite angle": (1 + 9, np.inf),
        "fast": (1 + 27 + 8, 1e6),  # not yet what MuJoCo warns of: it does in a later substep
    }[what]
    state[index] = value
    return replace(start, state=state)


@pytest.mark.parametrize("what", ["nan speed", "huge speed", "infinite angle", "fast"])
def test_one_robot_blows_up(sound, what):
    """It ends, unpaid, with what it saw last; the other two go on as if it had not been there."""
    make, starts = sound
    together, without = make(), make()
    for index, start in enumerate(starts):
        together.begin(index, start)
        without.begin(index, start)
    told = np.random.default_rng(0).uniform(-0.2, 0.2, (4, 3, 5))
    for core in (together, without):
        core.step(told[0])
    seen = together.batch.observation[1].copy()
    now = replace(starts[1], state=together.batch.sim.state[1].copy(), sensors=together.batch.sim.sensors[1].copy())
    together.begin(1, spoilt(now, what), look=False)
    out, other = together.step(told[1]), without.step(told[1])
    assert out.diverged.tolist() == [False, True, False]
    assert out.terminated[1]
    assert not out.truncated[1]
    assert not out.success[1]
    assert out.reward[1] == 0.0
    np.testing.assert_array_equal(out.observation[1], seen)
    assert np.isfinite(out.observation).all()
    assert np.isfinite(out.terms).all()
    assert (together.divergences, without.divergences) == (1, 0)
    together.begin(1, starts[1])  # another episode of it is sound
    for k in (2, 3):
        np.testing.assert_array_equal(out.observation[[0, 2]], other.observation[[0, 2]])
        np.testing.assert_array_equal(out.reward[[0, 2]], other.reward[[0, 2]])
        out, other = together.step(told[k]), without.step(told[k])
        assert not out.diverged.any()
    assert together.divergences == 1


def test_all_at_once_are_all_counted(sound):
    """Three of three in one step."""
    make, starts = sound
    core = make()
    for index, start in enumerate(starts):
        core.begin(index, spoilt(start, "nan speed"), look=False)
    out = core.step(STILL)
    assert out.diverged.all()
    assert np.isfinite(out.observation).all()
    assert core.divergences == 3


def test_a_release_that_blows_up_is_drawn_again(nominal, tmp_path, monkeypatch):
    """A start is of a sound robot: one that diverged while it settled was released anew, of the same robot."""
    monkeypatch.chdir(tmp_path)

    maker = StartMaker(build_model(nominal, Task()), Task(), None, threads=1)
    (usual,) = maker.make([np.random.default_rng(0)], ["falling"])
    let_go, times = module.let_go, []

    def first_is_broken(*arguments):
        start = let_go(*arguments)
        times.append(start.drawn)
        return spoilt(start, "nan speed") if len(times) == 1 else start

    monkeypatch.setattr(module, "let_go", first_is_broken)
    (again,) = maker.make([np.random.default_rng(0)], ["falling"])
    assert len(times) == 2
    assert again.drawn == usual.drawn == times[0]
    assert np.isfinite(again.state).all()
    assert not np.array_equal(again.state, usual.state)
    np.testing.assert_array_equal(again.ages, usual.ages)
    np.testing.assert_array_equal(again.model.sensor_delay, usual.model.sensor_delay)

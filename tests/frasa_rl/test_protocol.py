"""The protocol's clocks: known motions give known times, whatever the rate of decisions and the number of trials."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frasa_rl.config import Joint, Names, PushRig, Task
from frasa_rl.controllers import Nothing, PolicyController
from frasa_rl.policy import Policy
from frasa_rl.protocol import Conditions
from frasa_rl.protocol_push import run_push
from frasa_rl.protocol_standup import run_standup
from frasa_rl.trials import first_hold
from frasa_sysid.calibration import UsageError

BOX = Path(__file__).with_name("box_robot.xml")
BOX_TASK = Task(
    joints=(Joint("neck", 0.0),),
    target_pitch_deg=0.0,
    held_deg=(),
    names=Names("torso", "ground", "{}", "{}", None, None, None, None, None),
)
LYING_TASK = replace(BOX_TASK, target_pitch_deg=90.0)  # a robot that is where it should be when it lies prone
HEAVY = 'mass="5"', 'mass="200"'
SLENDER = 'size="0.15 0.2 0.46"', 'size="0.03 0.2 0.46"'


class Script:
    """Turns the neck at given speeds [deg/s] between given times [s], and remembers nothing else."""

    name = "script"

    def __init__(self, *pieces):
        self._pieces = pieces

    def start(self, count, period_s):
        self._count, self._period, self._acts = count, period_s, 0

    def act(self, observation):
        now = self._acts * self._period + 1e-9
        self._acts += 1
        speed = sum(speed for begin, end, speed in self._pieces if begin <= now < end)
        return np.full((self._count, 1), np.radians(speed) / BOX_TASK.rate_limit)


class Home(Script):
    """After a second, turns the neck to 0 at 30 deg/s; remembers where it began."""

    def act(self, observation):
        command = np.degrees(observation[:, 2].astype(float))
        if self._acts == 0:
            self.first = command.copy()
        now = self._acts * self._period + 1e-9
        self._acts += 1
        step = np.clip(-command, -30.0 * self._period, 30.0 * self._period) if now >= 1.0 else 0.0 * command
        return np.radians(step / self._period)[:, None] / BOX_TASK.rate_limit


def edited(tmp_path, *changes):
    """The box with something replaced in its file."""
    text = BOX.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "box.xml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("good", "samples", "begin", "found"),
    [
        ("0111", 3, 0, 1),
        ("1101110", 3, 0, 3),
        ("1101110", 2, 0, 0),
        ("1101110", 2, 1, 3),
        ("1111", 5, 0, None),
        ("1101", 3, 0, None),
        ("", 1, 0, None),
    ],
)
def test_a_hold_begins_where_its_first_sample_is(good, samples, begin, found):
    """The first run that is long enough counts, from where one looks on."""
    assert first_hold(np.array([one == "1" for one in good], dtype=bool), samples, begin) == found


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_a_stand_up_is_timed_from_its_first_movement(rate):
    """A neck that waits a second and then turns home at 30 deg/s is within 5 deg when geometry says; 10 ms of servo."""
    controller = Home()
    done = run_standup(controller, Conditions(BOX, LYING_TASK, rate), 3)
    expected = (np.abs(controller.first[:3]) - 5.0) / 30.0
    assert (expected > 0.05).all()
    for trial, time_s in zip(done[:3], expected, strict=True):
        assert trial.side == "prone"
        assert trial.time_s == pytest.approx(time_s, abs=0.010)
        assert trial.from_decision_s == pytest.approx(time_s + 1.0, abs=0.010)
    assert [trial.time_s for trial in done[3:]] == [None] * 3


class Watched(PolicyController):
    """A policy whose first observation is kept."""

    def act(self, observation):
        self.first = getattr(self, "first", np.degrees(observation[:, 2].astype(float)))
        return super().act(observation)


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_the_same_policy_runs_at_every_rate(rate):
    """A neck that a policy turns home at tanh(-0.2 command) of the rate limit is there when that rule says."""
    layers = ((np.array([[0, 0, -0.2, 0, 0, 0]], dtype=np.float32), np.zeros(1, dtype=np.float32)),)
    controller = Watched(Policy(layers, {}), "p")
    trials = run_standup(controller, Conditions(BOX, LYING_TASK, rate), 3, sides=["prone"])
    for trial, begin in zip(trials, np.radians(controller.first), strict=True):
        times, commands = [0.0], [begin]
        while abs(commands[-1]) > np.radians(1.0):
            commands.append(commands[-1] - np.tanh(0.2 * commands[-1]) * BOX_TASK.rate_limit / rate)
            times.append(times[-1] + 1.0 / rate)
        assert abs(begin) > np.radians(6.0)
        expected = np.interp(-np.radians(5.0), -np.abs(commands), times)
        assert trial.time_s == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_instability_is_timed_from_deviation_to_stability(tmp_path, rate):
    """Leaves at 50 deg/s, stays away, comes back: 5 deg are passed at 3.1 s and at 4.3 s."""
    script = Script((3.0, 3.4, 50.0), (4.0, 4.4, -50.0))
    conditions = Conditions(edited(tmp_path, HEAVY), BOX_TASK, rate)
    trial = run_push(script, conditions, 1, cells=[("front", 4.0)])[0]
    assert trial.stood
    assert trial.hit
    assert not trial.fell
    assert trial.time_s == pytest.approx(1.2, abs=0.010)


def test_a_push_that_moves_nothing_is_no_instability(tmp_path):
    """A robot too heavy to be moved by 5 deg was never unstable."""
    trials = run_push(Nothing(BOX_TASK), Conditions(edited(tmp_path, HEAVY), BOX_TASK), 2, cells=[("back", 5.5)])
    assert [(one.time_s, one.fell, one.hit) for one in trials] == [(0.0, False, True)] * 2


def test_a_fall_is_a_fall(tmp_path):
    """A slender box on rough ground is knocked over, and does not get up."""
    rough = ('friction="0.01"', 'friction="1"')
    trial = run_push(
        Nothing(BOX_TASK), Conditions(edited(tmp_path, SLENDER, rough), BOX_TASK), 1, cells=[("front", 7.3)]
    )[0]
    assert (trial.stood, trial.hit, trial.fell, trial.time_s) == (True, True, True, None)


def test_a_controller_that_does_not_stand_is_not_pushed():
    """Who leaves the pose before the push is counted apart: neither hit nor fallen, also where no bob could hit it."""
    script, rod = Script((0.5, 1.0, 30.0)), replace(BOX_TASK, rig=PushRig(height=4.0))
    for conditions in (Conditions(BOX, BOX_TASK), Conditions(BOX, rod)):
        trial = run_push(script, conditions, 1, cells=[("front", 7.3)])[0]
        assert (trial.stood, trial.hit, trial.fell, trial.time_s) == (False, False, False, None)
        assert trial.impulse == 0.0


def test_trials_depend_on_the_seed_and_their_number_alone():
    """More trials, other pushes or another order change none of those before; another seed changes all."""

    def numbers(trials):
        return [(one.direction, one.energy_j, one.impulse, one.time_s, tuple(one.strain)) for one in trials]

    conditions = Conditions(BOX, BOX_TASK)
    cells = [("front", 4.0), ("back", 7.3)]
    two = numbers(run_push(Nothing(BOX_TASK), conditions, 2, cells=cells))
    assert numbers(run_push(Nothing(BOX_TASK), conditions, 1, cells=cells[::-1])) == [two[2], two[0]]
    other = numbers(run_push(Nothing(BOX_TASK), replace(conditions, seed=1), 1, cells=cells))
    assert other[0][2] != two[0][2]
    lying = Conditions(BOX, LYING_TASK)
    more = run_standup(Home(), lying, 3)
    fewer = run_standup(Home(), lying, 1)
    assert [one.time_s for one in fewer] == [more[0].time_s, more[3].time_s]


def test_a_policy_does_not_see_how_many_robots_there_are():
    """The same observation gives the same bits, alone or among others."""
    rng = np.random.default_rng(0)
    sizes = [(64, 22), (48, 64), (5, 48)]
    layers = tuple((rng.normal(size=one).astype(np.float32) / 8, np.zeros(one[0], dtype=np.float32)) for one in sizes)
    controller = PolicyController(Policy(layers, {}), "p")
    seen = rng.normal(size=(33, 22)).astype(np.float32)
    np.testing.assert_array_equal(controller.act(seen)[:2], controller.act(seen[:2]))


def test_doing_nothing_does_not_stand_up(nominal):
    """The measure is honest: held commands never stand a lying robot up."""
    done = run_standup(Nothing(Task()), Conditions(nominal), 2)
    assert [(one.side, one.time_s) for one in done] == [("prone", None)] * 2 + [("supine", None)] * 2


def test_doing_nothing_after_a_small_push(nominal):
    """Hit from behind with 4 J the nominal robot sways for a second and stays up; with 7.3 J it falls."""
    done = run_push(Nothing(Task()), Conditions(nominal), 2, cells=[("back", 4.0), ("back", 7.3)])
    assert all(one.stood and one.hit for one in done)
    assert [one.fell for one in done] == [False, False, True, True]
    assert [one.time_s for one in done[:2]] == pytest.approx([1.2, 1.2], abs=0.2)


def test_a_rate_that_does_not_fit_is_refused(nominal):
    """Decisions must fit into the task's control period."""
    for rate in (30.0, 10.0, 19.0):
        with pytest.raises(
            UsageError, match=f"^{rate:g} decisions a second do not fit .*: expected one of 20, 100, 500$"
        ):
            run_standup(Nothing(Task()), Conditions(nominal, rate_hz=rate), 1)


def test_random_robots_differ(nominal):
    """With randomize every trial has a robot of its own; without, all are the same."""
    drawn = run_standup(Nothing(Task()), Conditions(nominal, randomize=True), 2, sides=["prone"])
    assert drawn[0].strain[2] != pytest.approx(drawn[1].strain[2], rel=1e-3)

"""A trial as numbers over time, and as figures of them."""

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.controllers import PolicyController
from frasa_rl.evaluate import find_controller
from frasa_rl.policy import Policy
from frasa_rl.protocol import Conditions, evaluation_task
from frasa_rl.protocol_push import run_push
from frasa_rl.protocol_standup import run_standup
from frasa_rl.render import RenderError
from frasa_rl.watch import watch_push, watch_standup

TASK = evaluation_task(Task())


@pytest.fixture(scope="module")
def conditions(robot_model_dir):
    return Conditions(robot_model_dir / "calibrated.xml", TASK, threads=1)


@pytest.fixture(scope="module")
def shipped(robot_model_dir):
    return PolicyController(Policy.load(robot_model_dir / "policies" / "standup" / "policy"), "shipped")


@pytest.fixture(scope="module")
def supine(shipped, conditions):
    return watch_standup(shipped, conditions, "supine", more_s=0.2)


def test_a_watched_trial_is_that_of_the_tables(supine, shipped, conditions):
    """The time to stand up is that of the protocol's first trial, to the last digit."""
    assert supine.time_s == run_standup(shipped, conditions, 1, sides=["supine"])[0].time_s
    assert supine.t[-1] == pytest.approx(supine.time_s + TASK.success_hold_s, abs=0.5)


def test_what_is_recorded_fits_together(supine):
    """Commands follow from actions, the pose at the end is the standing one, and the start lies on its back."""
    assert len({len(one) for one in (supine.t, supine.joints, supine.commands, supine.actions, supine.states)}) == 1
    steps = np.diff(supine.commands, axis=0) / (TASK.rate_limit * TASK.control_period_s)
    inside = np.abs(steps - np.clip(supine.actions[1:], -1, 1)) < 1e-6  # else a command is on its limit
    assert inside.mean() > 0.8
    assert np.abs(supine.actions[1:]).max() > 0.5
    assert not supine.actions[0].any()
    assert supine.names == tuple(one.name for one in TASK.joints)
    np.testing.assert_allclose(np.degrees(supine.joints[-1]), [one.target_deg for one in TASK.joints], atol=5)
    assert np.degrees(supine.pitch[0]) < -60
    assert supine.height[-1] > supine.height[0] + 0.1
    assert supine.worst_deg[0] > 30
    assert supine.worst_deg[-1] < 5
    assert supine.words == f"{supine.time_s:.2f} s"
    assert supine.until_decided(0.1).t[-1] == pytest.approx(supine.time_s + 0.1, abs=0.05)
    part = supine.between(0.2, 0.4)
    np.testing.assert_allclose(part.t, [0.2, 0.25, 0.3, 0.35, 0.4])
    np.testing.assert_array_equal(part.joints, supine.joints[4:9])


def test_a_push_is_that_of_the_tables(shipped, conditions):
    """The time of instability and the fall are those of the protocol's first trial."""
    watched = watch_push(shipped, conditions, ("back", 4.0), more_s=0.1)
    trial = run_push(shipped, conditions, 1, cells=[("back", 4.0)])[0]
    assert watched.stood
    assert watched.time_s == trial.time_s
    assert watched.t[0] == 0.0


def test_another_rate_is_recorded_once_a_control_period(conditions, robot_model_dir):
    """However often a controller decides, a row is a control period."""
    keyframes, _ = find_controller(str(robot_model_dir / "keyframes.yaml"), conditions.model, TASK)
    fast = Conditions(conditions.model, TASK, rate_hz=100.0, threads=1)
    watched = watch_standup(keyframes, fast, "prone", seconds=0.5)
    np.testing.assert_allclose(np.diff(watched.t), TASK.control_period_s)
    assert watched.time_s is None
    assert watched.words == "not within 0.5 s"
    assert watched.until_decided() is watched


def test_figures(supine, monkeypatch):
    """Strips, sticks where nothing can be drawn, traces and actions show what was recorded."""
    pytest.importorskip("matplotlib")
    from frasa_rl import watch_figures

    def blind(*_, **__):
        raise RenderError("no OpenGL here")

    monkeypatch.setattr(watch_figures, "film_of", blind)
    strip = watch_figures.strip_figure(supine, "supine", count=5)
    assert [ax.get_title() for ax in strip.axes][::4] == ["0.00 s", f"{supine.t[-1]:.2f} s"]
    first, last = strip.axes[0], strip.axes[-1]
    assert max(np.max(line.get_ydata()) for line in first.lines) < 0.45  # lies, its arms up
    assert max(np.max(line.get_ydata()) for line in last.lines) > 0.55  # stands
    traces = watch_figures.watched_figure({"ours": supine})
    pitch = traces.axes[0].lines[0]
    np.testing.assert_array_equal(pitch.get_ydata(), np.degrees(supine.pitch))
    assert len([ax for ax in traces.axes if ax.get_visible()]) == 3 + len(supine.names)
    shown = watch_figures.action_figure(supine).axes[0].images[0].get_array()
    np.testing.assert_array_equal(shown, supine.actions[1:].T)


def test_pictures_where_they_can_be_drawn(shipped, conditions):
    """The strip holds rendered pictures on a machine that draws."""
    pytest.importorskip("matplotlib")
    from frasa_rl.render import check_drawing
    from frasa_rl.watch_figures import strip_figure

    try:
        check_drawing()
    except RenderError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    watched = watch_standup(shipped, conditions, "prone", seconds=0.2, textures=True)
    strip = strip_figure(watched, count=2)
    assert [len(ax.images) for ax in strip.axes] == [1, 1]
    assert strip.axes[0].images[0].get_array().std() > 10

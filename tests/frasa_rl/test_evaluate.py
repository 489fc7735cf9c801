"""What a controller's trials come to, and which controllers are let near a model."""

import argparse
import json
from dataclasses import asdict

import mujoco
import numpy as np
import pytest

from frasa_rl.commands import evaluate as evaluate_command
from frasa_rl.commands import rank as rank_command
from frasa_rl.config import Task
from frasa_rl.controllers import Nothing
from frasa_rl.evaluate import Evaluation, check_policy, find_controller
from frasa_rl.instruments import over_time
from frasa_rl.policy import Policy, PolicyError
from frasa_rl.protocol import Conditions, mean_and_std
from frasa_rl.protocol_picture import PictureError, draw
from frasa_rl.protocol_push import PushTrial
from frasa_rl.protocol_standup import StandUpTrial, run_standup
from frasa_rl.protocol_tables import tables
from frasa_rl.routine import KeyframeError
from frasa_sysid.calibration import CalibrationError, UsageError, load_model, model_sha256, plain

TASK = Task()
STRAIN = np.array([4.0, 3.0, 200.0, 0.5, 0.1])
STANDUP = [
    StandUpTrial("prone", 2.0, 2.25, False, STRAIN),
    StandUpTrial("prone", 3.0, 3.25, False, 3.0 * STRAIN),
    StandUpTrial("supine", None, None, True, STRAIN),
]
PUSH = [
    PushTrial("front", 4.0, True, True, 3.1, 0.5, False, False, STRAIN),
    PushTrial("front", 4.0, True, True, 3.3, 2.5, True, False, STRAIN),
    PushTrial("front", 4.0, False, False, 0.0, None, False, False, 0.0 * STRAIN),
    PushTrial("back", 7.3, True, False, 0.0, None, False, False, STRAIN),
]


def result():
    about = {"controller": "c", "model": "m.xml", "calibration_id": None, "rate_hz": 20.0, "randomized": False}
    return {**Evaluation(STANDUP, PUSH).to_dict(), **about}


def still_policy(**run):
    layer = (np.zeros((5, 22), dtype=np.float32), np.zeros(5, dtype=np.float32))
    return Policy((layer,), {"task": plain(asdict(TASK)), "calibration_id": None, **run})


def test_rows_count_what_happened():
    """Means are of successes, rates are of all trials; falls, no stand and misses are counted apart."""
    said = result()
    assert said["standup"]["prone"] == {
        "trials": 2,
        "success_rate": 1.0,
        "time_mean_s": 2.5,
        "time_std_s": 0.5,
        "from_decision_mean_s": 2.75,
        "times_s": [2.0, 3.0],
        "paper_s": {"agent": (2.135, 0.042), "keyframes": (3.154, None)},
    }
    assert said["standup"]["supine"]["time_mean_s"] is None
    front, back = said["push"]
    assert front == {
        "direction": "front",
        "energy_j": 4.0,
        "trials": 3,
        "success_rate": pytest.approx(2 / 3),
        "instability_mean_s": 1.5,
        "instability_std_s": 1.0,
        "falls": 1,
        "not_standing": 1,
        "missed": 0,
        "impulse_mean_ns": pytest.approx(3.2),
        "times_s": [0.5, 2.5, None],
        "paper_s": 0.54,
    }
    assert (back["missed"], back["not_standing"], back["paper_s"]) == (1, 0, None)
    assert said["divergences"] == 1
    assert said["strain"]["peak_floor_force"] == pytest.approx((1 + 3 + 1 + 1 + 1) / 5 * 200.0)
    json.dumps(plain(said), allow_nan=False)


def test_without_a_success_there_is_no_mean():
    """No trial succeeded: no number is made up."""
    assert mean_and_std([None, None]) == (None, None)


def test_the_strain_of_a_trial_is_its_peaks_and_its_sum():
    """Peaks over the periods; self-contact adds up; shaking is of the end; no period, no strain."""
    periods = np.array([[1, 5, 2, 3, 9], [4, 2, 2, 3, 1], [0, 0, 0, 0, 3]])
    np.testing.assert_array_equal(over_time(periods, 2), [4, 5, 2, 6, 2])
    np.testing.assert_array_equal(over_time(periods, 9)[4], 13 / 3)
    np.testing.assert_array_equal(over_time(np.zeros((0, 5)), 2), np.zeros(5))


def test_the_strain_is_what_mujoco_says(nominal):
    """A robot that lies still is carried by the floor with its weight, and no servo exceeds its limit."""
    strain = run_standup(Nothing(TASK), Conditions(nominal), 1, sides=["prone"])[0].strain
    assert strain[2] == pytest.approx(7.805 * 9.81, rel=0.05)
    assert 0.1 < strain[0] <= 8.0
    assert strain[1] < 0.2
    assert 0.0 < strain[4] < strain[1]


def test_a_controller_that_shakes_is_seen(nominal):
    """Commands to and fro are twenty times the motion of a robot that lies still."""

    class Shaking(Nothing):
        def act(self, observations):
            self.sign = -getattr(self, "sign", 1.0)
            return np.full((len(observations), len(TASK.joints)), 0.5 * self.sign)

    still, shaken = (
        run_standup(one(TASK), Conditions(nominal), 1, sides=["prone"])[0].strain[4] for one in (Nothing, Shaking)
    )
    assert shaken > 20.0 * still


def test_the_tables_stand_beside_the_papers():
    """Every row has the paper's number; the push that is not in our notes has a dash."""
    text = tables(result())
    lines = {line.split()[0] + " " + line.split()[1]: line for line in text.splitlines() if " " in line}
    assert "2.500 +- 0.500  2.135 +- 0.042" in lines["prone 2"]
    assert lines["supine 1"].split()[2:4] == ["0%", "-"]
    assert lines["supine 1"].endswith("5.060")
    assert lines["front 4.0"].endswith("1.50 +- 1.00          0.54")
    assert lines["back 7.3"].split()[-1] == "-"
    assert "blew up in 1 trials" in text


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_tables_as_a_picture(tmp_path, suffix):
    """The chart is drawn, also where nothing succeeded or one protocol was left out."""
    pytest.importorskip("matplotlib")
    draw(result(), tmp_path / f"chart{suffix}")
    draw({**result(), "push": []}, tmp_path / f"half{suffix}")
    assert (tmp_path / f"chart{suffix}").stat().st_size > 5000
    assert {one.name for one in tmp_path.iterdir()} == {f"chart{suffix}", f"half{suffix}"}


def test_a_picture_needs_matplotlib_and_a_format(tmp_path, monkeypatch):
    """What is missing is said before any trial runs."""
    with pytest.raises(UsageError, match=r"\.svg"):
        draw(result(), tmp_path / "chart.bmp")
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(PictureError, match="report"):
        draw(result(), tmp_path / "chart.png")


def test_a_policy_of_another_calibration_is_refused():
    """A policy acts on another calibration only when that is meant."""
    with pytest.raises(CalibrationError, match=r"none \(nominal\).*c0ffee"):
        check_policy(still_policy(), TASK, "c0ffee")
    check_policy(still_policy(), TASK, "c0ffee", allow_other_model=True)
    check_policy(still_policy(calibration_id="c0ffee"), TASK, "c0ffee")
    with pytest.raises(CalibrationError, match="other1"):
        check_policy(still_policy(calibration_id="other1"), TASK, None)


def test_a_policy_of_another_task_is_refused():
    """A policy that sees another number of things or moves other joints is refused."""
    layer = (np.zeros((5, 21), dtype=np.float32), np.zeros(5, dtype=np.float32))
    with pytest.raises(PolicyError, match="21"):
        check_policy(Policy((layer,), {}), TASK, None)
    other = plain(asdict(TASK))
    other["joints"][0]["name"] = "wrist"
    for task in (other, None):
        with pytest.raises(PolicyError, match="another task"):
            check_policy(still_policy(task=task), TASK, None)


def test_a_policy_runs_on_its_own_model(nominal, tmp_path):
    """Without --model a policy runs on the model it was trained on; a named one goes before."""
    still_policy(model=str(nominal)).save(tmp_path)
    controller, model = find_controller(str(tmp_path), None, TASK)
    assert (controller.name, model) == (str(tmp_path), nominal)
    np.testing.assert_array_equal(controller.act(np.ones((3, 22), dtype=np.float32)), np.zeros((3, 5)))
    assert find_controller("nothing", nominal, TASK)[1] == nominal


def test_keyframes_are_a_controller(nominal, robot_model_dir, tmp_path, monkeypatch):
    """The word is the shipped file, a file is itself, and one that is not there is named."""
    monkeypatch.chdir(robot_model_dir.parent)
    mine = tmp_path / "mine.yaml"
    mine.write_text((robot_model_dir / "keyframes.yaml").read_text())
    for word in ("keyframes", str(mine)):
        controller, model = find_controller(word, nominal, TASK)
        assert (controller.name, model) == ("keyframe", nominal)
    with pytest.raises(KeyframeError, match=r"none\.yaml"):
        find_controller(str(tmp_path / "none.yaml"), nominal, TASK)


def test_a_nominal_model_that_was_changed_is_told(model_copy, tmp_path):
    """Without a calibration there is no id to compare: the compiled model is."""
    run = {"model": str(model_copy), "model_sha256": model_sha256(load_model(model_copy))}
    still_policy(**run, versions={"mujoco": mujoco.__version__}).save(tmp_path / "policy")
    word = str(tmp_path / "policy")
    find_controller(word, None, TASK)
    model_copy.write_text(model_copy.read_text().replace('impratio="1"', 'impratio="2"'))
    with pytest.raises(CalibrationError, match="changed since"):
        find_controller(word, None, TASK)
    find_controller(word, None, TASK, allow_other_model=True)


def test_candidates_are_chosen_by_other_trials_than_they_are_praised_for():
    """What `rank` tries is not what `evaluate` reports."""
    parser = argparse.ArgumentParser()
    evaluate_command.add_command(parser.add_subparsers())
    reported = parser.parse_args(["evaluate", "nothing"]).seed
    parser = argparse.ArgumentParser()
    rank_command.add_command(parser.add_subparsers())
    assert parser.parse_args(["rank", "nothing"]).seed != reported

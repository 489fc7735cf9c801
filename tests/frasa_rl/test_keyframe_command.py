"""frasa-rl keyframe: trials, tuning, and one line for every mistake."""

import json

import pytest
import yaml

from frasa_rl import keyframe_tuner
from frasa_rl.cli import main
from frasa_rl.keyframe_file import load_keyframes

pytest.importorskip("sb3_contrib")  # the command line is imported as a whole


@pytest.fixture
def shipped(robot_model_dir):
    return robot_model_dir / "keyframes.yaml"


@pytest.fixture
def words(nominal, shipped):
    return ["keyframe", "--no-report", "--model", str(nominal), "--keyframes", str(shipped)]


def test_trials_are_printed_and_given_as_json(words, capsys):
    """Both sides, with success rate and times, for people and for machines."""
    trials = ["--trials", "1", "--push-trials", "1", "--seed", "10000"]
    assert main([*words, *trials, "--json"]) == 0
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert result["schema"] == "frasa.evaluation/2"
    assert {side: one["success_rate"] for side, one in result["standup"].items()} == {"prone": 1.0, "supine": 1.0}
    assert len(result["push"]) == 6
    assert result["randomized"] is False
    assert "prone" in said.err


def test_tuning_keeps_the_best_in_a_file(words, tmp_path, capsys):
    """The file can be run, and says where it came from."""
    out = tmp_path / "tuned.yaml"
    assert main([*words, "--tune", "--seed", "0", "--minutes", "0.001", "--best", str(out), "--json"]) == 0
    load_keyframes(out)
    assert out.read_text().startswith("# Tuned by frasa-rl keyframe --tune from keyframes.yaml on nominal.xml")
    assert json.loads(capsys.readouterr().out)["schema"] == "frasa.keyframe-tuning/1"


def test_stopping_a_tuning_loses_nothing(words, tmp_path, monkeypatch, capsys):
    """Ctrl-C ends with 130 and says where the best so far is."""

    def stopped(keyframes, env, tuning, save, tell):
        raise KeyboardInterrupt

    monkeypatch.setattr(keyframe_tuner, "tune", stopped)
    out = tmp_path / "tuned.yaml"
    assert main([*words, "--tune", "--best", str(out)]) == 130
    assert str(out) in capsys.readouterr().err
    load_keyframes(out)


@pytest.mark.parametrize(
    ("more", "status"),
    [
        (["--trials", "0"], 2),
        (["--seed", "-1"], 2),
        (["--minutes", "3"], 2),
        (["--best", "x.yaml"], 2),
        (["--tune", "--minutes", "-1"], 2),
        (["--keyframes", "none.yaml"], 3),
        (["--model", "none.xml"], 3),
    ],
)
def test_a_mistake_is_one_line(more, status, words, capsys):
    """Bad numbers, flags that do not go together, files that are not there."""
    assert main([*words, *more]) == status
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_angles_that_the_model_cannot_take_are_refused(words, shipped, tmp_path, capsys):
    """A knee that bends the wrong way is found before a trial runs."""
    data = yaml.safe_load(shipped.read_text())
    data["supine"]["keys"][0]["angles_deg"][3] = -20.0
    path = tmp_path / "keyframes.yaml"
    path.write_text(yaml.safe_dump(data))
    model = ["--model", words[3]]
    for command in (
        [*words, "--keyframes", str(path)],
        [*words, "--keyframes", str(path), "--tune"],
        ["evaluate", str(path), *model],
        ["play", str(path), *model, "--video", str(tmp_path / "film.png")],
        ["rank", str(path), *model],
    ):
        assert main(command) == 3
        said = capsys.readouterr().err
        assert f"{path}: outside the command limits [deg]: supine key 1 knee -20 (limits 0 to" in said
        assert len(said.splitlines()) == 1

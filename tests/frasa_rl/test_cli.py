"""Every command runs, prints one JSON object when asked, and ends with its exit status."""

import json

import pytest

from frasa_rl.cli import main
from frasa_rl.render import Camera, RenderError
from frasa_rl.standup_env import StandUp

pytest.importorskip("sb3_contrib")


@pytest.fixture(scope="module")
def run(robot_model_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli") / "run"
    assert main(["train", "--model", str(robot_model_dir / "nominal.xml"), "--steps", "200", "--out", str(folder)]) == 0
    return folder


def test_evaluate_prints_the_agreed_object(run, capsys):
    """evaluate --json carries schema, standup by side, push, controller, model and calibration id."""
    assert main(["evaluate", str(run), "--trials", "1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert {"schema", "standup", "push", "controller", "model", "calibration_id"} <= set(said)
    assert set(said["standup"]) == {"prone", "supine"}
    assert set(said["standup"]["prone"]) == {"trials", "success_rate", "time_mean_s", "time_std_s"}
    assert said["push"] == []


def test_nothing_is_a_controller(nominal, capsys):
    """The word 'nothing' stands for held commands."""
    assert main(["evaluate", "nothing", "--model", str(nominal), "--trials", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["controller"] == "nothing"


def test_train_prints_its_result(nominal, tmp_path, capsys):
    """train --json says where the policy is and why it stopped; people read standard error."""
    code = main(
        ["train", "--model", str(nominal), "--steps", "40", "--out", str(tmp_path / "r"), "--json", "--seed", "5"]
    )
    assert code == 0
    said = json.loads(capsys.readouterr().out)
    assert said["schema"] == "frasa.train/1"
    assert said["stopped"] == "steps"


def test_play_writes_a_film(run, nominal, tmp_path):
    """play films one trial."""
    env = StandUp(nominal)
    try:
        Camera(env.model).close()
    except RenderError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    path = tmp_path / "film.png"
    assert main(["play", str(run), "--video", str(path)]) == 0
    assert path.stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["train", "--model", "missing.xml", "--steps", "10"], 3, "no model at missing.xml"),
        (["train", "--model", "MODEL"], 2, "needs an end"),
        (["train", "--resume", "missing", "--seed", "1"], 2, "--seed from the run itself"),
        (["train", "--resume", "missing"], 3, "expected the folder of a run"),
        (["evaluate", "missing"], 3, "no policy at missing"),
        (["evaluate", "nothing", "--model", "BOX"], 3, "lacks joint left_elbow"),
        (["evaluate", "nothing", "--model", "MODEL", "--trials", "0"], 2, "--trials"),
        (["play", "nothing", "--model", "MODEL", "--video", "film.avi"], 2, ".gif"),
    ],
)
def test_errors_are_one_line_and_a_status(words, code, message, nominal, tmp_path, monkeypatch, capsys):
    """A user's mistake ends in one line that says what to do, and the agreed exit status."""
    monkeypatch.chdir(tmp_path)
    box = tmp_path / "box.xml"
    box.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    words = [{"MODEL": str(nominal), "BOX": str(box)}.get(word, word) for word in words]
    assert main(words) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]

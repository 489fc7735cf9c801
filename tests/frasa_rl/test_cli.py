"""Every command runs, prints one JSON object when asked, and ends with its exit status."""

import json
from pathlib import Path

import numpy as np
import pytest

from frasa_rl.cli import main
from frasa_rl.commands.train import advice_after
from frasa_rl.evaluate import Evaluation
from frasa_rl.plan import Plan
from frasa_rl.protocol_standup import StandUpTrial
from frasa_rl.render import Camera, RenderError
from frasa_rl.settings import Settings
from frasa_rl.standup_env import StandUp

pytest.importorskip("sb3_contrib")


@pytest.fixture(scope="module")
def run(robot_model_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli") / "run"
    words = ["train", "--model", str(robot_model_dir / "nominal.xml"), "--steps", "200", "--evaluate-falls", "1"]
    assert main([*words, "--no-report", "--out", str(folder)]) == 0
    return folder


def test_evaluate_prints_the_agreed_object(run, tmp_path, capsys, page_text):
    """evaluate --json carries schema, both tables, controller, model and calibration id; --out keeps all of it."""
    words = ["evaluate", str(run), "--trials", "1", "--push-trials", "1", "--json", "--out", str(tmp_path / "e")]
    assert main(words) == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    page = said.pop("outputs")["report"]
    assert page == str(tmp_path / "e" / "evaluation.html")
    assert {"schema", "standup", "push", "controller", "model", "calibration_id", "rate_hz", "seed"} <= set(said)
    assert set(said["standup"]) == {"prone", "supine"}
    assert {"trials", "success_rate", "time_mean_s", "time_std_s"} <= set(said["standup"]["prone"])
    assert [(one["direction"], one["energy_j"]) for one in said["push"]] == [
        (direction, energy) for direction in ("front", "back") for energy in (4.0, 5.5, 7.3)
    ]
    wanted = {"trials", "success_rate", "instability_mean_s", "instability_std_s", "falls", "not_standing"}
    assert wanted <= set(said["push"][0])
    assert json.loads((tmp_path / "e" / "evaluation.json").read_text()) == said
    table, _, told = err.strip().rpartition("\n")
    assert (tmp_path / "e" / "evaluation.txt").read_text().strip() == table
    assert told == f"report: {page}"
    text = page_text(Path(page))
    for words in (
        "Beside the paper",
        "2.135 ± 0.042",
        "What it does",
        "What it asks of the robot",
        "none: a nominal model",
    ):
        assert words in text, words
    assert "From prone: does not stand up" in text or "No pictures of the robot" in text
    assert said["schema"] in text
    assert (tmp_path / "e" / "evaluation.png").stat().st_size > 5000


@pytest.mark.parametrize(("protocol", "empty"), [("standup", "push"), ("push", "standup")])
def test_nothing_is_a_controller(nominal, protocol, empty, capsys):
    """The word 'nothing' stands for held commands; one protocol can be left out; 100 Hz is a rate."""
    words = ["evaluate", "nothing", "--model", str(nominal), "--trials", "1", "--push-trials", "1"]
    assert main([*words, "--protocol", protocol, "--rate", "100", "--json", "--no-report"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["controller"], said["rate_hz"]) == ("nothing", 100.0)
    assert not said[empty]
    assert said[protocol]


def test_rank_orders_its_candidates(run, nominal, monkeypatch, capsys):
    """rank runs every candidate on the robot as it is and on random ones, and carries the numbers behind the places."""
    ran = []

    def evaluate(controller, conditions, standup, push, tell):
        ran.append((controller.name, conditions.model, conditions.randomize, standup, push))
        time_s = None if controller.name == "nothing" else 2.0
        return Evaluation([StandUpTrial(side, time_s, time_s, False, np.ones(5)) for side in ("prone", "supine")], [])

    monkeypatch.setattr("frasa_rl.commands.rank.evaluate", evaluate)
    assert main(["rank", "nothing", str(run), "--model", str(nominal), "--trials", "3", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert ran == [(name, nominal, drawn, 3, 5) for name in ("nothing", str(run)) for drawn in (False, True)]
    assert said["schema"] == "frasa.rank/1"
    assert [one["name"] for one in said["candidates"]] == [str(run), "nothing"]
    first = said["candidates"][0]
    assert {"place", "mean_rank", "ranks", "numbers", "stands_up"} <= set(first)
    assert {"speed", "robustness", "versatility", "peak_torque", "self_contact"} <= set(first["numbers"])


def test_train_prints_its_result(nominal, tmp_path, capsys):
    """train --json says where the policy is and why it stopped; people read standard error."""
    words = ["train", "--model", str(nominal), "--steps", "40", "--out", str(tmp_path / "r"), "--json", "--seed", "5"]
    assert main([*words, "--algorithm", "sac", "--evaluate-falls", "1", "--no-report"]) == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert said["schema"] == "frasa.train/1"
    assert said["outputs"] == {"report": None}
    assert not (tmp_path / "r" / "report.html").exists()
    assert said["stopped"] == "steps"
    assert set(said["held_out"]) == {"steps", "success_prone", "success_supine", "time_mean_s"}
    assert "held-out 0 % prone 0 % supine" in err


@pytest.mark.parametrize("start", ["supine", "push-back"])
def test_play_writes_a_film(run, nominal, start, tmp_path, capsys):
    """play films one trial: a stand-up, or a push from its release on."""
    env = StandUp(nominal)
    try:
        Camera(env.model).close()
    except RenderError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    path = tmp_path / "film.png"
    assert (
        main(
            [
                "play",
                "nothing",
                "--model",
                str(nominal),
                "--start",
                start,
                "--seconds",
                "1",
                "--video",
                str(path),
                "--json",
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out)["frames"] == 21
    assert path.stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["train", "--model", "missing.xml", "--steps", "10"], 3, "no model at missing.xml"),
        (["train", "--model", "MODEL"], 2, "needs an end"),
        (["train", "--model", "MODEL", "--until-success", "1.5"], 2, "at most 1"),
        (["train", "--model", "MODEL", "--until-success", "0.9", "--evaluate-steps", "0"], 2, "needs evaluations"),
        (["train", "--model", "MODEL", "--steps", "8", "--seed", "5000000000"], 2, "seed is 5000000000: expected 0 .."),
        (["train", "--model", "MODEL", "--steps", "8", "--set", "batch=1"], 2, "batch is 1: expected 2"),
        (["train", "--model", "MODEL", "--minutes", "nan"], 2, "--minutes is nan"),
        (["train", "--model", "MODEL", "--steps", "-5"], 2, "--steps is -5"),
        (["rank", "nothing", "--model", "MODEL", "--trials", "1000000000"], 2, "--trials is 1000000000"),
        (["evaluate", "nothing", "--model", "MODEL", "--seed", "-1"], 2, "--seed is -1"),
        (["train", "--resume", "missing", "--seed", "1"], 2, "--seed from the run itself"),
        (["train", "--resume", "missing", "--env-threads", "1"], 2, "--env-threads from the run itself"),
        (["train", "--resume", "missing"], 3, "expected the folder of a run"),
        (["evaluate", "missing"], 3, "no policy at missing"),
        (["evaluate", "missing.zip"], 3, "no policy at missing.zip"),
        (["export", "missing"], 3, "no policy at missing"),
        (["export", "nothing"], 3, "no policy at nothing"),
        (["evaluate", "nothing", "--model", "BOX"], 3, "lacks joint left_elbow"),
        (["evaluate", "nothing", "--model", "MODEL", "--trials", "0"], 2, "--trials"),
        (["evaluate", "nothing", "--model", "MODEL", "--push-trials", "0"], 2, "--push-trials"),
        (["evaluate", "nothing", "--model", "MODEL", "--rate", "30"], 2, "do not fit"),
        (["evaluate", "nothing", "--model", "MODEL", "--rate", "nan"], 2, "--rate must be"),
        (["evaluate", "nothing", "--model", "MODEL", "--picture", "chart.bmp"], 2, ".svg"),
        (["evaluate", "nothing", "--model", "missing.xml"], 3, "no model at missing.xml"),
        (["evaluate", "missing.yaml", "--model", "MODEL"], None, "keyframe"),
        (["rank", "nothing", "nothing"], 2, "named twice"),
        (["rank", "nothing", "missing", "--model", "MODEL"], 3, "no policy at missing"),
        (["play", "nothing", "--model", "MODEL", "--video", "film.avi"], 2, ".gif"),
        (["play", "nothing", "--model", "MODEL", "--video", "f.png", "--seconds", "0"], 2, "--seconds"),
        (["play", "nothing", "--model", "MODEL", "--video", "f.png", "--pictures", "0"], 2, "--pictures"),
        (
            ["play", "nothing", "--model", "MODEL", "--video", "f.png", "--start", "push-back", "--energy", "50"],
            2,
            "11.3 J",
        ),
    ],
)
def test_errors_are_one_line_and_a_status(words, code, message, nominal, tmp_path, monkeypatch, capsys):
    """A user's mistake ends in one line that says what to do, and the agreed exit status."""
    monkeypatch.chdir(tmp_path)
    box = tmp_path / "box.xml"
    box.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    words = [{"MODEL": str(nominal), "BOX": str(box)}.get(word, word) for word in words]
    assert main(words) in ((2, 3) if code is None else (code,))
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert [one.name for one in tmp_path.iterdir()] == ["box.xml"]


@pytest.mark.parametrize(
    ("prone", "supine", "steps", "said"),
    [
        (1.0, 0.03, 400_000, "stand up supine"),
        (0.0, 0.0, 400_000, "prone and supine"),
        (1.0, 0.9, 400_000, None),
        (0.0, 0.0, 100_000, None),
    ],
)
def test_a_side_that_was_not_learned_is_told(prone, supine, steps, said):
    """With what to do; not after a training so short that nothing was to be expected."""
    plan = Plan(Path("model.xml"), Path("runs/one"), Settings(seed=3))
    advice = advice_after(plan, {"success_prone": prone, "success_supine": supine}, steps)
    told = said is not None and said in advice and "--seed 4" in advice and "frasa-rl play runs/one --start" in advice
    assert told or (said is None and advice == "")

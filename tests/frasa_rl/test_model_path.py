"""A run is found, and finds its model, from whatever folder one works in."""

from pathlib import Path

import pytest
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.cli import main
from frasa_rl.model_path import from_run, model_path

SMALL = ["--envs", "4", "--evaluate-falls", "1", "--set", "pool=4", "--evaluate-steps", "0", "--no-report"]


def test_a_run_finds_its_model_from_other_folders(model_copy, tmp_path, monkeypatch, capsys):
    """Evaluated, exported and resumed; where the model has moved, --model says to where, and only that one will do."""
    monkeypatch.chdir(tmp_path)
    named = str(model_copy.relative_to(tmp_path))
    assert main(["train", "--model", named, "--steps", "64", *SMALL, "--out", "runs/one", "--device", "cpu"]) == 0
    text = (tmp_path / "runs" / "one" / "run.yaml").read_text()
    said = yaml.safe_load(text)
    assert (said["model"], said["model_from_run"], said["computed_on"]) == (named, f"../../{named}", "cpu")
    assert str(tmp_path) not in text
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for run in ("../runs/one", "../runs/one/policy", "../runs/one/latest"):
        assert main(["export", run, "--out", "exported"]) == 0
    assert main(["train", "--resume", "../runs/one", "--steps", "128", "--no-report"]) == 0
    assert main(["evaluate", "../runs/one", "--protocol", "standup", "--trials", "1", "--no-report"]) == 0
    model_copy.parent.rename(tmp_path / "moved")
    moved = f"../moved/{model_copy.name}"
    capsys.readouterr()
    for words in (["evaluate", "../runs/one"], ["train", "--resume", "../runs/one"], ["export", "../runs/one"]):
        assert main(words) == 3
        told = capsys.readouterr().err
        assert "no model at" in told
        assert "--model" in told
        assert len(told.strip().splitlines()) == 1
    assert main(["train", "--resume", "../runs/one", "--model", moved, "--steps", "192", "--no-report"]) == 0
    path = Path(moved)
    path.write_text(path.read_text().replace("</mujoco>", '<worldbody><geom size="1"/></worldbody></mujoco>'))
    assert main(["train", "--resume", "../runs/one", "--model", moved, "--steps", "256", "--no-report"]) == 3
    assert "not the model this run was started with" in capsys.readouterr().err


def test_no_way_over_the_root_is_kept(tmp_path):
    """It would be a path of this machine."""
    assert from_run(Path("/models/robot.xml"), tmp_path) is None
    assert from_run(tmp_path / "robot.xml", tmp_path / "runs" / "one") == "../../robot.xml"


@pytest.mark.parametrize("way", ["/etc/passwd", "no.xml", "a\0b", "n" * 5000, 3, ["a"], None])
def test_what_is_no_way_leads_nowhere(tmp_path, way):
    """The path as it was named stays, for the error."""
    assert model_path({"model": "gone.xml", "model_from_run": way}, tmp_path) == Path("gone.xml")

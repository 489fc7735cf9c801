"""A disk that fills while training, exporting and evaluating (here: files that may not grow); then it goes on."""

from pathlib import Path

import pytest

pytest.importorskip("sb3_contrib")

from frasa_rl.cli import main
from frasa_rl.policy import Policy

TINY = (
    "envs=4", "pool=8", "batch=16", "actor=16,16", "critic=16,16", "learning_starts=40", "renorm_warmup=20",
    "evaluate_falls=1", "evaluate_physics=fast", "evaluate_steps=0", "checkpoint_steps=64", "updates_per_step=0.1",
)  # fmt: skip
SETTINGS = [word for one in (*TINY, "end_gyro=5") for word in ("--set", one)]
LIMIT = 20_000  # above a policy's weights, below a checkpoint and a picture


@pytest.fixture
def refused(no_file_above, capsys):
    """Run without room: the one line it ends with."""

    def run(words, size=LIMIT):
        with no_file_above(size):
            assert main(words) == 1
        last = capsys.readouterr().err.rstrip("\n").rpartition("\n")[2]
        assert last.startswith("frasa-rl: cannot write ")
        assert "raise the limit, or write elsewhere" in last
        return last

    return run


def test_a_run_goes_on_when_there_is_room(robot_model_dir, tmp_path, refused, contents):
    """Without room for the first checkpoint nothing begins; later the older checkpoint and policy stay."""
    run, model = tmp_path / "run", str(robot_model_dir / "nominal.xml")
    words = ["train", "--model", model, "--device", "cpu", *SETTINGS, "--steps", "64", "--no-report", "--out", str(run)]
    last = refused(words)
    assert "checkpoints/000000000" in last
    assert last.endswith("no step was saved yet")
    assert not (run / "run.yaml").exists()
    assert main(words) == 0
    before = contents(run)
    on = ["train", "--resume", str(run), "--steps", "128", "--no-report"]
    last = refused(on)
    assert "checkpoints/000000128" in last
    assert last.endswith(f"then go on with --resume {run}")
    after = contents(run)
    kept = [name for name in before if name.startswith(("policy/", "checkpoints/"))]
    assert {name: after[name] for name in kept} == {name: before[name] for name in kept}
    assert Policy.load(run).run["trained"]["steps"] == 64
    assert not [name for name in after if "partial" in name or Path(name).name.startswith(".")]
    assert main(on) == 0
    assert Policy.load(run).run["trained"]["steps"] == 128

    before = contents(run)
    assert "policy/weights" in refused(["export", str(run), "--model", model, "--out", str(run / "policy")], 4_000)
    assert contents(run) == before
    short = ["evaluate", str(run), "--model", model, "--protocol", "standup", "--trials", "1", "--no-report"]
    out = tmp_path / "evaluation"
    assert "evaluation.png" in refused([*short, "--out", str(out)])
    assert sorted(contents(out)) == ["evaluation.json", "evaluation.txt"]

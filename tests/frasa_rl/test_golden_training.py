"""A short training with known numbers: twice in a row the same bytes; and what every file of a run carries."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.cli import main
from frasa_rl.plan import Plan
from frasa_rl.policy import Policy
from frasa_rl.settings import Settings
from frasa_rl.train import train
from frasa_sysid.calibration import load_model, model_sha256, sha256_of_file

GOLDEN = Path(__file__).parent / "golden_training.json"
# Another processor rounds otherwise, and contacts make much of little: a share of a norm, and a return.
OF_NORM, OF_RETURN = 0.1, 0.5
TINY = Settings(
    envs=8,
    rollout_steps=16,
    updates_per_step=0.25,
    learning_starts=64,
    batch=16,
    buffer=480,
    actor=(16,),
    critic=(16, 16),
    renorm_warmup=10,
    checkpoint_steps=128,
    evaluate_steps=400,
    evaluate_falls=1,
    evaluate_physics="fast",
    physics="fast",
    end_gyro=5.0,
    pool=8,
    seed=11,
)
TRAINED = {"frasa", "mujoco", "numpy", "numba", "torch", "stable-baselines3", "python"}
POLICY = ("weights.safetensors", "policy.onnx", "deploy.json")
LEAST = {"frasa", "mujoco", "numpy", "python"}


def without_times(path):
    with path.open(newline="") as file:
        times = ("minutes", "steps_per_s", "updates_per_s")
        return [{name: one for name, one in row.items() if name not in times} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def two(robot_model_dir, tmp_path_factory):
    """Two runs in a row, and what the second came to."""
    folder = tmp_path_factory.mktemp("golden")
    plan = Plan(robot_model_dir / "nominal.xml", folder / "one" / "run", TINY, steps=448, device="cpu")
    train(plan)
    other = replace(plan, out=folder / "two" / "run")
    return plan.out, other.out, train(other)


def summary(run, result):
    """A few numbers that say what a run came to."""
    return {
        "steps": result["steps"],
        "updates": result["updates"],
        "return": result["return_last"],
        "success": [result["held_out"][name] for name in ("success_prone", "success_supine")],
        "norms": [[float(np.linalg.norm(one)) for one in layer] for layer in Policy.load(run).layers],
    }


def test_golden_training(two):
    """The same policy, byte by byte, and the same tables; the golden numbers within what another machine may do."""
    one, other, result = two
    for name in (
        "policy/weights.safetensors",
        "policy/policy.onnx",
        "policy/deploy.json",
        "latest/weights.safetensors",
    ):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    for name in ("progress.csv", "evaluations.csv"):
        assert without_times(one / name) == without_times(other / name)
        assert without_times(one / name)
    golden, found = json.loads(GOLDEN.read_text()), summary(other, result)
    for name in ("steps", "updates", "success"):
        assert found[name] == golden[name], name
    assert found["return"] == pytest.approx(golden["return"], abs=OF_RETURN)
    for mine, theirs in zip(found["norms"], golden["norms"], strict=True):
        assert mine == pytest.approx(theirs, rel=OF_NORM)


def test_every_output_says_what_it_is_from(two, robot_model_dir, tmp_path, monkeypatch):
    """Versions, seed and hashes of inputs in a run's, an export's and an evaluation's files, and in a sweep's."""
    _, run, _ = two
    nominal = robot_model_dir / "nominal.xml"
    model = model_sha256(load_model(nominal))
    for name in ("run.yaml", "policy/run.yaml", "latest/run.yaml"):
        said = yaml.safe_load((run / name).read_text())
        assert set(said["versions"]) >= TRAINED, name
        assert said["seeds"]["training"] == said["settings"]["seed"] == 11
        assert said["model_sha256"] == model
        if name != "run.yaml":
            assert said["weights_sha256"] == sha256_of_file((run / name).with_name("weights.safetensors"))
    words = ["--model", str(nominal), "--out"]
    assert main(["export", str(run), *words, str(tmp_path / "export")]) == 0
    for folder in (run / "policy", tmp_path / "export"):
        deploy = json.loads((folder / "deploy.json").read_text())
        assert set(deploy["trained"]["versions"]) >= TRAINED
        assert (deploy["trained"]["seed"], deploy["trained"]["model_sha256"]) == (11, model)
        assert deploy["weights_sha256"] == sha256_of_file(folder / "weights.safetensors")
        assert deploy["frasa_version"] == deploy["trained"]["versions"]["frasa"]
    short = ["--protocol", "standup", "--trials", "1", "--no-report"]
    assert main(["evaluate", str(run), *short, *words, str(tmp_path / "evaluation")]) == 0
    measured = json.loads((tmp_path / "evaluation" / "evaluation.json").read_text())
    assert set(measured["versions"]) >= LEAST
    assert measured["seed"] == 10_000
    assert measured["inputs"] == {"model": model, str(run): sha256_of_file(run / "policy" / "weights.safetensors")}

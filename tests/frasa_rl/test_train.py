"""A run learns nothing wrong, keeps what it has, and ends when it should."""

import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.checkpoint import CheckpointError, load_checkpoint
from frasa_rl.curriculum import Shares
from frasa_rl.held_out import SEED, HeldOut, Result
from frasa_rl.loop import LearnerError
from frasa_rl.plan import Plan, describe, mark_of, plan_of
from frasa_rl.policy import Policy
from frasa_rl.settings import PRESETS, Settings
from frasa_rl.tables import EVALUATIONS, PROGRESS
from frasa_rl.train import make_loop, train
from frasa_sysid.calibration import CalibrationError, InputError, InterruptedRunError, UsageError

TINY = Settings(
    envs=2,
    rollout_steps=4,
    updates_per_step=0.5,
    learning_starts=40,
    batch=16,
    buffer=2000,
    actor=(16, 16),
    critic=(16, 16),
    renorm_warmup=20,
    checkpoint_steps=100,
    evaluate_falls=1,
    evaluate_physics="fast",
    pool=8,
)
UPDATES = (240 - 40) / 2  # half an update a step in the rounds after the random ones


@pytest.fixture
def plan(nominal, tmp_path):
    return Plan(model=nominal, out=tmp_path / "run", settings=TINY, steps=240, device="cpu")


@pytest.fixture
def trained(plan):
    train(plan)
    return plan


def loaded(plan):
    loop = make_loop(plan)
    kept = {}
    load_checkpoint(plan.out, mark_of(describe(plan)), loop.learner.load, kept.update)
    loop.restore({name.removeprefix("loop."): one for name, one in kept.items()})
    return loop


@pytest.mark.parametrize(("algorithm", "overlap"), [("crossq", True), ("crossq", False), ("sac", True)])
def test_a_run_leaves_everything_behind(plan, algorithm, overlap):
    """A run ends at its budget and leaves settings, policies, tables and checkpoint; nothing half-written."""
    plan = replace(plan, settings=replace(TINY, algorithm=algorithm, overlap=overlap))
    result = train(plan)
    assert (result["stopped"], result["steps"]) == ("steps", 240)
    assert result["updates"] == UPDATES + (0 if overlap else 2)  # without overlap already in the round that reaches 40
    assert result["held_out"]["steps"] == 240
    said = yaml.safe_load((plan.out / "run.yaml").read_text())
    assert said["seeds"] == {"training": 0, "held_out": SEED}
    assert said["settings"]["algorithm"] == algorithm
    assert said["calibration_id"] is None
    assert len(said["model_sha256"]) == 64
    assert {"mujoco", "torch", "numba", "sb3-contrib", "numpy", "frasa", "python"} <= set(said["versions"])
    for folder in (plan.out, plan.out / "latest"):
        assert Policy.load(folder).run["trained"]["steps"] == 240
    assert Policy.load(plan.out).run["trained"]["held_out"]["physics"] == "fast"
    assert [one.name for one in (plan.out / "checkpoints").iterdir()] == ["000000240"]
    assert [row[0] for row in EVALUATIONS.read(plan.out)] == [240]
    assert list((plan.out / "tensorboard").iterdir())


def test_the_published_policy_is_the_mean_of_the_last_updates(plan):
    """Not the newest actor; and a run that is resumed has the same mean."""
    train(plan)
    loop = loaded(plan)
    observations = loop.replay.draw(1, 200).observations[0]
    published = Policy.load(plan.out / "latest").act(observations)
    np.testing.assert_array_equal(loop.policy({}).act(observations), published)
    assert np.abs(loop.learner.actor().policy({}).act(observations) - published).max() > 1e-4
    loop.close()


@pytest.mark.parametrize("algorithm", ["crossq", "sac"])
def test_the_plain_policy_acts_like_the_learner(plan, algorithm):
    """Folding the normalisation into the layers changes no action by more than 1e-5, nor the noise that is added."""
    plan = replace(plan, settings=replace(TINY, algorithm=algorithm, average=0))
    train(plan)
    loop = loaded(plan)
    observations = loop.replay.draw(1, 200).observations[0]
    model = loop.learner.model
    expected, _ = model.predict(observations, deterministic=True)
    assert np.ptp(expected) > 1e-3
    np.testing.assert_allclose(Policy.load(plan.out / "latest").act(observations), expected, atol=1e-5)
    model.policy.set_training_mode(False)
    with torch.no_grad():
        mean, log_std, _ = model.actor.get_action_dist_params(torch.as_tensor(observations))
    noise = np.random.default_rng(0).normal(size=mean.shape)
    drawn = np.tanh(mean.numpy() + np.exp(log_std.numpy()) * noise)
    np.testing.assert_allclose(loop.learner.actor().act(observations, noise), drawn, atol=1e-5)
    loop.close()


def test_a_resumed_run_that_is_done_stays_as_it_is(trained):
    """A budget that is used up is not started again: time and steps count from the run's beginning."""
    before = Policy.load(trained.out).layers
    assert train(plan_of(trained.out), resume=True)["steps"] == 240
    np.testing.assert_array_equal(Policy.load(trained.out).layers[0][0], before[0][0])
    result = train(plan_of(trained.out).until(300, None), resume=True)
    assert (result["steps"], result["updates"]) == (300, UPDATES + 30)
    assert [one.name for one in (trained.out / "checkpoints").iterdir()] == ["000000300"]


def test_the_plan_is_kept_in_the_run(trained):
    """run.yaml holds all that determines a run."""
    assert plan_of(trained.out) == trained


def test_a_changed_model_is_not_resumed(trained, calibrated):
    """A run is not continued on another model."""
    with pytest.raises(CalibrationError, match="not the model this run was started with"):
        train(replace(trained, model=calibrated), resume=True)


def test_another_version_is_told(trained, capsys):
    """Going on with other packages works and says what is different."""
    path = trained.out / "run.yaml"
    path.write_text(path.read_text().replace("  mujoco: ", "  mujoco: 1.2.3, not "))
    train(trained.until(244, None), resume=True)
    assert "resuming with other versions (mujoco 1.2.3" in capsys.readouterr().err


def test_another_device_is_told(trained, capsys):
    """run.yaml says what computed the run, whatever was asked for; where that changes, numbers will."""
    path = trained.out / "run.yaml"
    assert yaml.safe_load(path.read_text())["computed_on"] == "cpu"
    path.write_text(path.read_text().replace("computed_on: cpu", "computed_on: cuda (a GPU)"))
    train(trained.until(244, None), resume=True)
    assert "resuming on another device (cuda (a GPU) -> cpu)" in capsys.readouterr().err
    train(trained.until(248, None), resume=True)
    assert "another device" not in capsys.readouterr().err


@pytest.mark.parametrize("file", ["state.npz", "model.zip"])
@pytest.mark.parametrize("damage", ["missing", "empty", "half", "less", "flipped", "words"])
def test_a_broken_checkpoint_is_named(trained, file, damage):
    """A damaged checkpoint leads to one clear error, whatever the damage."""
    path = next((trained.out / "checkpoints").iterdir()) / file
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        middle = len(content) // 2
        flipped = (
            content[:middle] + bytes(255 - one for one in content[middle : middle + 400]) + content[middle + 400 :]
        )
        texts = {"empty": b"", "half": content[:middle], "less": content[:-30], "flipped": flipped, "words": b"hello"}
        path.write_bytes(texts[damage])
    with pytest.raises(CheckpointError, match="cannot resume from") as raised:
        train(trained.until(300, None), resume=True)
    assert raised.value.exit_code == 3
    assert "\n" not in str(raised.value)


def test_a_foreign_checkpoint_is_refused(trained, nominal, tmp_path):
    """One of another seed looks the same and is none; a missing one is said to be missing."""
    other = replace(trained, out=tmp_path / "other", settings=replace(TINY, seed=1), steps=60)
    train(other)
    for one in (trained.out / "checkpoints").iterdir():
        one.rename(trained.out / "elsewhere")
    with pytest.raises(CheckpointError, match="no checkpoint"):
        train(trained, resume=True)
    next((other.out / "checkpoints").iterdir()).rename(trained.out / "checkpoints" / "000000060")
    with pytest.raises(CheckpointError, match="another model, task, or settings"):
        train(trained, resume=True)


def test_a_run_is_not_overwritten(trained):
    """A second run into the same folder is refused."""
    with pytest.raises(UsageError, match="already holds a run"):
        train(trained)


def test_what_is_no_run_yet_is_begun_anew(plan):
    """A run killed before it had a run.yaml leaves nothing that a new one would take for its own."""
    (plan.out / "checkpoints" / "000000999").mkdir(parents=True)
    train(replace(plan, steps=20))
    assert [one.name for one in (plan.out / "checkpoints").iterdir()] == ["000000020"]


def test_another_curriculum_is_another_run(plan):
    """run.yaml names it, and a run is not continued without it."""
    train(replace(plan, steps=20), curriculum=Shares(1.0, 0.0, 0.0))
    assert yaml.safe_load((plan.out / "run.yaml").read_text())["curriculum"] == "Shares"
    with pytest.raises(CheckpointError, match="another model, task, or settings"):
        train(replace(plan, steps=40), resume=True)
    assert train(replace(plan, steps=40), resume=True, curriculum=Shares(0.0, 1.0, 0.0))["steps"] == 40


def test_a_run_needs_an_end(plan):
    """Without minutes, steps and a success to reach a run would never end."""
    with pytest.raises(UsageError, match="needs an end"):
        train(replace(plan, steps=None))


def test_minutes_end_a_run(plan):
    """A time budget ends a run."""
    result = train(replace(plan, steps=None, minutes=0.02))
    assert result["stopped"] == "minutes"
    assert result["minutes"] < 0.5


def test_success_that_holds_ends_a_run(plan, monkeypatch):
    """The first time it is reached other falls are tried next; only when it holds there too the run is over."""
    shares = iter([(0.0, 0.0), (1.0, 0.9), (1.0, 0.5), (0.9, 1.0), (1.0, 1.0)])
    tried = []

    def run(self, policy, which):
        tried.append(which)
        return Result(*next(shares), time_s=2.0)

    monkeypatch.setattr(HeldOut, "run", run)
    settings = replace(TINY, evaluate_steps=20)
    result = train(replace(plan, steps=None, until_success=0.95, settings=settings))
    assert (result["stopped"], result["steps"]) == ("success", 100)
    assert tried == [0, 0, 1, 0, 1]
    assert result["held_out"] == {"steps": 100, "success_prone": 1.0, "success_supine": 1.0, "time_mean_s": 2.0}
    assert [row[-1] for row in EVALUATIONS.read(plan.out)] == [1, 1, 0, 1, 1]
    again = train(plan_of(plan.out), resume=True)
    assert (again["stopped"], again["steps"]) == ("success", 100)


def test_the_best_policy_is_kept_by_success(plan, monkeypatch):
    """The published policy is the best on held-out falls, whatever came after; the newest is beside it."""
    shares = iter([(0.0, 0.0, np.nan), (0.5, 0.5, 3.0), (0.5, 0.5, 4.0), (0.5, 0.25, 1.0), (0.0, 0.0, np.nan)])
    monkeypatch.setattr(HeldOut, "run", lambda self, policy, which: Result(*next(shares)))
    train(replace(plan, steps=100, settings=replace(TINY, evaluate_steps=20)))
    best, newest = Policy.load(plan.out), Policy.load(plan.out / "latest")
    assert best.run["trained"]["steps"] == 40
    assert best.run["trained"]["held_out"]["prone"] == 0.5
    assert newest.run["trained"]["steps"] == 100
    assert not np.array_equal(best.layers[0][0], newest.layers[0][0])


@pytest.mark.parametrize("overlap", [True, False])
def test_a_learner_that_diverges_ends_the_run_in_a_line(plan, overlap):
    """Its robots are not told numbers that are none; what was saved before stays."""
    loop = make_loop(replace(plan, settings=replace(TINY, overlap=overlap)))
    while loop.learner.updates == 0:
        loop.round()
    with torch.no_grad():
        loop.learner.model.actor.mu.bias.fill_(torch.nan)
    with pytest.raises(LearnerError, match="the learner diverged"):
        loop.round()
    loop.close()


def test_ctrl_c_saves_and_says_so(plan):
    """Ctrl-C ends the run with everything saved, and it can be resumed."""
    plan = replace(plan, steps=100_000)
    threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(InterruptedRunError, match="--resume") as stopped:
        train(plan)
    assert stopped.value.exit_code == 130
    steps = Policy.load(plan.out).run["trained"]["steps"]
    assert train(replace(plan, steps=steps + 40), resume=True)["steps"] >= steps + 40


def test_rows_say_how_it_goes(plan):
    """Return, length, ends and rates against steps and minutes; long runs have longer rows."""
    train(replace(plan, steps=2200, settings=replace(TINY, envs=20, rollout_steps=20, evaluate_steps=0)))
    rows = PROGRESS.read(plan.out)
    assert [row[0] for row in rows] == [1000, 2000, 2200]
    names = dict(zip(PROGRESS.columns, rows[-1], strict=True))
    assert names["return"] > 0.0
    assert 0.0 < names["length"] <= 100.0
    assert names["updates"] == (2200 - 40) / 2
    assert names["steps_per_s"] > names["updates_per_s"] > 0.0


def test_the_paper_preset_is_the_published_recipe():
    """512 updates per 64 transitions one after the other, 100,000 random ones first."""
    steps, updates = PRESETS["paper"].rounds
    assert (steps * PRESETS["paper"].envs, updates) == (64, 512)
    assert PRESETS["paper"].learning_starts == 100_000
    assert not PRESETS["paper"].overlap


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"envs": 0}, "envs is 0"),
        ({"algorithm": "ppo"}, "expected crossq or sac"),
        ({"noise_correlation": 1.0}, "less than 1"),
        ({"evaluate_physics": "slow"}, "evaluate_physics are 'slow'"),
        ({"env_threads": 0}, "env_threads is 0"),
        ({"learning_starts": -1}, "learning_starts is -1"),
        ({"seed": 5_000_000_000}, "seed is 5000000000: expected 0 .. 4294967295"),
        ({"batch": 1}, "batch is 1: expected 2"),
        ({"actor": (64, 0)}, "actor is 0: expected 1"),
        ({"pool": 10**12}, "pool is 1000000000000: expected 1"),
        ({"renorm_warmup": -1}, "renorm_warmup is -1"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"envs": 8, "n_step": 3, "buffer": 23}, "does not hold 3 steps of 8 robots"),
        ({"algorithm": "sac", "weight_norm": True}, "sac does not have weight_norm"),
    ],
)
def test_settings_are_checked(wrong, message):
    """Settings that cannot work are refused by name."""
    with pytest.raises(UsageError, match=message):
        Settings(**wrong)


@pytest.mark.parametrize(
    ("ends", "message"),
    [
        ({"steps": -5}, "--steps is -5: expected 1"),
        ({"steps": 0}, "--steps is 0"),
        ({"minutes": float("nan")}, "--minutes is nan: expected more than 0"),
        ({"minutes": float("inf")}, "--minutes is inf"),
        ({"minutes": 0.0}, "--minutes is 0"),
        ({"until_success": float("nan")}, "--until-success is nan"),
    ],
)
def test_ends_that_never_come_are_refused(plan, ends, message):
    """So are those that are there before a run begins."""
    with pytest.raises(UsageError, match=message):
        replace(plan, **{"steps": None, **ends})


def test_wrong_ends_of_a_run_folder_are_its_fault(trained):
    """What run.yaml says is no mistake on the command line."""
    path = trained.out / "run.yaml"
    path.write_text(path.read_text().replace("\nsteps: 240\n", "\nsteps: -5\n"))
    with pytest.raises(InputError, match="--steps is -5"):
        plan_of(trained.out)

"""A run learns nothing wrong, keeps what it has, and continues where it stopped."""

import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.checkpoint import CheckpointError, load_checkpoint
from frasa_rl.learner import build, plain_policy, snapshot
from frasa_rl.policy import Policy
from frasa_rl.progress import read_progress
from frasa_rl.settings import PRESETS, Settings
from frasa_rl.train import Plan, extended, make_envs, plan_of, train
from frasa_sysid.calibration import CalibrationError, InterruptedRunError, UsageError

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
    pool=8,
)


# Half an update a step from the first round after the random ones (44) to the one that ends the run.
UPDATES = (240 - 44) / 2


@pytest.fixture
def plan(nominal, tmp_path):
    return Plan(model=nominal, out=tmp_path / "run", settings=TINY, steps=240, device="cpu")


@pytest.fixture
def trained(plan):
    train(plan)
    return plan


def learner(plan):
    return build(plan.settings, make_envs(plan), "cpu")


def test_a_run_leaves_everything_behind(plan):
    """A run ends at its budget and leaves settings, policy and checkpoint; nothing half-written."""
    result = train(plan)
    assert result["stopped"] == "steps"
    assert result["steps"] == 240
    assert result["updates"] == UPDATES
    said = yaml.safe_load((plan.out / "run.yaml").read_text())
    assert said["settings"]["seed"] == 0
    assert said["calibration_id"] is None
    assert len(said["model_sha256"]) == 64
    assert Policy.load(plan.out).run["trained"]["steps"] == 240
    assert [one.name for one in (plan.out / "checkpoints").iterdir()] == ["000000240"]
    assert list((plan.out / "tensorboard").iterdir())


@pytest.mark.parametrize("smooth", [True, False])
def test_the_plain_policy_acts_like_the_learner(plan, smooth):
    """Folding the normalisation into the layers changes no action by more than 1e-5."""
    trained = replace(plan, settings=replace(TINY, smooth=smooth))
    train(trained)
    model = learner(trained)
    load_checkpoint(model, trained.out)
    observations = model.replay_buffer.observations[: model.replay_buffer.pos].reshape(-1, 22)
    expected, _ = model.predict(observations, deterministic=True)
    assert np.ptp(expected) > 1e-3
    np.testing.assert_allclose(Policy.load(trained.out).act(observations), expected, atol=1e-5)


def test_a_checkpoint_restores_all_of_the_learner(trained):
    """Weights, optimizers, replay buffer, counters and random states come back as they were saved."""
    one, other = learner(trained), learner(trained)
    assert load_checkpoint(one, trained.out) > 0.0
    load_checkpoint(other, trained.out)
    assert one.num_timesteps == 240
    assert one._n_updates == UPDATES
    assert one.replay_buffer.pos == 119  # SB3 does not keep the transition that ends a run
    buffer = one.replay_buffer
    # The episode in flight ends in a time-out, so that no n-step return reaches into the next one.
    assert ((buffer.dones[118] == 1) | (buffer.timeouts[118] == 1)).all()
    kept = snapshot(one)
    for name, value in snapshot(other).items():
        np.testing.assert_array_equal(kept[name], value, err_msg=name)
    for mine, theirs in zip(one.policy.parameters(), other.policy.parameters(), strict=True):
        assert (mine == theirs).all()
    # SB3 draws from global states: each learner starts from the one saved.
    load_checkpoint(one, trained.out)
    one.set_logger(_silent())
    one.train(3, 16)
    first = plain_policy(one, {})
    load_checkpoint(other, trained.out)
    other.set_logger(_silent())
    other.train(3, 16)
    for (a, _), (b, _) in zip(first.layers, plain_policy(other, {}).layers, strict=True):
        np.testing.assert_array_equal(a, b)


def _silent():
    from stable_baselines3.common.logger import Logger

    return Logger(folder=None, output_formats=[])


def test_a_resumed_run_continues(trained):
    """Resuming goes on from the checkpoint with steps, updates and time, up to a later end."""
    plan = extended(plan_of(trained.out), steps=400, minutes=None)
    result = train(plan, resume=True)
    assert result["steps"] == 400
    assert result["updates"] == UPDATES + (400 - 244) / 2
    minutes = [row[1] for row in read_progress(plan.out / "progress.csv")]
    assert minutes == sorted(minutes)
    assert [one.name for one in (plan.out / "checkpoints").iterdir()] == ["000000400"]


def test_a_resumed_run_that_is_done_stays_as_it_is(trained):
    """A budget that is used up is not started again: time and steps count from the run's beginning."""
    result = train(plan_of(trained.out), resume=True)
    assert result["steps"] <= 240 + TINY.rollout_steps


def test_the_plan_is_kept_in_the_run(trained):
    """run.yaml holds all that determines a run."""
    assert plan_of(trained.out) == trained


def test_a_changed_model_is_not_resumed(trained, calibrated):
    """A run is not continued on another model."""
    with pytest.raises(CalibrationError, match="not the model this run was started with"):
        train(replace(trained, model=calibrated), resume=True)


def test_a_broken_checkpoint_is_named(trained):
    """A damaged or missing checkpoint leads to one clear error."""
    newest = next((trained.out / "checkpoints").iterdir())
    (newest / "state.npz").write_bytes(b"PK\x03\x04broken")
    with pytest.raises(CheckpointError, match="cannot resume from"):
        load_checkpoint(learner(trained), trained.out)
    with pytest.raises(CheckpointError, match="no checkpoint"):
        load_checkpoint(learner(trained), trained.out / "elsewhere")


def test_a_run_is_not_overwritten(trained):
    """A second run into the same folder is refused."""
    with pytest.raises(UsageError, match="already holds a run"):
        train(trained)


def test_a_run_needs_an_end(plan):
    """Without minutes and steps a run would never end."""
    with pytest.raises(UsageError, match="needs an end"):
        train(replace(plan, steps=None))


def test_minutes_end_a_run(plan):
    """A time budget ends a run."""
    result = train(replace(plan, steps=None, minutes=0.02))
    assert result["stopped"] == "minutes"
    assert result["minutes"] < 0.2


def test_ctrl_c_saves_and_says_so(plan):
    """Ctrl-C ends the run with everything saved, and it can be resumed."""
    plan = replace(plan, steps=100_000)
    threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(InterruptedRunError, match="--resume") as stopped:
        train(plan)
    assert stopped.value.exit_code == 130
    steps = Policy.load(plan.out).run["trained"]["steps"]
    assert train(replace(plan, steps=steps + 40), resume=True)["steps"] >= steps + 40


def test_the_paper_preset_is_the_published_recipe():
    """512 updates per 64 transitions, 100,000 random ones first."""
    steps, updates = PRESETS["paper"].rounds
    assert (steps * PRESETS["paper"].envs, updates) == (64, 512)
    assert PRESETS["paper"].learning_starts == 100_000


def test_settings_are_checked():
    """Settings that cannot work are refused by name."""
    with pytest.raises(UsageError, match="envs is 0"):
        Settings(envs=0)

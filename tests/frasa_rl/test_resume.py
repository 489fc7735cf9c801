"""A run that is killed and resumed comes to what an unbroken one comes to, to the last bit."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")

from frasa_rl.checkpoint import CheckpointError
from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Task
from frasa_rl.curriculum import Shares
from frasa_rl.held_out import HeldOut, Result
from frasa_rl.loop import Loop
from frasa_rl.plan import Plan, plan_of
from frasa_rl.policy import Policy
from frasa_rl.settings import Settings
from frasa_rl.tables import EVALUATIONS, PROGRESS
from frasa_rl.train import make_loop, train
from frasa_sysid.calibration import InterruptedRunError

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
    checkpoint_steps=32,
    evaluate_steps=400,
    evaluate_falls=2,
    evaluate_physics="fast",
    noise_correlation=0.8,
    pool=8,
)
STEPS = 1200  # episodes end and begin, the ring goes around, evaluations are made
RUN = """
import json, sys
from dataclasses import replace
from pathlib import Path
from frasa_rl.plan import Plan, plan_of
from frasa_rl.settings import Settings
from frasa_rl.train import train
model, out, settings, steps, resume = json.loads(sys.argv[1])
settings = Settings(**{name: tuple(one) if isinstance(one, list) else one for name, one in settings.items()})
plan = Plan(Path(model), Path(out), settings, steps=steps, device="cpu")
train(plan_of(Path(out)) if resume else plan, resume=resume)
"""


@pytest.fixture(scope="module")
def unbroken(robot_model_dir, tmp_path_factory):
    plan = Plan(
        robot_model_dir / "nominal.xml", tmp_path_factory.mktemp("unbroken") / "run", TINY, steps=STEPS, device="cpu"
    )
    train(plan)
    return plan


def numbers(table, run, times):
    """All rows but the columns of time."""
    kept = [i for i, name in enumerate(table.columns) if name not in times]
    return np.array(table.read(run)).reshape(-1, len(table.columns))[:, kept]


def assert_same_run(one, other):
    """Policies, tables and everything in the checkpoint, but for time."""
    for folder in ("policy", "latest"):
        for mine, theirs in zip(Policy.load(one / folder).layers, Policy.load(other / folder).layers, strict=True):
            for a, b in zip(mine, theirs, strict=True):
                np.testing.assert_array_equal(a, b)
    times = ("minutes", "steps_per_s", "updates_per_s")
    for table in (PROGRESS, EVALUATIONS):
        np.testing.assert_array_equal(numbers(table, one, times), numbers(table, other, times))
    (mine,), (theirs,) = (list((run / "checkpoints").iterdir()) for run in (one, other))
    with np.load(mine / "state.npz") as a, np.load(theirs / "state.npz") as b:
        assert set(a.files) == set(b.files)
        for name in a.files:
            if name not in ("progress.rows", "progress.elapsed_s", "evaluations.rows", "published.trained"):
                np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def start(plan, *, resume):
    told = json.dumps([str(plan.model), str(plan.out), asdict(plan.settings), plan.steps, resume])
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen([sys.executable, "-c", RUN, told], env=environment, stderr=subprocess.PIPE, text=True)


def reached(out, steps):
    """Whether a checkpoint of so many steps is there, or being written."""
    names = [one.name for one in (out / "checkpoints").glob("*")] if (out / "checkpoints").is_dir() else []
    return any(name[:1].isdigit() and int(name[:9]) >= steps for name in names)


def kill_when(process, ready):
    """kill -9 as soon as something is true; False when the run was over before."""
    until = time.monotonic() + 120.0
    while process.poll() is None and not ready():
        assert time.monotonic() < until, "the run hangs"
        time.sleep(0.0005)
    alive = process.poll() is None
    process.kill()
    process.communicate()
    assert not alive or process.returncode == -signal.SIGKILL
    return alive


def test_killed_runs_come_to_the_same(unbroken, tmp_path):
    """kill -9 soon after the start, between two checkpoints, and while one is written, again and again."""
    plan = replace(unbroken, out=tmp_path / "run")
    out = plan.out
    kill_when(start(plan, resume=False), lambda: (out / "run.yaml").exists())
    partial = out / "checkpoints" / "partial"
    assert kill_when(start(plan, resume=True), lambda: reached(out, 320) and (partial / "state.npz").exists())
    kill_when(start(plan, resume=True), lambda: reached(out, 640) and partial.exists())
    last = start(plan, resume=True)
    _, said = last.communicate(timeout=120)
    assert last.returncode == 0, said
    assert_same_run(unbroken.out, out)


@pytest.mark.parametrize("steps", [32, 64, 416, 800])
def test_a_run_resumed_at_any_step_comes_to_the_same(unbroken, tmp_path, steps):
    """Before learning, as it begins, and after the ring has gone around."""
    plan = replace(unbroken, out=tmp_path / "run", settings=replace(TINY, evaluate_steps=0))
    whole = replace(plan, out=tmp_path / "whole")
    train(whole.until(832, None))
    train(plan.until(steps, None))
    train(plan_of(plan.out).until(832, None), resume=True)
    a, b = (Policy.load(one.out / "latest") for one in (whole, plan))
    np.testing.assert_array_equal(a.layers[0][0], b.layers[0][0])


def test_a_run_that_goes_on_from_an_end_comes_to_the_same(unbroken, tmp_path):
    """The evaluation made as it ended is dropped: unbroken it would not have been."""
    plan = replace(unbroken, out=tmp_path / "run")
    train(plan.until(608, None))
    assert [row[0] for row in EVALUATIONS.read(plan.out)] == [400, 608]
    train(plan_of(plan.out), resume=True)  # it is over: all stays
    assert [row[0] for row in EVALUATIONS.read(plan.out)] == [400, 608]
    train(plan_of(plan.out).until(STEPS, None), resume=True)
    assert_same_run(unbroken.out, plan.out)


def test_what_was_chosen_at_an_end_gives_way(unbroken, tmp_path, monkeypatch):
    """It stays published until the next evaluation, also over an interruption; then an unbroken run's best is there."""
    shares = iter([0.5, 1.0, 0.25])  # at 400, as the run ends at 608, at 800
    monkeypatch.setattr(HeldOut, "run", lambda self, policy, which: Result(*2 * [next(shares)], time_s=2.0))
    plan = replace(unbroken, out=tmp_path / "run")

    def published():
        return Policy.load(plan.out).run["trained"]["steps"]

    train(plan.until(400, None))
    best = Policy.load(plan.out).layers
    assert published() == 400
    train(plan.until(608, None), resume=True)
    assert published() == 608
    rounds, gathered = iter([0, 1]), Loop.round

    def until_ctrl_c(loop):
        if next(rounds, None) == 1:
            signal.raise_signal(signal.SIGINT)
        return gathered(loop)

    with monkeypatch.context() as once:
        once.setattr(Loop, "round", until_ctrl_c)
        with pytest.raises(InterruptedRunError):
            train(plan.until(800, None), resume=True)
    assert published() == 608
    assert [row[0] for row in EVALUATIONS.read(plan.out)] == [400]
    train(plan.until(800, None), resume=True)
    assert [row[0] for row in EVALUATIONS.read(plan.out)] == [400, 800]
    assert published() == 400
    np.testing.assert_array_equal(Policy.load(plan.out).layers[0][0], best[0][0])


@pytest.mark.parametrize("changes", [{"algorithm": "sac"}, {"overlap": False}, {"env_threads": 2}])
def test_other_settings_resume_too(unbroken, tmp_path, changes):
    """SAC, and rounds one after the other; threads change nothing."""
    plan = replace(unbroken, out=tmp_path / "run", settings=replace(TINY, **changes), steps=480)
    whole = replace(plan, out=tmp_path / "whole", settings=replace(plan.settings, env_threads=1))
    train(whole)
    train(plan.until(240, None))
    train(plan_of(plan.out).until(480, None), resume=True)
    a, b = (Policy.load(one.out / "latest") for one in (whole, plan))
    np.testing.assert_array_equal(a.layers[0][0], b.layers[0][0])


def test_norms_are_those_of_the_first_weights(unbroken, tmp_path):
    """Not of those a checkpoint has, others by rounding; one without norms is resumed as well as it can be."""
    plan = replace(unbroken, out=tmp_path / "run", settings=replace(TINY, weight_norm=True, evaluate_steps=0))
    whole = replace(plan, out=tmp_path / "whole")
    train(whole.until(480, None))
    for steps in (32, 240, 480):  # before there are norms, and after
        train(plan.until(steps, None), resume=steps > 32)
    assert_same_run(whole.out, plan.out)
    (checkpoint,) = (plan.out / "checkpoints").iterdir()
    with np.load(checkpoint / "state.npz") as file:
        state = dict(file)
    norms = state["learner.norms.critic"]
    assert norms.shape == (2, 2)
    np.savez(checkpoint / "state.npz", **{**state, "learner.norms.critic": 2.0 * norms})
    with pytest.raises(CheckpointError, match="norms of the critic's weights"):
        train(plan.until(512, None), resume=True)
    np.savez(checkpoint / "state.npz", **{name: one for name, one in state.items() if ".norms." not in name})
    assert train(plan.until(512, None), resume=True)["steps"] == 512


class Widening(Shares):
    """Starts lying after some steps; pays the height of the pitch."""

    def __init__(self):
        super().__init__(1.0, 0.0, 0.0)

    def reward(self, core, before, out):
        return np.cos(core.batch.now.pitch) - np.cos(before.pitch)

    def note(self, steps, success):
        if steps >= 200:
            self.shares[:] = (0.2, 0.4, 0.4)


@pytest.mark.parametrize("task", [Task(), compat_task(Task())], ids=["ours", "frasa2024"])
def test_all_of_the_robots_is_restored(nominal, tmp_path, task):
    """Robots, curriculum, rewards and chance of a restored collector go on as those it was taken from."""
    settings = replace(TINY, pool=12, near_target_share=0.3, falling_share=0.3)
    plan = Plan(nominal, tmp_path, settings, steps=10, device="cpu", task=replace(task, episode_s=1.0))
    one, other = make_loop(plan, Widening()), make_loop(plan, Widening())
    for _ in range(14):
        one.round()
    kept = {name: value.copy() for name, value in one.snapshot().items()}
    assert kept["collector.episodes.curriculum.shares"][1] == 0.4
    one.learner.model.save(tmp_path / "model.zip")
    other.learner.load(tmp_path / "model.zip")
    other.restore(kept)
    before = one.collector.collect(None, 50)
    after = other.collector.collect(None, 50)
    for name, value in vars(before.transitions).items():
        np.testing.assert_array_equal(getattr(after.transitions, name), value, err_msg=name)
    np.testing.assert_array_equal(before.returned, after.returned)
    assert before.lasted.size > 8
    assert before.transitions.lasts.sum() == before.lasted.size
    for each in (one, other):
        each.close()

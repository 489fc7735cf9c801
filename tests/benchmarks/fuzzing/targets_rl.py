"""The readers of training: tasks, keyframes, policies, what a robot runs, runs that are resumed, SB3 files, sweeps."""

import io
import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from fuzzing.case import Case, case_in, single
from fuzzing.targets import Read, Target
from fuzzing.targets_sysid import MODELS

POLICY = MODELS / "policies" / "standup"


def _task() -> Read:
    from frasa_rl.task_file import load_task

    def read(path: Path) -> int:
        load_task(path)
        return 0

    return read


def _keyframes() -> Read:
    from frasa_rl.keyframe_file import load_keyframes

    def read(path: Path) -> int:
        load_keyframes(path)
        return 0

    return read


def _policy() -> Read:
    """As `evaluate` and `train --resume` take it: weights, run.yaml, its task and its plan."""
    from frasa_rl.commands.task_option import task_of_run
    from frasa_rl.evaluate import check_policy
    from frasa_rl.plan import plan_of
    from frasa_rl.policy import Policy
    from frasa_sysid.calibration import CalibrationError

    def read(path: Path) -> int:
        plan_of(path)
        policy = Policy.load(path)
        task = task_of_run(policy.run)
        with suppress(CalibrationError):
            check_policy(policy, task, None)
        policy.act(np.zeros(policy.layers[0][0].shape[1]))
        return 0

    return read


def _runtime() -> Read:
    """On the robot: numpy and nothing else, so that its error is not of the family."""
    from frasa_rl.runtime import DeployError, Runtime
    from frasa_sysid.calibration import InputError

    def read(path: Path) -> int:
        try:
            robot = Runtime.load(path)
        except DeployError as error:
            raise InputError(str(error)) from None
        still = np.zeros((len(robot.joints), 2))
        robot.start(still)
        if not np.isfinite(robot.step(still, still, 0.0, 0.0)).all():
            raise ValueError("a command is not finite")
        return 0

    return read


def _sb3() -> Read:
    from frasa_rl.foreign import read_sb3
    from frasa_rl.policy import Policy

    def read(path: Path) -> int:
        Policy(read_sb3(path, trust=True))
        return 0

    return read


def _sweep() -> Read:
    from frasa_rl.sweep_files import read_sweep

    def read(path: Path) -> int:
        read_sweep(path)
        return 0

    return read


def _tables() -> Read:
    """The tables of a run folder, as pages and watchers read them."""
    from frasa_rl.tables import EVALUATIONS, PROGRESS

    def read(path: Path) -> int:
        EVALUATIONS.read(path), PROGRESS.read(path)
        return 0

    return read


def _settings():  # type: ignore[no-untyped-def]
    from frasa_rl.settings import Settings

    return Settings(
        envs=4, rollout_steps=8, updates_per_step=0.25, learning_starts=16, batch=16, buffer=64, actor=(16,),
        critic=(16, 16), renorm_warmup=10, checkpoint_steps=32, evaluate_steps=0, pool=4,
    )  # fmt: skip


@cache
def _run() -> Path:
    """A run of some steps, made once."""
    from frasa_rl.plan import Plan
    from frasa_rl.train import train

    folder = Path(os.environ.setdefault("FRASA_FUZZ_RUN", tempfile.mkdtemp(prefix="frasa-fuzz-run-")))
    os.environ.setdefault("FRASA_CACHE", str(folder / "cache"))
    if not (folder / "run" / "run.yaml").is_file():
        train(Plan(MODELS / "nominal.xml", folder / "run", _settings(), steps=64, device="cpu"))
    return folder / "run"


def _checkpoint() -> Read:
    """What `train --resume` reads, put into one learner and its robots again and again."""
    from frasa_rl.checkpoint import load_checkpoint
    from frasa_rl.plan import describe, plan_of
    from frasa_rl.train import make_loop
    from frasa_rl.training_run import Run

    out = _run()
    plan = plan_of(out)
    kept = Run(plan, describe(plan), make_loop(plan))

    def read(path: Path) -> int:
        load_checkpoint(path, kept._mark, kept._loop.learner.load, kept._restore)
        return 0

    return read


def _checkpoints() -> list[Case]:
    out = _run()
    whole = case_in(out, "")
    files = {name: one for name, one in whole.files.items() if name.startswith("checkpoints/")}
    return [Case(files, "")]


def _sb3_files() -> list[Case]:
    import gymnasium
    from sb3_contrib import CrossQ
    from stable_baselines3 import SAC

    class Nowhere(gymnasium.Env):  # type: ignore[type-arg]
        observation_space = gymnasium.spaces.Box(-30.0, 30.0, (22,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (5,), np.float32)

    found = []
    for kind in (SAC, CrossQ):
        file = io.BytesIO()
        kind("MlpPolicy", Nowhere(), buffer_size=2, policy_kwargs={"net_arch": [8]}, device="cpu").save(file)
        found.append(single(file.getvalue(), "a.zip", kind.__name__))
    return found


def _policies() -> list[Case]:
    whole = case_in(POLICY, "")
    names = ("run.yaml", "policy/run.yaml", "policy/weights.safetensors")
    return [Case({name: whole.files[name] for name in names}, "")]


def _deployed() -> list[Case]:
    whole = case_in(POLICY / "policy", "")
    return [Case({name: whole.files[name] for name in ("deploy.json", "weights.safetensors")}, "")]


def _sweeps() -> list[Case]:
    import json

    import yaml

    run = yaml.safe_load((POLICY / "run.yaml").read_text())
    said = {"schema": "frasa.sweep/1", "seeds": [0, 1, 2], "run": run}
    return [single(json.dumps(said).encode(), "sweep.json")]


def _sweep_cases() -> list[Case]:
    from frasa_rl.sweep_files import SCHEMA, SWEEP_FILE

    (one,) = _sweeps()
    content = (one.files["sweep.json"] or b"").replace(b"frasa.sweep/1", SCHEMA.encode())
    return [Case({SWEEP_FILE: content}, "")]


def _table_cases() -> list[Case]:
    whole = case_in(POLICY, "")
    lines = {
        name: b"\n".join((whole.files[name] or b"").splitlines()[:8]) for name in ("progress.csv", "evaluations.csv")
    }
    return [Case(lines, "")]


TARGETS: dict[str, Target] = {
    "task (YAML)": Target(
        lambda: [single(one.read_bytes(), "task.yaml") for one in MODELS.glob("**/standup.yaml")], _task
    ),
    "keyframes (YAML)": Target(
        lambda: [single((MODELS / "keyframes.yaml").read_bytes(), "keyframes.yaml")], _keyframes
    ),
    "run and policy": Target(_policies, _policy),
    "deployed policy": Target(_deployed, _runtime),
    "training checkpoint": Target(_checkpoints, _checkpoint),
    "run's tables": Target(_table_cases, _tables, 0.5),
    "sweep": Target(_sweep_cases, _sweep, 0.5),
    "SB3 file": Target(_sb3_files, _sb3),
}

"""A training run: a folder that can be watched, stopped, resumed, and evaluated at any time.

runs/NAME/run.yaml            settings, task, model, calibration id, versions
runs/NAME/progress.csv        return and more against steps and minutes;  learning_curve.png at the end
runs/NAME/policy/             the policy so far, loadable without torch
runs/NAME/checkpoints/        the newest checkpoint;  tensorboard/  the learner's own numbers
"""

import platform
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import sb3_contrib
import stable_baselines3
import torch
import yaml
from sb3_contrib import CrossQ
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from frasa_rl import __version__
from frasa_rl.bars import shown_share
from frasa_rl.checkpoint import load_checkpoint, save_checkpoint
from frasa_rl.config import Task
from frasa_rl.learner import build, plain_policy
from frasa_rl.observation import layout
from frasa_rl.physics import with_physics
from frasa_rl.policy import FOLDER, RUN_FILE, read_run
from frasa_rl.progress import Progress, stop_on_signals
from frasa_rl.settings import Settings
from frasa_rl.task_file import task_from
from frasa_rl.task_text import task_data
from frasa_rl.vec_env import StandUpVecEnv
from frasa_sysid.calibration import (
    CalibrationError,
    InputError,
    InterruptedRunError,
    UsageError,
    calibration_id,
    load_model,
    plain,
    say,
    sha256_of,
    write_atomic,
)

SCHEMA = "frasa.run/1"


@dataclass(frozen=True)
class Plan:
    """What to train, for how long, and where to.

    Attributes:
        model: a model file.
        out: the run folder.
        settings: of the learner.
        steps, minutes: the run ends at whichever comes first; None for no limit.
        device: `auto`, `cpu` or `cuda`.
        task: what is trained; its shares of starts and its physics are those of the settings.
    """

    model: Path
    out: Path
    settings: Settings
    steps: int | None = None
    minutes: float | None = None
    device: str = "auto"
    task: Task = field(default_factory=Task)

    def __post_init__(self) -> None:
        shares = {name: getattr(self.settings, name) for name in ("near_target_share", "falling_share")}
        object.__setattr__(self, "task", with_physics(replace(self.task, **shares), self.settings.physics))


def train(plan: Plan, *, resume: bool = False) -> dict[str, Any]:
    """Run or continue a run until its budget is used up.

    Returns:
        What `frasa-rl train --json` prints.

    Raises:
        InterruptedRunError: stopped by the user; everything so far is saved.
        CalibrationError: the model of a resumed run has changed.
        UsageError: the folder already holds a run, or there is no limit.
    """
    if plan.steps is None and plan.minutes is None:
        raise UsageError("a run needs an end: give --minutes or --steps")
    description = describe(plan)
    if resume:
        _check_same_model(description, read_run(plan.out / RUN_FILE))
    elif (plan.out / RUN_FILE).exists():
        raise UsageError(f"{plan.out} already holds a run: choose another --out, or --resume {plan.out}")
    envs = make_envs(plan)
    try:
        model = build(plan.settings, envs, plan.device)
        elapsed_s = load_checkpoint(model, plan.out) if resume else 0.0
        write_atomic(plan.out / RUN_FILE, yaml.safe_dump(description, sort_keys=False))
        return _learn(model, plan, description, elapsed_s)
    finally:
        envs.close()


def describe(plan: Plan) -> dict[str, Any]:
    """What run.yaml says: all that determines the run, in plain data."""
    model, task = load_model(plan.model), plan.task
    versions = {
        "frasa": __version__,
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "gymnasium": gymnasium.__version__,
        "stable-baselines3": stable_baselines3.__version__,
        "sb3-contrib": sb3_contrib.__version__,
        "torch": str(torch.__version__),
    }
    said: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "model": plan.model,
            "model_sha256": model_hash(model),
            "calibration_id": calibration_id(model),
            "steps": plan.steps,
            "minutes": plan.minutes,
            "device": plan.device,
            "settings": asdict(plan.settings),
            "observation": [{"name": one.name, "size": one.size, "unit": one.unit} for one in layout(task)],
            "task": task_data(task),
            "versions": versions,
        }
    )
    return said


def plan_of(run: Path) -> Plan:
    """The plan that a run folder was started with.

    Raises:
        PolicyError: no run.yaml there.
        InputError: one that this version cannot read.
    """
    said = read_run(run / RUN_FILE)
    try:
        if said["schema"] != SCHEMA:
            raise ValueError(f"schema '{said['schema']}', expected '{SCHEMA}'")
        settings: dict[str, Any] = {
            name: tuple(one) if isinstance(one, list) else one for name, one in said["settings"].items()
        }
        return Plan(
            model=Path(said["model"]),
            out=run,
            settings=Settings(**settings),
            steps=said["steps"],
            minutes=said["minutes"],
            device=said["device"],
            task=task_from(said["task"], str(run / RUN_FILE)),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{run / RUN_FILE}: missing or wrong field: {error!r}") from error


def model_hash(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model, so that every included file counts."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return sha256_of(content.tobytes())


def make_envs(plan: Plan) -> VecEnv:
    """The environments of a run, each with its own model."""
    settings = plan.settings
    with shown_share(f"settling {settings.pool} starts") as tell:
        envs = StandUpVecEnv(
            plan.model,
            plan.task,
            settings.envs,
            pool=settings.pool,
            seed=settings.seed,
            tell=tell,
        )
    return VecMonitor(envs)


def _learn(model: CrossQ, plan: Plan, description: dict[str, Any], elapsed_s: float) -> dict[str, Any]:
    def keep(now_s: float) -> None:
        save_checkpoint(model, plan.out, now_s)
        trained = {"trained": {"steps": model.num_timesteps, "minutes": now_s / 60.0}}
        plain_policy(model, {**description, **trained}).save(plan.out / FOLDER)

    progress = Progress(plan.out, plan.steps, plan.minutes, elapsed_s, plan.settings.checkpoint_steps, keep)
    model.set_logger(configure(str(plan.out / "tensorboard"), ["tensorboard"]))
    say(f"training in {plan.out} on {model.device.type}, model {plan.model}")
    with stop_on_signals(progress):
        model.learn(10**9, callback=progress, log_interval=20, reset_num_timesteps=False)
        keep(progress.elapsed_s)
    progress.add_row()
    progress.show()
    with suppress(ModuleNotFoundError):  # the curve is drawn where matplotlib is installed
        from frasa_rl.curve import draw_curve

        draw_curve(plan.out)
    if progress.stopped == "interrupted":
        raise InterruptedRunError(f"interrupted; saved in {plan.out}, continue with --resume {plan.out}")
    return _result(plan, model, progress)


def _result(plan: Plan, model: CrossQ, progress: Progress) -> dict[str, Any]:
    returns = [row[2] for row in progress.rows if np.isfinite(row[2])]
    return {
        "schema": "frasa.train/1",
        "run": plan.out,
        "policy": plan.out / FOLDER,
        "steps": model.num_timesteps,
        "updates": model._n_updates,
        "minutes": progress.elapsed_s / 60.0,
        "return_first": returns[0] if returns else None,
        "return_last": returns[-1] if returns else None,
        "return_best": max(returns, default=None),
        "stopped": progress.stopped,
    }


def _check_same_model(now: dict[str, Any], then: dict[str, Any]) -> None:
    if now["model_sha256"] != then.get("model_sha256"):
        raise CalibrationError(
            f"{now['model']} (calibration {now['calibration_id']}) is not the model this run was started with "
            f"(calibration {then.get('calibration_id')}): start a new run"
        )


def extended(plan: Plan, steps: int | None, minutes: float | None) -> Plan:
    """The same plan with another end, where one is given."""
    return plan if steps is None and minutes is None else replace(plan, steps=steps, minutes=minutes)

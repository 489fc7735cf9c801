"""A training run: a folder that can be watched, stopped, killed, resumed, and evaluated at any time.

runs/NAME/run.yaml            settings, task, model, calibration id, seeds, versions
runs/NAME/progress.csv        return and more against steps and minutes;  learning_curve.png at the end
runs/NAME/evaluations.csv     success on held-out falls
runs/NAME/report.html         a page of it all, by `frasa-rl train`
runs/NAME/policy/             the best policy so far on held-out falls, loadable without torch
runs/NAME/latest/             the newest one
runs/NAME/checkpoints/        the newest checkpoint: all that the run needs to go on as if it had never stopped
runs/NAME/tensorboard/        everything as curves
"""

import random
import threading
from pathlib import Path
from typing import Any

from frasa_rl.bars import shown_share
from frasa_rl.collector import Collector
from frasa_rl.curriculum import Curriculum
from frasa_rl.episodes import make_episodes
from frasa_rl.learner import build, computes_on
from frasa_rl.loop import Loop
from frasa_rl.observation import bounds
from frasa_rl.plan import Plan, describe
from frasa_rl.policy import RUN_FILE, read_run
from frasa_rl.replay import Replay
from frasa_rl.training_run import Run
from frasa_sysid.calibration import (
    CalibrationError,
    OutputError,
    UsageError,
    alone,
    cannot_write,
    say,
)


def train(plan: Plan, *, resume: bool = False, curriculum: Curriculum | None = None) -> dict[str, Any]:
    """Run or continue a run until it is over.

    Args:
        plan: what, how long, where.
        resume: continue the run in `plan.out`.
        curriculum: what changes while the run learns; None for nothing.

    Returns:
        What `frasa-rl train --json` prints.

    Raises:
        InterruptedRunError: stopped by the user; everything so far is saved.
        CalibrationError: the model of a resumed run has changed.
        UsageError: the folder already holds a run, or there is no end.
        CheckpointError: there is nothing to resume from.
        BusyError: another process is training in that folder.
        OutputError: something cannot be written; what was saved before is there to resume from.
    """
    plan.check_ends()
    with alone(plan.out, folder=True):
        return _train_alone(plan, resume, curriculum)


def _train_alone(plan: Plan, resume: bool, curriculum: Curriculum | None) -> dict[str, Any]:
    """With nobody else writing the same run folder."""
    description = describe(plan, type(curriculum or Curriculum()).__name__)
    description["computed_on"] = computes_on(plan.device)
    if resume:
        _check_same(description, read_run(plan.out / RUN_FILE))
    elif (plan.out / RUN_FILE).exists():
        raise UsageError(f"{plan.out} already holds a run: choose another --out, or --resume {plan.out}")
    loop = make_loop(plan, curriculum)
    threading.excepthook = _unless_told
    try:
        run = Run(plan, description, loop)
        try:
            return run.go(resume=resume)
        finally:
            run.close()
    except OutputError as error:
        raise OutputError(f"{error}; {_advice(plan.out)}") from error
    except OSError as error:  # TensorBoard's files, which know no names in their errors
        where = Path(error.filename) if isinstance(error.filename, str) else plan.out
        raise OutputError(f"{cannot_write(where, error)}; {_advice(plan.out)}") from error
    finally:
        loop.close()


def _advice(out: Path) -> str:
    return f"then go on with --resume {out}" if (out / RUN_FILE).exists() else "no step was saved yet"


def _unless_told(error: threading.ExceptHookArgs) -> None:
    """TensorBoard's thread tells the run what it cannot write, and that ends the run: no traceback beside that."""
    if not (issubclass(error.exc_type, OSError) and type(error.thread).__module__.startswith("tensorboard")):
        threading.__excepthook__(error)


def make_loop(plan: Plan, curriculum: Curriculum | None = None) -> Loop:
    """A run's learner, robots and replay before the first step."""
    settings, task = plan.settings, plan.task
    random.seed(settings.seed)  # frasa2024's starts are drawn from it
    with shown_share(f"settling {settings.pool} starts") as tell:
        episodes = make_episodes(
            plan.model,
            task,
            settings.envs,
            pool=settings.pool,
            seed=settings.seed,
            threads=settings.physics_threads,
            tell=tell,
            curriculum=curriculum,
        )
    bound, joints = bounds(task), len(task.joints)
    learner = build(settings, bound, joints, plan.device)
    replay = Replay(
        settings.buffer,
        settings.envs,
        bound.size,
        joints,
        n_step=settings.n_step,
        discount=settings.discount,
        seed=settings.seed,
    )
    return Loop(settings, learner, Collector(episodes, settings.noise_correlation, settings.seed), replay)


def _check_same(now: dict[str, Any], then: dict[str, Any]) -> None:
    """A run is not continued on another model; on another device or with other versions it is, but it says so."""
    if now["model_sha256"] != then.get("model_sha256"):
        raise CalibrationError(
            f"{now['model']} (calibration {now['calibration_id']}) is not the model this run was started with "
            f"(calibration {then.get('calibration_id')}): start a new run"
        )
    device, before = now["computed_on"], then.get("computed_on")
    if before not in (None, device):
        say(f"resuming on another device ({before} -> {device}): an unbroken run would have come to other numbers")
    versions = then.get("versions") or {}
    changed = [
        f"{name} {versions.get(name)} -> {one}" for name, one in now["versions"].items() if versions.get(name) != one
    ]
    if changed:
        say(f"resuming with other versions ({', '.join(changed)}): an unbroken run would have come to other numbers")

"""Arguments that say how an agent is trained, for `train` and `sweep`."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frasa_rl.commands.task_option import add_task_option
from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Task
from frasa_rl.overrides import override
from frasa_rl.physics import NAMES
from frasa_rl.settings import ALGORITHMS, PRESETS, Settings
from frasa_rl.task_file import load_task
from frasa_rl.task_text import OF_PRESETS
from frasa_sysid.calibration import UsageError, say

if TYPE_CHECKING:
    from frasa_rl.plan import Plan

_SETTINGS = ("algorithm", "seed", "envs", "env_threads", "threads", "physics", "evaluate_steps", "evaluate_falls")
_KEPT = ("task", "compat", "preset", "out", "set", *_SETTINGS)  # in a run folder: it cannot change them


def add_training(parser: argparse.ArgumentParser) -> None:
    """Add model, task, ends and settings."""
    parser.add_argument(
        "--model", type=Path, help="model file (default robot_model/calibrated.xml; resumed: the run's)"
    )
    add_task_option(parser, "the Sigmaban's")
    parser.add_argument("--compat", choices=("frasa2024",), help="train as FRASA's published environment does")
    parser.add_argument("--minutes", type=float, help="end after this many minutes of training")
    parser.add_argument("--steps", type=int, help="end after this many transitions")
    parser.add_argument(
        "--until-success",
        type=float,
        metavar="SHARE",
        help="end when this share of held-out falls ends standing, twice",
    )
    parser.add_argument("--algorithm", choices=ALGORITHMS, help="crossq (default), or SAC to compare with")
    parser.add_argument("--envs", type=int, help="environments stepped together")
    parser.add_argument("--env-threads", type=int, help="threads of the physics (default: one a core)")
    parser.add_argument("--threads", type=int, help="threads of torch (default 1: more stall on shared cores)")
    parser.add_argument("--evaluate-steps", type=int, help="transitions between two evaluations, 0 for none")
    parser.add_argument("--evaluate-falls", type=int, help="held-out falls of each side (default 32)")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), help="default auto: a GPU where there is one")
    parser.add_argument("--physics", choices=NAMES, help="steps of the model file, or 6.25 ms (default: the preset's)")
    parser.add_argument("--preset", choices=sorted(PRESETS), help="quick (default): two cores; paper: FRASA's")
    parser.add_argument(
        "--set",
        action="append",
        metavar="NAME=VALUE",
        help="any other setting, such as batch=256 or critic=256,256; again for more",
    )


def check_resumed(args: argparse.Namespace, *more: str) -> None:
    """Raise UsageError for arguments that what is resumed has already.

    Args:
        args: of a command with `--resume`.
        more: names of arguments, beside those of `add_training`.
    """
    given = [name for name in (*_KEPT, *more) if getattr(args, name, None) is not None]
    if given:
        words = ", ".join("--" + one.replace("_", "-") for one in given)
        raise UsageError(f"--resume takes {words} from the run itself")


def plan_from_arguments(args: argparse.Namespace, out: Path) -> "Plan":
    """The plan that the arguments speak of, to a folder."""
    from frasa_rl.plan import Plan  # sees that all of training is installed

    task, settings = _task_and_settings(args)
    return Plan(
        model=args.model or Path("robot_model/calibrated.xml"),
        out=out,
        settings=settings,
        steps=args.steps,
        minutes=args.minutes,
        until_success=args.until_success,
        device=args.device or "auto",
        task=task,
    )


def _settings(args: argparse.Namespace) -> Settings:
    given = {name: getattr(args, name) for name in _SETTINGS if getattr(args, name, None) is not None}
    return override(replace(PRESETS[args.preset or "quick"], **given), args.set or ())


def _task_and_settings(args: argparse.Namespace) -> tuple[Task, Settings]:
    """Starts and the rewards that lead are the preset's, unless a task file or the published environment has others."""
    settings = _settings(args)
    task = replace(
        Task(),
        near_target_share=settings.near_target_share,
        near_target_push=settings.near_target_push,
        falling_share=settings.falling_share,
        end_gyro=settings.end_gyro,
        reward=settings.reward(Task().reward),
    )
    if args.task is not None:
        task = load_task(args.task, task)
        _tell(args.task, task, settings)
    if args.compat:
        task = compat_task(task)
    own: dict[str, Any] = _of_presets(task)
    return task, replace(settings, **own)


def _of_presets(task: Task) -> dict[str, float]:
    """What a task says of that which presets choose, by the name of the setting."""
    return {name: getattr(task.reward if hasattr(task.reward, name) else task, name) for name in OF_PRESETS}


def _tell(path: Path, task: Task, settings: Settings) -> None:
    """Say what a task file has in place of the preset's: a file with all fields filled in undoes a recipe."""
    own = {name: one for name, one in _of_presets(task).items() if one != getattr(settings, name)}
    if own:
        words = ", ".join(f"{name} {one:g} (preset: {getattr(settings, name):g})" for name, one in own.items())
        say(f"{path} goes before the preset: {words}")

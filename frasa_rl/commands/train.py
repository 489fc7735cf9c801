"""frasa-rl train."""

import argparse
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frasa_rl.commands.task_option import add_task_option
from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Task
from frasa_rl.physics import NAMES
from frasa_rl.settings import ALGORITHMS, PRESETS, Settings
from frasa_rl.task_file import load_task
from frasa_sysid.calibration import UsageError, add_json_flag, say

if TYPE_CHECKING:
    from frasa_rl.plan import Plan

_SETTINGS = ("algorithm", "seed", "envs", "env_threads", "threads", "physics", "evaluate_steps", "evaluate_falls")
Subparsers = Any  # argparse keeps the type of its subparsers private


def add_command(commands: Subparsers) -> None:
    """Add `train` to the command line."""
    parser = commands.add_parser("train", help="train a stand-up policy")
    parser.add_argument("--model", type=Path, help="model file (default robot_model/calibrated.xml)")
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
    parser.add_argument("--seed", type=int, help="seed of everything (default 0)")
    parser.add_argument("--algorithm", choices=ALGORITHMS, help="crossq (default), or SAC to compare with")
    parser.add_argument("--envs", type=int, help="environments stepped together")
    parser.add_argument("--env-threads", type=int, help="threads of the physics (default: the cores that are left)")
    parser.add_argument("--threads", type=int, help="threads of torch (default 1: more stall on shared cores)")
    parser.add_argument("--evaluate-steps", type=int, help="transitions between two evaluations, 0 for none")
    parser.add_argument("--evaluate-falls", type=int, help="held-out falls of each side (default 32)")
    parser.add_argument("--out", type=Path, help="run folder (default runs/standup-<date>-<time>)")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), help="default auto: a GPU where there is one")
    parser.add_argument("--physics", choices=NAMES, help="steps of the model file, or 6.25 ms (default: the preset's)")
    parser.add_argument("--preset", choices=sorted(PRESETS), help="quick (default): two cores; paper: FRASA's")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="continue a run folder as if it had never stopped; ends count from its start",
    )
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    try:
        from frasa_rl.plan import Plan, plan_of
        from frasa_rl.train import train  # torch is imported only where it is needed
    except ModuleNotFoundError as error:
        raise UsageError(f"training needs {error.name}: pip install 'frasa[train]'") from None

    if args.resume:
        given = [
            name for name in ("model", "task", "compat", "preset", "out", *_SETTINGS) if getattr(args, name) is not None
        ]
        if given:
            raise UsageError(
                f"--resume takes {', '.join('--' + one.replace('_', '-') for one in given)} from the run itself"
            )
        plan = plan_of(args.resume).until(args.steps, args.minutes, args.until_success)
        plan = replace(plan, device=args.device or plan.device)
    else:
        task, settings = _task_and_settings(args)
        plan = Plan(
            model=args.model or Path("robot_model/calibrated.xml"),
            out=args.out or Path("runs") / f"standup-{datetime.now():%Y%m%d-%H%M%S}",
            settings=settings,
            steps=args.steps,
            minutes=args.minutes,
            until_success=args.until_success,
            device=args.device or "auto",
            task=task,
        )
    result = train(plan, resume=bool(args.resume))
    _tell(plan, result)
    return result


def _settings(args: argparse.Namespace) -> Settings:
    given = {name: getattr(args, name) for name in _SETTINGS if getattr(args, name) is not None}
    return replace(PRESETS[args.preset or "quick"], **given)


def _task_and_settings(args: argparse.Namespace) -> tuple[Task, Settings]:
    """Starts and the rewards that lead are the preset's, unless a task file or the published environment has others."""
    settings = _settings(args)
    task = replace(
        Task(),
        near_target_share=settings.near_target_share,
        falling_share=settings.falling_share,
        reward=replace(Task().reward, rising=settings.rising, approach=settings.approach),
    )
    if args.task is not None:
        task = load_task(args.task, task)
    if args.compat:
        task = compat_task(task)
    return task, replace(
        settings,
        near_target_share=task.near_target_share,
        falling_share=task.falling_share,
        rising=task.reward.rising,
        approach=task.reward.approach,
    )


def _tell(plan: "Plan", result: dict[str, Any]) -> None:
    best = result["held_out"]
    stands = (
        ""
        if best is None
        else (
            f"; best at {best['steps']:,} steps: {100 * best['success_prone']:.0f} % of held-out falls prone, "
            f"{100 * best['success_supine']:.0f} % supine"
        )
    )
    say(
        f"\n{result['steps']:,} steps, {result['updates']:,} updates, {result['minutes']:.1f} min{stands}; "
        f"policy in {result['policy']}; try: frasa-rl evaluate {plan.out}"
    )

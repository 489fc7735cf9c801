"""frasa-rl train."""

import argparse
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frasa_rl.commands.leave_page import leave_page
from frasa_rl.commands.training import add_training, check_resumed, plan_from_arguments
from frasa_rl.model_path import check_there
from frasa_sysid.calibration import InterruptedRunError, UsageError, add_json_flag, alone, say

if TYPE_CHECKING:
    from frasa_rl.plan import Plan

Subparsers = Any  # argparse keeps the type of its subparsers private
_LEARNED = 0.5  # share of a side's held-out falls that end standing
_LONG_ENOUGH = 150_000  # transitions by which nearly every run of the recipe stands up from both sides (recipe.md)


def add_command(commands: Subparsers) -> None:
    """Add `train` to the command line."""
    parser = commands.add_parser("train", help="train a stand-up policy")
    add_training(parser)
    parser.add_argument("--seed", type=int, help="seed of everything (default 0)")
    parser.add_argument("--out", type=Path, help="run folder (default runs/standup-<date>-<time>)")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="continue a run folder as if it had never stopped; ends count from its start",
    )
    parser.add_argument("--no-report", action="store_true", help="leave out the HTML page in the run folder")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    try:
        from frasa_rl.plan import plan_of
        from frasa_rl.run_page import INTERRUPTED, write_run_page
        from frasa_rl.train import train  # torch is imported only where it is needed
    except ModuleNotFoundError as error:
        raise UsageError(f"training needs {error.name}: pip install 'frasa[train]'") from None

    if args.resume:
        check_resumed(args)
        plan = plan_of(args.resume).until(args.steps, args.minutes, args.until_success)
        plan = replace(plan, device=args.device or plan.device, model=args.model or plan.model)
        if not args.model:
            check_there(plan.model)
    else:
        plan = plan_from_arguments(args, args.out or Path("runs") / f"standup-{datetime.now():%Y%m%d-%H%M%S}")
    with alone(plan.out, folder=True):  # until the page is there, too
        try:
            result = train(plan, resume=bool(args.resume))
        except InterruptedRunError:
            if not args.no_report:
                leave_page(partial(write_run_page, plan.out, INTERRUPTED))
            raise
        _tell(plan, result)
        page = None if args.no_report else leave_page(partial(write_run_page, plan.out, result["stopped"]))
    return {**result, "outputs": {"report": page}}


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
    if best is not None and (advice := advice_after(plan, best, result["steps"])):
        say(advice)


def advice_after(plan: "Plan", best: dict[str, Any], steps: int) -> str:
    """What to do about a side on which nothing stands after a training in which others stand up; or nothing."""
    missing = [side for side in ("prone", "supine") if best[f"success_{side}"] < _LEARNED]
    if not missing or steps < _LONG_ENOUGH:
        return ""
    return (
        f"not learned: to stand up {' and '.join(missing)}. That is at times a matter of chance: another seed "
        f"(--seed {plan.settings.seed + 1}), or several at once (frasa-rl sweep --seeds 4); where none learns it, look "
        f"at frasa-rl play {plan.out} --start {missing[0]} and at the pose, the limits and the rates of the task"
    )

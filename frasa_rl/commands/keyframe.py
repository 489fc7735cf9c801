"""frasa-rl keyframe."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from frasa_rl.commands.evaluate import DEFAULT_MODEL
from frasa_rl.evaluate import evaluation_task
from frasa_rl.keyframe import KEYFRAMES, KeyframeController
from frasa_rl.keyframe_file import load_keyframes, save_keyframes
from frasa_rl.keyframe_trials import run_trials
from frasa_rl.routine import Keyframes, check_limits
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import InterruptedRunError, UsageError, add_json_flag, say

SCHEMA = "frasa.keyframe/1"
TUNED = Path("keyframes.yaml")


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `keyframe` to the command line."""
    parser = commands.add_parser("keyframe", help="stand up by keyframes: success rate and time; or tune them")
    parser.add_argument("--model", type=Path, default=DEFAULT_MODEL, help=f"model file (default {DEFAULT_MODEL})")
    parser.add_argument("--keyframes", type=Path, default=KEYFRAMES, help=f"file of keyframes (default {KEYFRAMES})")
    parser.add_argument("--randomize", action="store_true", help="another robot every trial (default: as in its file)")
    parser.add_argument("--trials", type=int, help="trials from each side (default 20)")
    parser.add_argument(
        "--seed", type=int, help="seed of the first trial (default 10000), or of the tuning (default 0)"
    )
    parser.add_argument("--tune", action="store_true", help="search for better key times and angles from the file on")
    parser.add_argument("--minutes", type=float, help="how long to tune, both sides together (default 20)")
    parser.add_argument("--out", type=Path, help=f"where the best so far is kept while tuning (default {TUNED})")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    wrong = ("trials",) if args.tune else ("minutes", "out")
    given = [f"--{name}" for name in wrong if getattr(args, name) is not None]
    if given:
        raise UsageError(f"{', '.join(given)}: only {'without' if args.tune else 'with'} --tune")
    if (args.trials is not None and args.trials < 1) or (args.seed is not None and args.seed < 0):
        raise UsageError("--trials must be at least 1 and --seed not negative")
    env = StandUp(args.model, evaluation_task(), randomize=args.randomize)
    keyframes = load_keyframes(args.keyframes)
    check_limits(keyframes, np.degrees(env.robot.limits))
    return _tune(args, env, keyframes) if args.tune else _evaluate(args, env, keyframes)


def _evaluate(args: argparse.Namespace, env: StandUp, keyframes: Keyframes) -> dict[str, Any]:
    seed = 10_000 if args.seed is None else args.seed
    standup = run_trials(KeyframeController(keyframes, env.task), env, args.trials or 20, seed)
    for side, one in standup.items():
        time = f", {one['time_mean_s']:.2f} +- {one['time_std_s']:.2f} s" if one["success_rate"] else ""
        say(f"{side:>7}: {100.0 * one['success_rate']:.0f} % of {one['trials']} stand up{time}")
    return {
        "schema": SCHEMA,
        "standup": standup,
        "controller": KeyframeController.name,
        "keyframes": args.keyframes,
        "model": args.model,
        "calibration_id": env.calibration_id,
        "randomize": args.randomize,
        "seed": seed,
        "divergences": env.divergences,
    }


def _tune(args: argparse.Namespace, env: StandUp, keyframes: Keyframes) -> dict[str, Any]:
    from frasa_rl.keyframe_tuner import Progress, Tuning, tune  # the optimiser is imported only where it is needed

    tuning = Tuning()
    tuning = replace(tuning, minutes=args.minutes or tuning.minutes, seed=args.seed or 0)
    out: Path = args.out or TUNED
    last: dict[str, Progress] = {}
    robots = "robots drawn from the ranges" if args.randomize else "the robot as in its file"
    comment = f"Tuned by frasa-rl keyframe --tune from {args.keyframes.name} on {args.model.name}, {robots}.\n"

    def save(best: Keyframes) -> None:
        save_keyframes(best, out, comment)

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    save(keyframes)
    try:
        with Bar(*columns, console=Console(stderr=True)) as bar:
            shown = bar.add_task("trying the start", total=1.0)

            def tell(now: Progress) -> None:
                last[now.side] = now
                text = f"{now.side}: cost {now.cost:.2f}, {100.0 * now.success_rate:.0f} % stand"
                bar.update(shown, completed=now.share, description=text)

            tune(keyframes, env, tuning, save, tell)
    except KeyboardInterrupt:
        raise InterruptedRunError(f"stopped; the best so far is in {out}") from None
    for side, one in last.items():
        say(f"{side:>7}: cost {one.cost:.2f}, {100.0 * one.success_rate:.0f} % of {tuning.checks} checks stand up")
    say(f"{out}; try: frasa-rl keyframe --keyframes {out} --model {args.model}")
    sides = {side: {"cost": one.cost, "success_rate": one.success_rate} for side, one in last.items()}
    return {"schema": "frasa.keyframe-tuning/1", "keyframes": out, "model": args.model, "sides": sides}

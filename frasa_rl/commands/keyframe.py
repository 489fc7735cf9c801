"""frasa-rl keyframe."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from frasa_rl.commands.evaluate import add_protocol, run_protocol
from frasa_rl.commands.task_option import chosen_task
from frasa_rl.evaluate import DEFAULT_MODEL
from frasa_rl.fall_trials import Falls
from frasa_rl.keyframe import KEYFRAMES, load_controller
from frasa_rl.keyframe_file import load_keyframes, save_keyframes
from frasa_rl.protocol import evaluation_task
from frasa_rl.routine import Keyframes
from frasa_sysid.calibration import (
    InterruptedRunError,
    UsageError,
    alone,
    load_model,
    model_sha256,
    say,
    sha256_of_file,
    versions,
)

TUNED = Path("keyframes.yaml")


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `keyframe` to the command line."""
    parser = commands.add_parser("keyframe", help="the paper's tables for stand-up routines by keyframes; or tune them")
    parser.add_argument("--keyframes", type=Path, default=KEYFRAMES, help=f"file of keyframes (default {KEYFRAMES})")
    add_protocol(parser)
    tuning = parser.add_argument_group("tuning")
    tuning.add_argument("--tune", action="store_true", help="search for better key times and angles from the file on")
    tuning.add_argument("--minutes", type=float, help="how long to tune, both sides together (default 20)")
    tuning.add_argument("--best", type=Path, help=f"where the best so far is kept while tuning (default {TUNED})")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    if args.tune:
        with alone(args.best or TUNED):
            return _tune(args)
    given = [f"--{name}" for name in ("minutes", "best") if getattr(args, name) is not None]
    if given:
        raise UsageError(f"{', '.join(given)}: only with --tune")
    return run_protocol(args, str(args.keyframes))


def _tune(args: argparse.Namespace) -> dict[str, Any]:
    from frasa_rl.keyframe_tuner import Progress, Tuning, tune  # the optimiser is imported only where it is needed

    if args.seed < 0:
        raise UsageError("--seed must not be negative")
    model: Path = args.model or DEFAULT_MODEL
    falls = Falls(model, evaluation_task(chosen_task(args)), randomize=args.randomize)
    load_controller(args.keyframes, falls.task, np.degrees(falls.robot.limits))  # says what does not suit the robot
    keyframes = load_keyframes(args.keyframes)
    tuning = Tuning()
    minutes = tuning.minutes if args.minutes is None else args.minutes
    tuning = replace(tuning, minutes=minutes, seed=args.seed)
    out: Path = args.best or TUNED
    last: dict[str, Progress] = {}
    robots = "robots drawn from the ranges" if args.randomize else "the robot as in its file"
    comment = f"Tuned by frasa-rl keyframe --tune from {args.keyframes.name} on {model.name}, {robots}.\n"
    inputs = {args.keyframes.name: sha256_of_file(args.keyframes), model.name: model_sha256(load_model(model))}
    comment += f"Seed {args.seed}; sha256 {json.dumps(inputs)}; versions {json.dumps(versions('cmaes'))}.\n"

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

            tune(keyframes, falls, tuning, save, tell)
    except KeyboardInterrupt:
        raise InterruptedRunError(f"stopped; the best so far is in {out}") from None
    for side, one in last.items():
        say(f"{side:>7}: cost {one.cost:.2f}, {100.0 * one.success_rate:.0f} % of {tuning.checks} checks stand up")
    task = "" if args.task is None else f" --task {args.task}"
    say(f"{out}; try: frasa-rl keyframe --keyframes {out} --model {model}{task}")
    sides = {side: {"cost": one.cost, "success_rate": one.success_rate} for side, one in last.items()}
    return {"schema": "frasa.keyframe-tuning/1", "keyframes": out, "model": model, "sides": sides}

"""frasa-rl evaluate."""

import argparse
import json
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from frasa_rl.bars import shown_share
from frasa_rl.commands.arguments import CONTROLLER_HELP, add_conditions, check_trials, conditions, provenance
from frasa_rl.commands.leave_page import leave_page
from frasa_rl.evaluate import SCHEMA, evaluate
from frasa_rl.evaluation_page import write_evaluation_page
from frasa_rl.protocol_picture import check_picture, draw
from frasa_rl.protocol_tables import tables
from frasa_sysid.calibration import (
    add_json_flag,
    add_report_arguments,
    alone,
    calibration_id,
    load_model,
    plain,
    say,
    write_together,
)

TABLE_FILE, JSON_FILE, PICTURE_FILE = "evaluation.txt", "evaluation.json", "evaluation.png"
PAGE_FILE = "evaluation.html"


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `evaluate` to the command line."""
    parser = commands.add_parser("evaluate", help="the paper's tables: standing up, and pushes by a pendulum")
    parser.add_argument("controller", help=CONTROLLER_HELP)
    add_protocol(parser)
    parser.set_defaults(run=_run)


def add_protocol(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say what is measured, and where it is kept."""
    parser.add_argument("--protocol", choices=("standup", "push", "both"), default="both", help="(default both)")
    add_conditions(parser)
    parser.add_argument("--trials", type=int, default=20, help="stand-up trials from each side (default 20)")
    parser.add_argument("--push-trials", type=int, default=10, help="trials of each push (default 10)")
    parser.add_argument("--randomize", action="store_true", help="draw robot and floor of every trial, as in training")
    parser.add_argument("--picture", type=Path, help="chart to write beside the paper's numbers (png, svg, pdf)")
    files = f"{TABLE_FILE}, {JSON_FILE}, {PICTURE_FILE} and the page"
    parser.add_argument("--out", type=Path, help=f"folder for {files}")
    add_report_arguments(parser, f"{PAGE_FILE}, in --out where that is given")
    add_json_flag(parser)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    return run_protocol(args, args.controller)


def run_protocol(args: argparse.Namespace, word: str) -> dict[str, Any]:
    """Measure the controller that a word names, tell its tables and keep them.

    Raises:
        UsageError: a number of trials below one, or a picture in an unknown format.
    """
    check_trials(args)
    pictures = [one for one in (args.picture, args.out and args.out / PICTURE_FILE) if one]
    for path in pictures:
        check_picture(path)
    with alone(args.out, folder=True) if args.out else nullcontext():
        return _measured(args, word, pictures)


def _measured(args: argparse.Namespace, word: str, pictures: list[Path]) -> dict[str, Any]:
    """The trials and their files, with nobody else writing the same ones."""
    controller, asked = conditions(args, word, args.model, randomize=args.randomize)
    identity = calibration_id(load_model(asked.model))
    with shown_share("trials") as tell:
        done = evaluate(
            controller,
            asked,
            args.trials if args.protocol != "push" else 0,
            args.push_trials if args.protocol != "standup" else 0,
            tell,
        )
    result = {
        "schema": SCHEMA,
        **done.to_dict(),
        "controller": word,
        "model": asked.model,
        "calibration_id": identity,
        "rate_hz": round(1.0 / asked.period_s, 6),
        "randomized": asked.randomize,
        "seed": args.seed,
        **provenance([word], asked.model),
    }
    text = tables(result)
    say(text)
    if args.out:
        said = json.dumps(plain(result), indent=2, allow_nan=False)
        write_together({args.out / TABLE_FILE: text + "\n", args.out / JSON_FILE: said + "\n"})
    for path in pictures:
        draw(result, path)
    page = (
        None if args.no_report else leave_page(partial(write_evaluation_page, _page(args), result, controller, asked))
    )
    return {**result, "outputs": {"report": page}}


def _page(args: argparse.Namespace) -> Path:
    """Where the page goes."""
    named: Path | None = args.report
    return named or (args.out or Path()) / PAGE_FILE

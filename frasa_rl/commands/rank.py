"""frasa-rl rank."""

import argparse
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from frasa_rl.bars import shown_share
from frasa_rl.commands.arguments import CONTROLLER_HELP, add_conditions, check_trials, conditions, provenance
from frasa_rl.evaluate import evaluate
from frasa_rl.instruments import MEASURES
from frasa_rl.rank import CRITERIA, PASS_SHARE, numbers_of, rank, rank_table
from frasa_sysid.calibration import UsageError, add_json_flag, say

SCHEMA = "frasa.rank/1"
_SEED = 20_000  # other trials than those of `evaluate`: what chose a policy must not be what it is praised for


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `rank` to the command line."""
    parser = commands.add_parser("rank", help="which of several policies to take, with the numbers behind it")
    _add_arguments(parser)
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def rank_words(words: list[str]) -> dict[str, Any]:
    """What `frasa-rl rank` with these words comes to; its table is told."""
    parser = argparse.ArgumentParser(prog="frasa-rl rank")
    _add_arguments(parser)
    return _run(parser.parse_args(words))


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("controllers", nargs="+", metavar="CONTROLLER", help=CONTROLLER_HELP)
    add_conditions(parser, _SEED)
    parser.add_argument("--trials", type=int, default=10, help="stand-up trials from each side (default 10)")
    parser.add_argument("--push-trials", type=int, default=5, help="trials of each push (default 5)")


def _part(tell: Callable[[float], None], begin: float) -> Callable[[float], None]:
    """Of one half of the work, in the share of all."""
    return lambda share: tell(begin + 0.5 * share)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    check_trials(args)
    if len(set(args.controllers)) < len(args.controllers):
        raise UsageError("a controller is named twice")
    model = args.model
    chosen = []
    for word in args.controllers:  # all mistakes are said before the first trial
        controller, asked = conditions(args, word, model, randomize=False)
        model = asked.model  # the first one's: all are compared on the same
        drawn = conditions(args, word, model, randomize=True)[1]
        chosen.append((word, controller, asked, drawn))
    numbers = {}
    for word, controller, asked, drawn in chosen:
        with shown_share(word) as tell:
            nominal = evaluate(controller, asked, args.trials, args.push_trials, _part(tell, 0.0))
            random = evaluate(controller, drawn, args.trials, args.push_trials, _part(tell, 0.5))
        numbers[word] = numbers_of(nominal, random)
    places = rank(numbers)
    say(rank_table(places))
    say(f"ranks of each criterion in brackets; versatility: share of sides and pushes with {PASS_SHARE:.0%} success")
    return {
        "schema": SCHEMA,
        "candidates": [asdict(one) for one in places],
        "criteria": CRITERIA,
        "strain": [asdict(one) for one in MEASURES],
        "model": model,
        "rate_hz": round(1.0 / chosen[0][2].period_s, 6),
        "seed": args.seed,
        "trials": args.trials,
        "push_trials": args.push_trials,
        **provenance(args.controllers, chosen[0][2].model),
    }

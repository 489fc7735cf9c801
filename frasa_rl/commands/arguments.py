"""Arguments that the commands about controllers share."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from frasa_rl.commands.task_option import add_task_option, chosen_task
from frasa_rl.config import Task
from frasa_rl.controllers import Controller
from frasa_rl.evaluate import KEYFRAMES, NOTHING, find_controller, is_policy
from frasa_rl.foreign import is_foreign
from frasa_rl.keyframe import KEYFRAMES as KEYFRAMES_FILE
from frasa_rl.physics import own_physics
from frasa_rl.policy import Policy, weights_file
from frasa_rl.protocol import Conditions, evaluation_task
from frasa_sysid.calibration import UsageError, load_model, model_sha256, sha256_of_file, versions

CONTROLLER_HELP = (
    "a run or policy folder, an SB3 file (.zip), 'keyframes', a file of keyframes (.yaml), or 'nothing' "
    "(every command held)"
)
_MOST_TRIALS, _MOST_SEED = 100_000, 2**63 - 1


def add_conditions(parser: argparse.ArgumentParser, seed: int = 10_000) -> None:
    """Add the arguments that say on which model and how, with the seed that trials have by default."""
    parser.add_argument("--model", type=Path, help="model file (default: the one the policy was trained on)")
    parser.add_argument("--allow-other-model", action="store_true", help="run it on another calibration than its own")
    add_trust(parser)
    add_task_option(parser)
    parser.add_argument("--rate", type=float, metavar="HZ", help="decisions a second, 20 or 100 (default: as trained)")
    parser.add_argument("--seed", type=int, default=seed, help=f"of all trials (default {seed})")


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add the argument that lets files from strangers in."""
    parser.add_argument("--trust", action="store_true", help="read an SB3 file (.zip): you know where it is from")


def check_trials(args: argparse.Namespace) -> None:
    """Raise UsageError for numbers of trials that cannot be, or would not end."""
    for name in ("trials", "push_trials"):
        if not 1 <= getattr(args, name) <= _MOST_TRIALS:
            words = f"--{name.replace('_', '-')} is {getattr(args, name)}"
            raise UsageError(f"{words}: expected at least 1, at most {_MOST_TRIALS:,}")


def chosen_task_of(args: argparse.Namespace, word: str) -> Task:
    """The task that the arguments name, else the policy's own; an SB3 file has none."""
    named = is_policy(word) and not is_foreign(word)
    return chosen_task(args, Policy.load(word) if named else None)


def provenance(words: Sequence[str], model: Path) -> dict[str, Any]:
    """What measured controllers depend on: hashes of their files and of the model, and versions."""
    files = {word: KEYFRAMES_FILE if word == KEYFRAMES else Path(word) for word in words if word != NOTHING}
    inputs = {"model": model_sha256(load_model(model))}
    for word, path in files.items():
        inputs[word] = sha256_of_file(weights_file(path) if path.is_dir() else path)
    return {"inputs": inputs, "versions": versions()}


def conditions(
    args: argparse.Namespace, word: str, model: Path | None, *, randomize: bool
) -> tuple[Controller, Conditions]:
    """The controller a word names, and what its trials run on.

    Raises:
        UsageError: a number that cannot be.
    """
    if not 0 <= args.seed <= _MOST_SEED:
        raise UsageError(f"--seed is {args.seed}: expected 0 .. {_MOST_SEED}")
    if args.rate is not None and not 0.0 < args.rate <= 1000.0:
        raise UsageError("--rate must be more than 0 and at most 1000")
    task = chosen_task_of(args, word)
    if args.task is None:  # whatever a policy was trained with, it is measured as the model file steps
        task = own_physics(task)
    allowed = {"allow_other_model": args.allow_other_model, "trust": args.trust}
    controller, chosen = find_controller(word, model, task, **allowed)
    return controller, Conditions(
        model=chosen, task=evaluation_task(task), rate_hz=args.rate, randomize=randomize, seed=args.seed
    )

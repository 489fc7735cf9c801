"""Arguments that the commands about controllers share, and a progress bar."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from frasa_rl.controllers import Controller
from frasa_rl.evaluate import find_controller
from frasa_rl.protocol import Conditions
from frasa_sysid.calibration import UsageError

CONTROLLER_HELP = "a run or policy folder, 'keyframes', a file of keyframes (.yaml), or 'nothing' (every command held)"


def add_conditions(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say on which model and how."""
    parser.add_argument("--model", type=Path, help="model file (default: the one the policy was trained on)")
    parser.add_argument("--allow-other-model", action="store_true", help="run it on another calibration than its own")
    parser.add_argument("--rate", type=float, metavar="HZ", help="decisions a second, 20 or 100 (default: as trained)")
    parser.add_argument("--seed", type=int, default=10_000, help="of all trials (default 10000)")


def conditions(
    args: argparse.Namespace, word: str, model: Path | None, *, randomize: bool
) -> tuple[Controller, Conditions]:
    """The controller a word names, and what its trials run on.

    Raises:
        UsageError: a number that cannot be.
    """
    if args.seed < 0:
        raise UsageError("--seed must not be negative")
    if args.rate is not None and not 0.0 < args.rate <= 1000.0:
        raise UsageError("--rate must be more than 0 and at most 1000")
    asked = Conditions(model=Path(), rate_hz=args.rate, randomize=randomize, seed=args.seed)
    controller, chosen = find_controller(word, model, asked.task, allow_other_model=args.allow_other_model)
    return controller, Conditions(model=chosen, rate_hz=args.rate, randomize=randomize, seed=args.seed)


@contextmanager
def shown_share(what: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on standard error, where that is a terminal, while the work inside goes on.

    Yields:
        A function to call with the share done, 0 to 1.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True, highlight=False)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)

"""How much of its logs a command reads: options, and the logs themselves."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from frasa_sysid.errors import UsageError
from frasa_sysid.readers import read_log
from frasa_sysid.readers.kept_windows import NUMBERS, Limit
from frasa_sysid.recording import Recording

MEMORY = 2.0  # [GB]
LEAST = 2**20  # numbers that every log may keep, however many there are: 8 MiB
RANGE = (0.25, 1024.0)  # [GB]


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Give a subcommand `--between` and `--memory`."""
    parser.add_argument(
        "--between",
        nargs=2,
        type=float,
        metavar=("FROM", "TO"),
        help="only what was recorded from so many to so many seconds after a log's first message",
    )
    parser.add_argument(
        "--memory",
        type=float,
        default=MEMORY,
        metavar="GB",
        help="memory to be content with; of longer logs the parts that move most are kept [%(default)s]",
    )


def share_of_memory(args: argparse.Namespace) -> float:
    """The memory of a command beside the usual.

    Raises:
        UsageError: none, or more than there is anywhere.
    """
    if not RANGE[0] <= args.memory <= RANGE[1]:
        raise UsageError(f"--memory {args.memory:g}: expected {RANGE[0]:g} to {RANGE[1]:g} GB")
    return float(args.memory) / MEMORY


def read_within(paths: Sequence[Path], args: argparse.Namespace) -> list[Recording]:
    """The recordings of some logs, in the order given, within the memory of a command.

    Args:
        paths: MCAP files.
        args: with `clock`, `between` and `memory`.

    Raises:
        LogError: one that cannot be read.
        UsageError: times or an amount that make no sense.
    """
    most = round(NUMBERS * share_of_memory(args))
    left = 2 * most if len(paths) > 1 else most
    between = None if args.between is None else (args.between[0], args.between[1])
    found: list[Recording] = []
    for i, path in enumerate(paths):
        # What short logs leave goes to those behind them.
        recordings = read_log(path, args.clock, Limit(max(min(most, left // (len(paths) - i)), LEAST), between))
        left -= sum(one.t.size + one.y.size for each in recordings for one in each.signals.values())
        found += recordings
    return found

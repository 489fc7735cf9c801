"""`frasa-sysid lag`: the delay of one channel of logs against another, in each log and in all of them."""

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from frasa_sysid.bench import inputs_of
from frasa_sysid.calibration.command_line import add_json_flag, say
from frasa_sysid.calibration.files import write_atomic
from frasa_sysid.commands.bench import people_console
from frasa_sysid.commands.reading import add_reading_arguments, read_within
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.lag import LONGEST, Lag, lags
from frasa_sysid.lag_joint import Joint, joint_lags
from frasa_sysid.lag_page import lag_page
from frasa_sysid.recording import Recording

SCHEMA = "frasa.lag/1"
FEW = 40  # logs that are shown one by one; of more --verbose shows all
COLOURS = {"identified": "green", "known roughly": "yellow"}
LIMITS = (0.001, 10.0)  # [s] that --longest may ask for


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `lag` to the command line."""
    parser = subparsers.add_parser(
        "lag",
        help="the delay of one channel against another, by log, joint and frequency",
        description="How much later one channel of a log shows what another shows, with a 95 % interval and a verdict: "
        "one delay, a filter, or nothing that can be told. Several logs are held against each other.",
    )
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="MCAP files")
    parser.add_argument(
        "--of", default="velocity", metavar="SIGNAL", help="the late channel: a signal, or SIGNAL.COLUMN"
    )
    parser.add_argument("--against", default="position", metavar="SIGNAL", help="what it is held against, likewise")
    parser.add_argument("--joint", metavar="NAME", help="only this joint")
    parser.add_argument(
        "--longest",
        type=float,
        default=LONGEST,
        metavar="S",
        help="largest delay that is tried [s] (default: %(default)s)",
    )
    parser.add_argument(
        "--clock", choices=("auto", "header", "publish", "log"), default="auto", help="which stamps to use"
    )
    add_reading_arguments(parser)
    parser.add_argument("--verbose", action="store_true", help="every log by itself, however many")
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a page with all of it")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the delays.

    Raises:
        UsageError: a --longest that makes no sense.
        LogError: a log that cannot be read, or no log with both channels.
    """
    if not LIMITS[0] <= args.longest <= LIMITS[1]:
        raise UsageError(f"--longest {args.longest:g}: expected {LIMITS[0]:g} to {LIMITS[1]:g} s")
    recordings = read_within(args.logs, args)
    found = _found(recordings, args)
    joints = joint_lags(found)
    console = people_console()
    title = f"{args.of} against {args.against}"
    _show(console, title, found, joints, args.verbose)
    if args.report is not None:
        write_atomic(args.report, lag_page(title, found, joints))
        say(f"report: {args.report}")
    return {
        "schema": SCHEMA,
        "of": args.of,
        "against": args.against,
        "logs": [asdict(one) for one in found],
        "joints": [asdict(one) for one in joints],
        "inputs": inputs_of(recordings),
        "outputs": {"report": args.report},
    }


def _found(recordings: Sequence[Recording], args: argparse.Namespace) -> list[Lag]:
    """The delays of all logs that have both channels; those that have not are named."""
    found: list[Lag] = []
    lacking: list[LogError] = []
    for recording in recordings:
        try:
            found += lags([recording], args.of, args.against, args.joint, args.longest)
        except LogError as error:
            lacking.append(error)
    if not found:
        raise lacking[0] if lacking else LogError("no recording in these logs")
    if lacking:
        say(f"left out: {len(lacking)} of {len(recordings)} logs; {lacking[0]}")
    return found


def _show(console: Console, title: str, found: Sequence[Lag], joints: Sequence[Joint], verbose: bool) -> None:
    if verbose or len(found) <= FEW:
        console.print(_table(title, found))
    else:
        kinds = ", ".join(
            f"{count} {verdict}" for verdict, count in Counter(one.verdict for one in found).most_common()
        )
        console.print(f"{title}: {len(found)} delays ({kinds}); --verbose shows them one by one", markup=False)
    for one in joints:
        console.print(joint_words(one), markup=False, soft_wrap=True)
        for row in one.by_frequency:
            group = (
                "" if row.group_delay is None else f", group delay from the one before {1e3 * row.group_delay:.2f} ms"
            )
            text = (
                f"    {row.frequency:6.2f} Hz: {1e3 * row.delay:.2f} ms ({1e3 * row.low:.2f} to {1e3 * row.high:.2f})"
            )
            console.print(text + group, markup=False, soft_wrap=True)
    held = {round(1e3 * one.held, 1) for one in found if one.held is not None}
    if held:
        text = f"A goal that is held from sample to sample is {min(held):g} ms of this, half its period"
        console.print(text + " (the delay takes it to move on in between).", markup=False, soft_wrap=True)


def _table(title: str, found: Sequence[Lag]) -> Table:
    table = Table(title=escape(title), title_justify="left", title_style="bold")
    for heading in ("log", "joint", "delay ms", "95 %", "ratio", "main Hz", "verdict", "why"):
        table.add_column(
            heading, justify="right" if heading in ("delay ms", "ratio", "main Hz") else "left", overflow="fold"
        )
    for one in found:
        verdict = f"[{COLOURS.get(one.verdict, 'red')}]{one.verdict}[/]"
        table.add_row(
            escape(one.recording),
            escape(one.joint or "-"),
            "-" if one.delay is None else f"{1e3 * one.delay:.2f}",
            interval_words(one.low, one.high),
            "-" if math.isnan(one.ratio) else f"{one.ratio:.3f}",
            f"{one.frequency:.2f}",
            verdict,
            escape(one.reason),
        )
    return table


def interval_words(low: float, high: float) -> str:
    """An interval in ms."""
    return "-" if math.isnan(low) else f"{1e3 * low:.2f} to {1e3 * high:.2f}"


def joint_words(one: Joint) -> str:
    """What all logs say about one joint, in a sentence."""
    who = f"{one.joint}: " if one.joint else ""
    if one.delay is None:
        return f"{who}{one.verdict}; {one.reason}"
    logs = "1 log" if one.logs == 1 else f"{one.used} of {one.logs} logs"
    return (
        f"{who}{1e3 * one.delay:.2f} ms ({interval_words(one.low, one.high)}), {one.verdict}, from {logs}; {one.reason}"
    )

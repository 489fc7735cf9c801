"""`frasa-sysid inspect`: what is in a log, its clock and faults, and what it can identify."""

import argparse
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from frasa_sysid.bench import inputs_of
from frasa_sysid.calibration.command_line import add_json_flag, say
from frasa_sysid.commands.bench import SERVO_HELP, people_console
from frasa_sysid.commands.faults import show_faults
from frasa_sysid.commands.log_health import all_checks, clock_report, show_checks, show_clocks, show_whole_logs
from frasa_sysid.commands.reading import add_reading_arguments, read_within
from frasa_sysid.finding import Finding
from frasa_sysid.fit_json import ROBOT
from frasa_sysid.identifiability import bench_findings, next_logs
from frasa_sysid.inspection import SignalSummary, is_bench, summarise
from frasa_sysid.logged_servo import servo_name, stands_in
from frasa_sysid.readers.effort import UNDECLARED, undeclared
from frasa_sysid.recording import Recording, Signal
from frasa_sysid.robot_findings import robot_findings
from frasa_sysid.robot_rig import is_robot
from frasa_sysid.servo import Servo, find_table, is_table

SCHEMA = "frasa.inspect/1"
FEW = 2  # recordings that are shown one by one
COLOURS = {"yes": "green", "weak": "yellow", "no": "red"}


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `inspect` to the command line."""
    parser = subparsers.add_parser(
        "inspect",
        help="what is in a log, its clock and faults, and what it can identify",
        description="Show what is in logs: signals, rates, clock, faults, rigs; and what all of them together "
        "can identify, with the log to record next.",
    )
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="MCAP files")
    parser.add_argument(
        "--clock", choices=("auto", "header", "publish", "log"), default="auto", help="which stamps to use"
    )
    add_reading_arguments(parser)
    parser.add_argument("--servo", metavar="NAME_OR_TABLE", help=SERVO_HELP)
    parser.add_argument("--verbose", action="store_true", help="every recording by itself, however many")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Inspect logs.

    Raises:
        LogError: a log that cannot be read.
        InputError, UsageError: an unknown servo, one that contradicts the logs, or a table that cannot be used.
    """
    recordings = read_within(args.logs, args)
    servo = find_table(args.servo).servo if args.servo else None
    if servo is not None:
        servo_name(recordings, servo.name, is_table(args.servo))
        if told := stands_in(recordings, servo.name, args.servo):
            say(told)
        recordings = [replace(one, rig=replace(one.rig, servo=servo.name)) for one in recordings]
    found = _by_servo(recordings, servo)
    console = people_console()
    if args.verbose or len(recordings) <= FEW:
        for recording in recordings:
            _show_recording(console, recording)
    else:
        _show_groups(console, recordings)
    show_whole_logs(console, recordings)
    show_faults(console, recordings)
    if efforts := undeclared(recordings):
        console.print(UNDECLARED.format(count=efforts), markup=False, soft_wrap=True)
    show_clocks(console, recordings)
    wrong = all_checks(recordings)
    show_checks(console, wrong)
    _show_findings(console, recordings, found)
    by_servo = [(servo, one) for servo, several in found.items() for one in several]
    return {
        "schema": SCHEMA,
        "recordings": [_describe(recording) for recording in recordings],
        "identifiable": [{"servo": servo, **asdict(one)} for servo, one in by_servo],
        "checks": [asdict(one) for one in wrong],
        "inputs": inputs_of(recordings),
        "next": [{"servo": servo, "record": log} for servo in found for log in next_logs(found[servo])],
    }


def _by_servo(recordings: Sequence[Recording], servo: Servo | None) -> dict[str, list[Finding]]:
    """Verdicts for each servo type: logs of one say nothing about another."""
    groups: dict[str, list[Recording]] = defaultdict(list)
    for recording in recordings:
        groups[recording.rig.servo or "servo not named"].append(recording)
    found = {name: bench_findings(members, servo) for name, members in sorted(groups.items())}
    found[ROBOT] = robot_findings(recordings)
    return {name: several for name, several in found.items() if several}


def _describe(recording: Recording) -> dict[str, Any]:
    return {
        "name": recording.name,
        "source": recording.source,
        "sha256": recording.sha256,
        "origin": recording.origin,
        "clock": recording.clock,
        "clocks": clock_report(recording),
        "duration_s": recording.duration,
        "rig": recording.rig.known(),
        "truth": dict(recording.truth),
        "signals": [asdict(summarise(signal)) for signal in recording.signals.values()],
        "faults": [asdict(fault) for fault in recording.faults],
        **{name: recording.extra[name] for name in ("excerpt", "whole_log") if name in recording.extra},
    }


def _show_recording(console: Console, recording: Recording) -> None:
    facts = ", ".join(f"{name} {value}" for name, value in recording.rig.known().items())
    title = f"{recording.name}: {recording.duration:.2f} s, {recording.origin}, {recording.clock} clock\n{facts}"
    table = Table(title=escape(title), title_justify="left", title_style="bold")
    for heading in ("signal", "unit", "samples", "period ms (p50/99/max)", "range", "quantum"):
        table.add_column(heading, justify="left" if heading in ("signal", "unit") else "right", overflow="fold")
    for signal in recording.signals.values():
        table.add_row(*(escape(cell) for cell in _row(summarise(signal))))
    console.print(table)


def _row(one: SignalSummary) -> tuple[str, ...]:
    name = f"{one.name} x {len(one.columns)}" if one.columns else one.name
    periods = "/".join(f"{1e3 * period:.3g}" for period in (one.period_median, one.period_p99, one.period_max))
    step = "-" if one.quantum is None else f"{one.quantum:.4g}"
    return name, one.unit, str(one.samples), periods, f"{one.low:.3g}..{one.high:.3g}", step


def _show_groups(console: Console, recordings: Sequence[Recording]) -> None:
    """One line a rig: many logs of one bench differ in gain and trajectory only."""
    groups: dict[tuple[str, str, str], list[Recording]] = defaultdict(list)
    for recording in recordings:
        rig = recording.rig
        groups[rig.servo or "?", _number(rig.mass), _number(rig.length)].append(recording)
    clocks = ", ".join(sorted({one.clock for one in recordings}))
    table = Table(title=f"{len(recordings)} recordings, {clocks} clock", title_justify="left", title_style="bold")
    for heading in ("servo", "load", "logs", "gains", "motions", "time s", "period ms"):
        table.add_column(heading, overflow="fold")
    for (servo, mass, length), members in sorted(groups.items()):
        load = "?" if mass == length == "?" else f"{mass} kg, {length} m"
        table.add_row(escape(servo), escape(load), str(len(members)), *_group_cells(members))
    console.print(table)
    trajectories = sorted({one.rig.trajectory for one in recordings if one.rig.trajectory})
    if trajectories:
        console.print(f"Motions: {', '.join(trajectories)}", markup=False)


def _group_cells(members: Sequence[Recording]) -> tuple[str, ...]:
    gains = sorted({one.rig.firmware_gain for one in members if one.rig.firmware_gain is not None})
    trajectories = {one.rig.trajectory for one in members if one.rig.trajectory}
    periods = [summarise(_main_signal(one)).period_median for one in members]
    low, high = f"{1e3 * min(periods):.2f}", f"{1e3 * max(periods):.2f}"
    return (
        " ".join(_number(gain) for gain in gains) or "-",
        str(len(trajectories)) if trajectories else "-",
        f"{sum(one.duration for one in members):.1f}",
        low if low == high else f"{low}-{high}",
    )


def _main_signal(recording: Recording) -> Signal:
    return recording.signals.get("position") or next(iter(recording.signals.values()))


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"


def _show_findings(console: Console, recordings: Sequence[Recording], found: Mapping[str, list[Finding]]) -> None:
    others = sum(not is_bench(recording) and not is_robot(recording) for recording in recordings)
    if others:
        console.print(
            f"{others} of {len(recordings)} recordings are not of a single joint that turns, or very short; no verdict"
        )
    for servo, several in found.items():
        title = f"What these logs can identify together: {servo}"
        table = Table(title=escape(title), title_justify="left", title_style="bold")
        for heading in ("parameter", "verdict", "why"):
            table.add_column(heading, overflow="fold")
        for one in several:
            table.add_row(one.parameter, f"[{COLOURS[one.verdict]}]{one.verdict}[/]", escape(one.reason))
        console.print(table)
        for i, log in enumerate(next_logs(several)):
            console.print(f"{'Record next:' if i == 0 else '        then:'} {log}", markup=False, soft_wrap=True)

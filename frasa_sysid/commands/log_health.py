"""Clocks and joints of logs, for people: what `inspect` says beside the faults that were handled."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from frasa_sysid.clocks import jitter
from frasa_sysid.joint_checks import Check, checks
from frasa_sysid.recording import Recording

MOST = 12  # lines of each kind that are shown; the JSON has all
LEVELS = {"refuse": "[red]refused[/]", "warn": "[yellow]warning[/]"}


def clock_report(recording: Recording) -> dict[str, Any]:
    """Jitter of each signal and the clocks against each other, as plain JSON values."""
    found = {name: jitter(signal.t) for name, signal in recording.signals.items()}
    told = recording.extra.get("clocks", [])
    compared = [one for one in told if isinstance(one, dict)] if isinstance(told, list) else []
    return {"jitter": {name: one for name, one in found.items() if one is not None}, "compared": compared}


def show_clocks(console: Console, recordings: Sequence[Recording]) -> None:
    """Print how the clocks of logs differ and drift, once for each comparison."""
    lines: dict[str, None] = {}
    for recording in recordings:
        for one in clock_report(recording)["compared"]:
            line = clock_words(one)
            if line:
                lines.setdefault(f"  {recording.source}: {line}")
    if lines:
        console.print("[bold]Clocks[/bold]")
    for line in list(lines)[:MOST]:
        console.print(line, markup=False, soft_wrap=True)


def clock_words(one: Mapping[str, Any]) -> str:
    """One comparison of two clocks in a sentence; empty where it is none."""
    try:
        text = f"{one['of']} against {one['against']}"
        drift, offset = one.get("drift_ppm"), one.get("offset_ms")
        if drift:
            value, half = float(drift["value"]), (float(drift["high"]) - float(drift["low"])) / 2
            text += f": drift {value:+.1f} ppm (± {half:.1f})"
            text += " - not to be told from none" if abs(value) <= half else ""
        if offset:
            median, p99, most = (float(offset[f"{name}_above"]) for name in ("median", "p99", "most"))
            text += f"; beyond the least difference {median:.2f} ms (median), {p99:.2f} (99 %), {most:.2f} (most)"
    except (KeyError, TypeError, ValueError):
        return ""
    return text


def show_whole_logs(console: Console, recordings: Sequence[Recording]) -> None:
    """Print what logs are as a whole of which parts were kept."""
    for recording in recordings:
        whole = recording.extra.get("whole_log")
        if not isinstance(whole, dict):
            continue
        table = Table(title=escape(f"{recording.source}, all of it"), title_justify="left", title_style="bold")
        for heading in ("signal", "samples", "time s", "longest step ms", "range", "not finite"):
            table.add_column(heading, justify="left" if heading == "signal" else "right", overflow="fold")
        for name, one in whole.items():
            extent = f"{one['low']:.3g}..{one['high']:.3g}"
            cells = (f"{one['seconds']:.1f}", f"{1e3 * one['longest_step_s']:.3g}", extent, str(one["not_finite"]))
            table.add_row(escape(name), str(one["samples"]), *cells)
        console.print(table)


def show_checks(console: Console, found: Sequence[Check]) -> None:
    """Print what looks wrong with joints and rates, the same words of many logs once."""
    if not found:
        return
    console.print("[bold]Joints and rates[/bold]")
    said: dict[tuple[str, str], list[str]] = {}
    for one in found:
        said.setdefault((one.level, one.message), []).append(one.recording)
    ordered = sorted(said.items(), key=lambda item: item[0][0])
    for (level, message), logs in ordered[: 2 * MOST]:
        where = logs[0] if len(logs) == 1 else f"{len(logs)} recordings"
        console.print(f"  {LEVELS[level]} {escape(where)}: {escape(message)}", soft_wrap=True)
    if len(ordered) > 2 * MOST:
        console.print(f"  and {len(ordered) - 2 * MOST} more; --json has all")
    if any(level == "refuse" for level, _ in said):
        console.print("  refused: a fit would be misled by it, or cannot be made; warning: it can, with that in mind")


def all_checks(recordings: Sequence[Recording]) -> list[Check]:
    """What looks wrong with all recordings."""
    return [check for recording in recordings for check in checks(recording)]

"""Faults of logs, for people: what was found wrong and what was done about it, a line for each kind."""

from collections import Counter, defaultdict
from collections.abc import Sequence

from rich.console import Console

from frasa_sysid.recording import Recording


def show_faults(console: Console, recordings: Sequence[Recording]) -> None:
    """Print the faults of recordings, summed over them, with one message of each kind as an example."""
    counts: Counter[str] = Counter()
    logs: dict[str, list[str]] = defaultdict(list)
    example = {}
    for recording in recordings:
        for fault in recording.faults:
            counts[fault.code] += fault.count
            logs[fault.code].append(recording.name)
            example[fault.code] = fault.message
    console.print("[bold]Faults found and handled[/bold]" if counts else "[bold]No faults found[/bold]")
    for code, count in sorted(counts.items()):
        where = len(set(logs[code]))
        more = f" (in {where} of {len(recordings)} recordings, {count} in all; one says:)" if where > 1 else ":"
        console.print(f"  {code}{more} {example[code]}", markup=False, soft_wrap=True)

"""Faults of logs, for people: what was found wrong and what was done about it, a line for each kind."""

from collections import defaultdict
from collections.abc import Sequence

from rich.console import Console

from frasa_sysid.recording import Fault, Recording


def show_faults(console: Console, recordings: Sequence[Recording]) -> None:
    """Print the faults of recordings: of one every message, of several the sum of each kind with one as an example."""
    by_code: dict[str, list[tuple[str, Fault]]] = defaultdict(list)
    for recording in recordings:
        for fault in recording.faults:
            by_code[fault.code].append((recording.name, fault))
    console.print("[bold]Faults found and handled[/bold]" if by_code else "[bold]No faults found[/bold]")
    for code, found in sorted(by_code.items()):
        if len(recordings) == 1 or len(found) == 1:
            lines = [f"{code}: {fault.message}" for _, fault in found]
        else:
            where, total = len({name for name, _ in found}), sum(fault.count for _, fault in found)
            lines = [
                f"{code} (in {where} of {len(recordings)} recordings, {total} in all; one says:) {found[-1][1].message}"
            ]
        for line in lines:
            console.print(f"  {line}", markup=False, soft_wrap=True)

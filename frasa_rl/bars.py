"""How work goes, on standard error: bars, and lines that are written over."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from frasa_sysid.calibration import say

_LINE_S = {True: 1.0, False: 30.0}  # a terminal's line is rewritten, a log's lines add up


@contextmanager
def shown_share(what: str) -> Iterator[Callable[[float], None]]:
    """Show a bar, where standard error is a terminal, while the work inside goes on.

    Yields:
        A function to call with the share done, 0 to 1.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(stderr=True, highlight=False)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)


class Line:
    """One line that tells how it goes; whoever has news offers it as often as he likes."""

    def __init__(self) -> None:
        self._shown_at = -float("inf")

    @property
    def due(self) -> bool:
        """Whether it is time to show it again."""
        return time.monotonic() - self._shown_at > _LINE_S[sys.stderr.isatty()]

    def show(self, text: str) -> None:
        """Write it over what it said before; a new one where standard error is no terminal."""
        self._shown_at = time.monotonic()
        if sys.stderr.isatty():
            print(f"\r{text}\033[K", end="", file=sys.stderr, flush=True)
        else:
            say(text)

    def tell(self, text: str) -> None:
        """Say something that stays, in place of the line."""
        say(f"\r{text}\033[K" if sys.stderr.isatty() else text)


def clock(seconds: float) -> str:
    """A time as hours, minutes and seconds."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"

"""A progress bar for work whose share done is known."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from frasa_sysid.commands.bench import people_console


@contextmanager
def shown_share(what: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on standard error while the work inside goes on.

    Yields:
        A function to call with the share done, 0 to 1.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=people_console(), transient=True) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)

"""Independent pieces of work side by side: in this process, in others, or on a Dask cluster.

Results come back in the order of the tasks and depend on nothing but the task, so they are
the same for any number of workers.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import joblib

from frasa_sysid.calibration import dask_client
from frasa_sysid.errors import UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")


class Spread:
    """Where tasks run.

    Args:
        jobs: processes; 1 keeps to this one, whose simulations are threaded already.
        backend: joblib's; None for its own processes.
    """

    def __init__(self, jobs: int = 1, backend: str | None = None) -> None:
        self.jobs, self._backend = jobs, backend

    @property
    def local(self) -> bool:
        """Whether tasks run in this process."""
        return self.jobs == 1 and self._backend is None

    def map(self, work: Callable[[Task], Result], tasks: Sequence[Task]) -> list[Result]:
        """Results of all tasks, in their order."""
        if self.local or len(tasks) < 2:
            return [work(task) for task in tasks]
        with joblib.parallel_config(backend=self._backend or "loky", n_jobs=self.jobs):
            return list(joblib.Parallel()(joblib.delayed(work)(task) for task in tasks))


@contextmanager
def spread_over(jobs: int, cluster: str | None) -> Iterator[Spread]:
    """A `Spread` for a command.

    Args:
        jobs: local processes.
        cluster: address of a Dask scheduler, such as `tcp://host:8786`; None for none.

    Raises:
        UsageError: bad number, `distributed` is not installed, or nobody answers at the address.
    """
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: expected 1 or more")
    if cluster is None:
        yield Spread(jobs)
        return
    with dask_client(cluster):
        yield Spread(-1, "dask")

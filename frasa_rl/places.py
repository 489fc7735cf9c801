"""Where the agents of a sweep run: each has a set of cores or a GPU of its own, on this machine or on a cluster."""

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_GPUS = "CUDA_VISIBLE_DEVICES"
HERE = ""  # the address of this process, where there is no cluster

_taken: set[int] = set()
_lock = threading.Lock()


@dataclass(frozen=True)
class Place:
    """What one agent may use.

    Attributes:
        count: of cores.
        cores: which; none where the system does not let processes choose.
        gpu: as CUDA counts them; None for whichever there are.
    """

    count: int = 1
    cores: tuple[int, ...] = ()
    gpu: str | None = None

    @property
    def environment(self) -> dict[str, str]:
        """Variables of a process there: no library starts threads for all cores of the machine."""
        return dict.fromkeys(_THREADS, "1") | ({} if self.gpu is None else {_GPUS: self.gpu})

    def occupy(self) -> None:
        """Keep the present process to its cores."""
        if self.cores and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, self.cores)


@dataclass(frozen=True)
class Share:
    """The places of a process on its machine.

    Attributes:
        first: number of its first place.
        of: how many the machine has, for all processes.
    """

    first: int
    of: int


def shares(threads: Mapping[str, int]) -> dict[str, Share]:
    """How the workers of a cluster share their machines: a place for every thread.

    Args:
        threads: of every worker, by its address.
    """
    total: dict[str, int] = {}
    first = {}
    for address, count in threads.items():
        host = _host(address)
        first[address] = total.get(host, 0)
        total[host] = first[address] + count
    return {address: Share(number, total[_host(address)]) for address, number in first.items()}


def _host(address: str) -> str:
    return urlsplit(address).hostname or address


@contextmanager
def taken_place(share: Share, *, gpu: bool) -> Iterator[Place]:
    """A place that nobody else in this process has meanwhile, as long as it has enough of them.

    Args:
        share: of this process.
        gpu: whether GPUs are given out.
    """
    with _lock:
        number = next(one for one in range(len(_taken) + 1) if one not in _taken)
        _taken.add(number)
    try:
        yield place(share.first + number, share.of, gpus() if gpu else [])
    finally:
        with _lock:
            _taken.discard(number)


def place(number: int, of: int, devices: list[str]) -> Place:
    """The cores and GPU of a number: equal parts of those this process may use.

    Args:
        number: of the place.
        of: how many there are.
        devices: GPUs there are; shared by turns where there are fewer than places.
    """
    number %= of
    gpu = devices[number % len(devices)] if len(devices) > 1 else None
    if not hasattr(os, "sched_getaffinity"):
        return Place(max(1, (os.cpu_count() or 1) // of), (), gpu)
    cores = sorted(os.sched_getaffinity(0))
    own = cores[number * len(cores) // of : (number + 1) * len(cores) // of]
    own = own or [cores[number % len(cores)]]  # more places than cores
    return Place(len(own), tuple(own), gpu)


def gpus() -> list[str]:
    """The GPUs this process may use, as CUDA names them."""
    from torch.cuda import device_count  # it does not start CUDA

    named = [one.strip() for one in os.environ.get(_GPUS, "").split(",") if one.strip()]
    count = device_count()
    return named[:count] if named else [str(one) for one in range(count)]


def usual_jobs(cores: int, *, gpu: bool) -> int:
    """Agents at a time that suit a machine: one for each GPU, else for two cores, which learn and step the robots."""
    return (len(gpus()) if gpu else 0) or max(1, cores // 2)

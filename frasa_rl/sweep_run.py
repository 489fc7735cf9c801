"""The agents of a sweep side by side: through joblib, on this machine or on a Dask cluster.

Every agent is a process of its own (`agent`), so that none takes others along when it fails, however it fails, and
each has its threads, cores and GPU from its first moment on. What joblib spreads only starts such a process and waits
for it, so that on this machine threads do.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import joblib

import frasa_rl
from frasa_rl import __version__
from frasa_rl.places import HERE, Place, Share, shares, taken_place
from frasa_rl.sweep_files import LOG_FILE, STOP_FILE, SWEEP_FILE
from frasa_sysid.calibration import FrasaError, InterruptedRunError, UsageError, dask_client, load_model, model_sha256

_POLL_S = 0.25
_TAIL = 4096  # bytes of a log that its last line is looked for in
DONE, WAITING, FAILED = "done", "waiting", "failed"


@dataclass(frozen=True)
class Order:
    """What one agent is to do, in plain data that any worker understands.

    Attributes:
        seed: of the agent.
        out: its run folder, in the folder of the sweep.
        run: as `plan.describe` says it.
    """

    seed: int
    out: Path
    run: dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """How an agent ended, if it did.

    Attributes:
        seed: of the agent.
        state: `done`, `waiting` (to begin, or to go on) or `failed`.
        why: it failed.
    """

    seed: int
    state: str
    why: str = ""


@dataclass(frozen=True)
class Workers:
    """Who runs agents.

    Attributes:
        backend: joblib's name of them.
        shares: of every worker in the places of its machine, by its address.
        count: agents at a time.
    """

    backend: str
    shares: Mapping[str, Share]
    count: int

    @property
    def local(self) -> bool:
        """Whether they are this process."""
        return HERE in self.shares

    def run(self, orders: Sequence[Order]) -> Iterator[Outcome]:
        """Carry out all orders; how each ended, as they end."""
        jobs = max(1, min(self.count, len(orders))) if self.local else -1
        with joblib.parallel_config(backend=self.backend, n_jobs=jobs):
            spread = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="all")
            yield from spread(joblib.delayed(run_agent)(order, self.shares) for order in orders)


@contextmanager
def workers(jobs: int, cluster: str | None, out: Path, run: Mapping[str, Any]) -> Iterator[Workers]:
    """Those of this machine, or of a cluster.

    Args:
        jobs: agents at a time on this machine.
        cluster: address of a Dask scheduler; None for none.
        out: the folder of the sweep, which is there.
        run: of its agents, as `plan.describe` says it.

    Raises:
        UsageError: nobody at the address, no worker, or one without the same files or the same frasa.
    """
    if cluster is None:
        yield Workers("threading", {HERE: Share(0, jobs)}, jobs)
        return
    with dask_client(cluster) as client:
        threads = client.nthreads()
        if not threads:
            raise UsageError(f"--cluster {cluster}: it has no workers yet")
        said = (out / SWEEP_FILE, run["model"], run["model_sha256"], __version__)
        for address, objection in client.run(objection_of, *said, on_error="return").items():
            if objection:
                raise UsageError(f"--cluster {cluster}: worker {address} cannot take part: {objection}")
        yield Workers("dask", shares(threads), sum(threads.values()))


def objection_of(sweep: Path, model: str, sha256: str, version: str) -> str:
    """Why this process cannot take part in a sweep; empty where it can."""
    if version != __version__:
        return f"it has frasa {__version__}, this is {version}"
    if not sweep.is_file():
        return f"it sees no {sweep}: model and --out have to be in a folder that all workers share"
    try:
        own = model_sha256(load_model(Path(model)))
    except FrasaError as error:
        return str(error)
    return "" if own == sha256 else f"its {model} is another model"


def run_agent(order: Order, known: Mapping[str, Share]) -> Outcome:
    """Run one agent to its end, in a place of this process; whatever goes wrong, it comes back as an outcome.

    Args:
        order: of the agent.
        known: workers' shares by address.
    """
    if (order.out.parent / STOP_FILE).exists():
        return Outcome(order.seed, WAITING)
    try:
        with taken_place(_own(known), gpu=order.run["device"] != "cpu") as place:
            code = _run_at(order, place)
    except OSError as error:
        return Outcome(order.seed, FAILED, str(error))
    asked = (order.out.parent / STOP_FILE).exists()
    if code == 0:
        return Outcome(order.seed, DONE)
    if code == InterruptedRunError.exit_code or (asked and code < 0):
        return Outcome(order.seed, WAITING)
    return Outcome(order.seed, FAILED, _last_line(order.out / LOG_FILE) or f"it ended with status {code}")


def _own(known: Mapping[str, Share]) -> Share:
    """The share of this process; all of the machine for a worker that came later."""
    if HERE in known:
        return known[HERE]
    from distributed import get_worker

    worker: Any = get_worker  # it carries no types
    return known.get(worker().address, Share(0, 1))


def _run_at(order: Order, place: Place) -> int:
    """Start an agent and wait for it: its exit status."""
    order.out.mkdir(parents=True, exist_ok=True)
    told = {"run": order.run, "out": str(order.out), "count": place.count, "cores": place.cores}
    with ExitStack() as stack:
        log: IO[bytes] = stack.enter_context((order.out / LOG_FILE).open("ab"))
        agent = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-m", "frasa_rl.agent"],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env=_environment(place),
            )
        )
        assert agent.stdin is not None
        with suppress(BrokenPipeError):  # it has failed already, and its log says why
            agent.stdin.write(json.dumps(told).encode() + b"\n")
            agent.stdin.flush()
        while True:
            with suppress(subprocess.TimeoutExpired):
                return agent.wait(_POLL_S)
            if (order.out.parent / STOP_FILE).exists():
                agent.stdin.close()  # it saves everything and ends


def _environment(place: Place) -> dict[str, str]:
    """Of a process that has the very frasa of this one."""
    home = str(Path(frasa_rl.__file__).parents[1])
    path = os.pathsep.join(one for one in (home, os.environ.get("PYTHONPATH")) if one)
    return {**os.environ, **place.environment, "PYTHONPATH": path}


def _last_line(log: Path) -> str:
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - _TAIL))
        lines = file.read().decode(errors="replace").split("\n")
    return next((one.strip() for one in reversed(lines) if one.strip()), "")

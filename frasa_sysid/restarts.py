"""One problem, solved from several starts: CMA-ES finds basins on a subset of runs, least squares settles on all.

Starts that end at different costs mean that the logs allow several answers, and the report says so.
"""

import hashlib
import importlib.metadata
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.ensemble import settle
from frasa_sysid.finish import FINE_STEPS, finish
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.search import SearchResult, Stop, search

SUBSET = 16  # runs that the search looks at; the finisher and all numbers use every run
EVALUATIONS_PER_PARAMETER = 60
AGREE = 0.01  # relative difference in cost within which two restarts have found the same ...
_ROUNDING = 2e-5  # [rad] ... beside what the rounding of a 12-bit encoder alone costs
NEAR = 0.05  # relative difference in cost within which another start is worth settling too
Optimizer = Literal["cmaes+lsq", "cmaes"]
Tell = Callable[[str, int, float], None]


@dataclass(frozen=True)
class Restart:
    """Where one start ended.

    Attributes:
        start: `seed 0`, or `nested` for one that began at a simpler law's solution.
        x: point of the unit cube, shape (n,).
        cost: on all training runs [rad].
    """

    start: str
    x: FloatArray
    cost: float


@dataclass(frozen=True)
class Solved:
    """The best of several starts.

    Attributes:
        x: point of the unit cube, shape (n,).
        cost: at x, on all training runs [rad].
        restarts: all starts, the best first.
        evaluations: candidates simulated.
        stop: why it ended.
        trace: best cost of the first search after each generation [rad].
    """

    x: FloatArray
    cost: float
    restarts: tuple[Restart, ...]
    evaluations: int
    stop: Stop
    trace: tuple[float, ...]

    @property
    def multimodal(self) -> bool:
        """Whether independent searches ended at costs that differ by more than 1 %, and by more than rounding."""
        costs = [one.cost for one in self.restarts if one.start.startswith("seed")]
        # Not `cost`: multiple shooting lowers that one after the searches.
        lowest = min((one.cost for one in self.restarts), default=self.cost)
        return len(costs) > 1 and max(costs) > lowest * (1.0 + AGREE) + _ROUNDING


def solve(
    problem: FitProblem,
    session: BenchSession,
    budget: int | None = None,
    optimizer: Optimizer = "cmaes+lsq",
    restarts: int = 1,
    nested: Sequence[FloatArray] = (),
    checkpoint: Path | None = None,
    tell: Tell = lambda stage, count, best: None,
) -> Solved:
    """Solve a problem.

    Args:
        problem: with its training runs.
        session: simulates them.
        budget: evaluations of each search; by default 60 per parameter.
        optimizer: `cmaes` alone (on all runs), or with the least-squares finisher.
        restarts: searches with seeds of their own.
        nested: points of the unit cube that are finished too, shape (n,) each; the result is never worse than them.
        checkpoint: file for resuming the searches after a kill.
        tell: told (stage, evaluations, best cost [rad]).
    """
    budget = budget or EVALUATIONS_PER_PARAMETER * len(problem.free)
    whole = session.kernel(problem.train)
    # Alone, CMA-ES has to settle on all runs itself.
    part = session.kernel(subset(problem.train, SUBSET)) if optimizer == "cmaes+lsq" else whole
    identity = identity_of(problem, session, optimizer) if checkpoint is not None else ""
    found: list[Restart] = []
    used, stop = 0, Stop.BUDGET
    trace: tuple[float, ...] = ()
    for index in range(restarts):
        try:
            result = _search(problem, part, budget, problem.seed + index, nested, checkpoint, identity, tell)
        except KeyboardInterrupt:
            # Before its first generation a search has nothing to keep; others may.
            if not found and not nested:
                raise
            stop = Stop.INTERRUPTED
            break
        used += result.evaluations
        trace = trace or tuple(result.trace.best)
        stop = result.stop if index == 0 or result.stop is Stop.INTERRUPTED else stop
        found.append(Restart(f"seed {problem.seed + index}", result.x, _cost(problem, whole, result.x)))
        if stop is Stop.INTERRUPTED:
            break
    found += [Restart("nested", point, _cost(problem, whole, point)) for point in nested]
    if optimizer == "cmaes+lsq" and stop is not Stop.INTERRUPTED:
        tell("finishing", used, min(one.cost for one in found))
        found, more, stop = _finished(problem, whole, found, stop)
        used += more
    best = sorted(found, key=lambda one: one.cost)
    return Solved(best[0].x, best[0].cost, tuple(best), used, stop, trace)


def unsearched(problem: FitProblem, session: BenchSession, nested: Sequence[FloatArray]) -> Solved:
    """The best of points that are known already, (n,) each: all there is after an interrupt on the way to a search."""
    whole = session.kernel(problem.train)
    known = sorted((Restart("nested", x, _cost(problem, whole, x)) for x in nested), key=lambda one: one.cost)
    return Solved(known[0].x, known[0].cost, tuple(known), len(known), Stop.INTERRUPTED, ())


def _finished(
    problem: FitProblem, kernel: BenchKernel, found: list[Restart], stop: Stop
) -> tuple[list[Restart], int, Stop]:
    """Every start polished, the evaluations that took, and why the best one stopped."""
    done: list[tuple[Restart, bool]] = []
    used = 0
    try:
        for one in found:
            polished = finish(problem, kernel, one.x)
            used += polished.evaluations
            done.append((Restart(one.start, polished.x, polished.cost), polished.converged))
        best = min(range(len(done)), key=lambda i: done[i][0].cost)
        for i, (one, _) in enumerate(done):
            if one.cost <= done[best][0].cost * (1.0 + NEAR):
                walked = settle(problem, kernel, one.x, problem.seed)
                used += walked.evaluations
                done[i] = (Restart(one.start, walked.x, walked.cost), True)
        best = min(range(len(done)), key=lambda i: done[i][0].cost)
        for step in FINE_STEPS:
            one = done[best][0]
            polished = finish(problem, kernel, one.x, step=step)
            used += polished.evaluations
            done[best] = (Restart(one.start, polished.x, polished.cost), polished.converged)
    except KeyboardInterrupt:
        return [*(one for one, _ in done), *found[len(done) :]], used, Stop.INTERRUPTED
    converged = min(done, key=lambda pair: pair[0].cost)[1]
    return [one for one, _ in done], used, Stop.FINISHED if converged else stop


def _search(
    problem: FitProblem,
    kernel: BenchKernel,
    budget: int,
    seed: int,
    nested: Sequence[FloatArray],
    checkpoint: Path | None,
    identity: str,
    tell: Tell,
) -> SearchResult:
    def costs(points: list[FloatArray]) -> list[float]:
        table = np.array(points)
        return [float(c) for c in kernel.costs(problem.candidates(table), problem.offsets(table, kernel.runs))]

    start = _start(problem, nested)
    return search(
        costs,
        start,
        seed,
        budget,
        checkpoint,
        f"{identity} {seed} {hashlib.sha256(start.tobytes()).hexdigest()}",
        lambda count, best: tell("searching", count, best),
    )


def _start(problem: FitProblem, nested: Sequence[FloatArray]) -> FloatArray:
    """Where a search begins: at the simpler law's solution, with what is new switched on a little."""
    start = problem.to_unit(problem.start_values())
    if not nested:
        return start
    silent = problem.to_unit(problem.nominal_values())
    return np.where(np.abs(nested[0] - silent) > 1e-9, nested[0], start)


def _cost(problem: FitProblem, kernel: BenchKernel, x: FloatArray) -> float:
    return float(kernel.costs(problem.candidates(x[None]), problem.offsets(x[None], kernel.runs))[0])


def subset(runs: Sequence[BenchRun], count: int) -> list[BenchRun]:
    """At most `count` runs, spread evenly over trajectories, loads and gains."""
    ordered = sorted(runs, key=lambda run: (run.trajectory, run.gravity_torque, run.kp_scale, run.name))
    if len(ordered) <= count:
        return ordered
    return [ordered[i] for i in np.linspace(0, len(ordered) - 1, count).round().astype(int)]


def point_of(problem: FitProblem, other: FitProblem, x: FloatArray) -> FloatArray:
    """The solution of a simpler problem as a point of a richer one's cube: what is new stays without effect.

    Args:
        problem: the richer one, n numbers.
        other: the simpler one, m numbers.
        x: point of its cube, shape (m,).

    Returns:
        Point, shape (n,).
    """
    values = other.from_unit(x)
    known = other.servo_values(values)
    by_name = {one.name: float(value) for one, value in zip(other.free, values, strict=True)}
    shared = set(other.nominal) | {one.field for one in other.free} | set(other.ties)
    point = []
    for one in problem.free:
        if one.rig or one.field not in shared:
            point.append(by_name.get(one.name, one.nominal))
        else:
            point.append(getattr(known, one.field))
    return np.asarray(np.clip(problem.to_unit(np.array(point)), 0.0, 1.0))


def identity_of(problem: FitProblem, session: BenchSession, optimizer: str) -> str:
    """Hash of everything a search depends on: another input never resumes this one's checkpoint."""
    runs = hashlib.sha256()
    for run in problem.train:
        # Everything in it: the same log with another load, gain or clock is another run.
        for one in fields(run):
            value = getattr(run, one.name)
            runs.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    facts = {
        "free": [(one.name, one.low, one.high, one.nominal, one.start) for one in problem.free],
        "nominal": dict(problem.nominal),
        "law": [problem.law, *problem.effects],
        "train": runs.hexdigest(),
        "model": session.fingerprint,
        "optimizer": optimizer,
        "versions": {name: importlib.metadata.version(name) for name in ("frasa", "cmaes", "numba")},
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()

"""The fit: search, finish, weigh the evidence, and say how much better than nominal it is.

CMA-ES looks for the basin on a spread-out subset of the runs, least squares settles on all
of them, and every number that is reported is computed on all of them.
"""

import hashlib
import importlib.metadata
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np

from frasa_sysid.cost import Misfit, misfit, residuals, robust_cost
from frasa_sysid.evidence import ON_BOUND, Evidence, evidence
from frasa_sysid.finish import finish
from frasa_sysid.problem import FitProblem
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.search import SearchResult, Stop, search

SUBSET = 16  # runs that the search looks at; the finisher and all numbers use every run
EVALUATIONS_PER_PARAMETER = 60
_UNEXCITED_LOSS = 0.005  # relative loss in cost for which an unexcited number goes back to nominal
Optimizer = Literal["cmaes+lsq", "cmaes"]


@dataclass(frozen=True)
class FitResult:
    """Everything a fit found.

    Attributes:
        problem: what was asked.
        values: fitted, shape (n,).
        evidence: intervals, verdicts, correlations.
        nominal, fitted: errors on the training runs.
        held_out_nominal, held_out: errors on the held-out runs; NaN when there are none.
        stop: why the search ended.
        trace: best cost of the search after each generation [rad].
        evaluations: candidates simulated, the finisher's and the evidence's included.
        seconds: wall clock.
        friction: the law, `m1` here.
        inputs: sha256 by source file.
        versions: of what the result depends on.
    """

    problem: FitProblem
    values: FloatArray
    evidence: Evidence
    nominal: Misfit
    fitted: Misfit
    held_out_nominal: Misfit
    held_out: Misfit
    stop: Stop
    trace: tuple[float, ...]
    evaluations: int
    seconds: float
    friction: str
    inputs: dict[str, str]
    versions: dict[str, str]


def fit(
    problem: FitProblem,
    simulator: BenchSimulator,
    inputs: dict[str, str],
    evaluations: int | None = None,
    optimizer: Optimizer = "cmaes+lsq",
    checkpoint: Path | None = None,
    on_progress: Callable[[str, int, float], None] | None = None,
) -> FitResult:
    """Fit the free parameters of a problem.

    Args:
        problem: what to fit on what.
        simulator: of the bench.
        inputs: sha256 by source file, kept with the result.
        evaluations: budget of the search; by default 60 per parameter.
        optimizer: `cmaes` alone, or with the least-squares finisher.
        checkpoint: file for resuming the search after a kill.
        on_progress: told (stage, evaluations, best cost [rad]).

    Returns:
        The result; with `stop` INTERRUPTED when the user stopped the search.
    """
    started = time.monotonic()
    budget = evaluations or EVALUATIONS_PER_PARAMETER * len(problem.free)
    tell = on_progress or (lambda stage, count, best: None)
    found = _search(problem, simulator, budget, optimizer, checkpoint, tell)
    x, used, stop = found.x, found.evaluations, found.stop
    if optimizer == "cmaes+lsq" and stop is not Stop.INTERRUPTED:
        tell("finishing", used, found.cost)
        try:
            finished = finish(problem, simulator, x)
            x, used = finished.x, used + finished.evaluations
            stop = Stop.FINISHED if finished.converged else stop
        except KeyboardInterrupt:
            stop = Stop.INTERRUPTED
    tell("weighing the evidence", used, found.cost)
    weighed = evidence(problem, simulator, problem.from_unit(x))
    values, more = _drop_unexcited(problem, simulator, problem.from_unit(x), weighed)
    used += 2 * len(problem.free) + 1 + more
    weighed = _restated(weighed, values)
    pair = [problem.nominal_values(), values]
    nominal, fitted = _misfits(problem, simulator, problem.train, pair)
    held_nominal, held = _misfits(problem, simulator, problem.held_out, pair)
    return FitResult(
        problem=problem,
        values=values,
        evidence=weighed,
        nominal=nominal,
        fitted=fitted,
        held_out_nominal=held_nominal,
        held_out=held,
        stop=stop,
        trace=tuple(found.trace.best),
        evaluations=used,
        seconds=time.monotonic() - started,
        friction="m1",
        inputs=inputs,
        versions={name: importlib.metadata.version(name) for name in ("frasa", "mujoco", "cmaes", "numpy", "scipy")},
    )


def simulated(result: FitResult, simulator: BenchSimulator, runs: Sequence[BenchRun]) -> list[FloatArray]:
    """What the fit sees on runs: readings at the measured times [rad], one array per run."""
    return simulator.simulate(runs, [result.problem.servo_values(result.values)])[0]


def _search(
    problem: FitProblem,
    simulator: BenchSimulator,
    budget: int,
    optimizer: Optimizer,
    checkpoint: Path | None,
    tell: Callable[[str, int, float], None],
) -> SearchResult:
    # Alone, CMA-ES has to settle on all runs itself.
    runs = subset(problem.train, SUBSET) if optimizer == "cmaes+lsq" else list(problem.train)

    def costs(points: list[FloatArray]) -> list[float]:
        candidates = [problem.servo_values(problem.from_unit(point)) for point in points]
        return [robust_cost(residuals(runs, readings)) for readings in simulator.simulate(runs, candidates)]

    start = problem.to_unit(problem.nominal_values())
    return search(
        costs,
        start,
        problem.seed,
        budget,
        checkpoint,
        _identity(problem, simulator, optimizer),
        lambda count, best: tell("searching", count, best),
    )


def subset(runs: Sequence[BenchRun], count: int) -> list[BenchRun]:
    """At most `count` runs, spread evenly over trajectories, loads and gains."""
    ordered = sorted(runs, key=lambda run: (run.trajectory, run.gravity_torque, run.kp_scale, run.name))
    if len(ordered) <= count:
        return ordered
    return [ordered[i] for i in np.linspace(0, len(ordered) - 1, count).round().astype(int)]


def _identity(problem: FitProblem, simulator: BenchSimulator, optimizer: str) -> str:
    """Hash of everything the search depends on: another input never resumes this one's checkpoint."""
    runs = hashlib.sha256()
    for run in problem.train:
        # Everything in it: the same log with another load, gain or clock is another run.
        for one in fields(run):
            value = getattr(run, one.name)
            runs.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    facts = {
        "free": [(one.name, one.low, one.high, one.nominal) for one in problem.free],
        "nominal": dict(problem.nominal),
        "train": runs.hexdigest(),
        "model": simulator.fingerprint,
        "seed": problem.seed,
        "optimizer": optimizer,
        "versions": {name: importlib.metadata.version(name) for name in ("frasa", "mujoco", "cmaes")},
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _drop_unexcited(
    problem: FitProblem, simulator: BenchSimulator, values: FloatArray, weighed: Evidence
) -> tuple[FloatArray, int]:
    """Numbers the logs do not speak of, and delays on their bound, go back to nominal unless the cost objects.

    Returns:
        The values, shape (n,), and the number of evaluations used.
    """

    def cost(point: FloatArray) -> float:
        return robust_cost(
            residuals(problem.train, simulator.simulate(problem.train, [problem.servo_values(point)])[0])
        )

    # No delay at all lies outside the bounds (the shortest one MuJoCo acts on is a step), so it is tried here.
    unexcited = [
        i
        for i, (one, free) in enumerate(zip(weighed.estimates, problem.free, strict=True))
        if not one.excited or (one.verdict == ON_BOUND and not free.low <= free.nominal <= free.high)
    ]
    if not unexcited:
        return values, 0
    allowed = cost(values) * (1.0 + _UNEXCITED_LOSS)
    for i in unexcited:
        dropped = values.copy()
        dropped[i] = weighed.estimates[i].nominal
        if cost(dropped) <= allowed:
            values = dropped
    return values, len(unexcited) + 1


def _restated(weighed: Evidence, values: FloatArray) -> Evidence:
    estimates = tuple(
        replace(one, value=float(value), low=min(one.low, float(value)), high=max(one.high, float(value)))
        for one, value in zip(weighed.estimates, values, strict=True)
    )
    return replace(weighed, estimates=estimates)


def _misfits(
    problem: FitProblem, simulator: BenchSimulator, runs: Sequence[BenchRun], points: Sequence[FloatArray]
) -> list[Misfit]:
    candidates = [problem.servo_values(point) for point in points]
    return [misfit(runs, readings) for readings in simulator.simulate(runs, candidates)]

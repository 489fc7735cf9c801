"""The fit: search, finish, weigh the evidence, and say how much better than nominal it is.

A friction law richer than M1 is fitted along its ladder (M1, then M2 and M3, then M4, M5, M6), each
starting also from the solution of the simpler one, so that a richer law never fits worse.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import versions as versions_of
from frasa_sysid.calibration.stepping import EULER
from frasa_sysid.cost import Misfit, misfit
from frasa_sysid.evidence import ON_BOUND, Evidence, evidence, widened
from frasa_sysid.problem import FitProblem, state_problem
from frasa_sysid.recording import FloatArray
from frasa_sysid.restarts import AGREE, Optimizer, Solved, Tell, point_of, solve, unsearched
from frasa_sysid.rig import BenchRun
from frasa_sysid.search import Stop
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.shooting import shoot

RESTARTS = 3  # searches of the final problem; they must agree
_UNEXCITED_LOSS = 0.005  # relative loss in cost for which an unexcited number goes back to nominal
# Which simpler laws a law starts from.
_BELOW = {"m1": (), "m2": ("m1",), "m3": ("m1",), "m4": ("m2", "m3"), "m5": ("m4",), "m6": ("m5",)}


@dataclass(frozen=True)
class FitResult:
    """Everything a fit found.

    Attributes:
        problem: what was asked.
        values: fitted, shape (n,).
        evidence: intervals, verdicts, correlations.
        nominal, fitted: errors on the training runs.
        held_out_nominal, held_out: errors on the held-out runs; NaN when there are none.
        solved: starts, and why the search ended.
        evaluations: candidates simulated, the finisher's and the evidence's included.
        seconds: wall clock.
        inputs: sha256 by source file.
        versions: of what the result depends on.
        stepping: how the bench stepped, see `calibration.stepping`; a model with the numbers has to step so too.
    """

    problem: FitProblem
    values: FloatArray
    evidence: Evidence
    nominal: Misfit
    fitted: Misfit
    held_out_nominal: Misfit
    held_out: Misfit
    solved: Solved
    evaluations: int
    seconds: float
    inputs: dict[str, str]
    versions: dict[str, str] = field(default_factory=dict)
    stepping: str = EULER

    @property
    def friction(self) -> str:
        """The friction law, `m1` to `m6`."""
        return self.problem.law

    @property
    def stop(self) -> Stop:
        """Why the search ended."""
        return self.solved.stop

    @property
    def trace(self) -> tuple[float, ...]:
        """Best cost of the first search after each generation [rad]."""
        return self.solved.trace


def fit(
    problem: FitProblem,
    session: BenchSession,
    inputs: dict[str, str],
    evaluations: int | None = None,
    optimizer: Optimizer = "cmaes+lsq",
    checkpoint: Path | None = None,
    on_progress: Tell | None = None,
    restarts: int = RESTARTS,
    known: Sequence[FloatArray] = (),
) -> FitResult:
    """Fit the free parameters of a problem.

    Args:
        problem: what to fit on what.
        session: simulates the bench.
        inputs: sha256 by source file, kept with the result.
        evaluations: budget of each search; by default 60 per parameter.
        optimizer: `cmaes` alone, or with the least-squares finisher.
        checkpoint: file for resuming the search after a kill.
        on_progress: told (stage, evaluations, best cost [rad]).
        restarts: searches of the final problem.
        known: solutions already known of this very problem, points of the unit cube.

    Returns:
        The result; with `stop` INTERRUPTED when the user stopped the search.
    """
    started = time.monotonic()
    tell = on_progress or (lambda stage, count, best: None)
    nested, climbed, stop = tuple(known), 0, Stop.FINISHED
    if not nested and optimizer == "cmaes+lsq":
        nested, climbed, stop = climb(problem, session, evaluations, checkpoint, tell)
    if stop is Stop.INTERRUPTED:
        solved = unsearched(problem, session, nested)
    else:
        solved = solve(problem, session, evaluations, optimizer, restarts, nested, checkpoint, tell)
    solved = replace(solved, evaluations=solved.evaluations + climbed)
    if any(run.free_start for run in problem.train) and solved.stop is not Stop.INTERRUPTED:
        tell("multiple shooting", solved.evaluations, solved.cost)
        problem, solved = _shot(problem, session, solved)
    kernel = session.kernel(problem.train)
    tell("weighing the evidence", solved.evaluations, solved.cost)
    weighed = evidence(problem, kernel, problem.from_unit(solved.x))
    weighed = _with_restarts(problem, weighed, solved)
    values, more = _drop_unexcited(problem, kernel, problem.from_unit(solved.x), weighed)
    used = solved.evaluations + 2 * len(problem.free) + 1 + more
    nominal, fitted = misfits(problem, kernel, [None, values])
    held_nominal = held = misfit([], [])
    if problem.held_out:
        held_nominal, held = misfits(problem, session.kernel(problem.held_out), [None, values])
    return FitResult(
        problem=problem,
        values=values,
        evidence=_restated(weighed, values),
        nominal=nominal,
        fitted=fitted,
        held_out_nominal=held_nominal,
        held_out=held,
        solved=solved,
        evaluations=used,
        seconds=time.monotonic() - started,
        inputs=inputs,
        versions=versions(),
        stepping=session.stepping,
    )


def _shot(problem: FitProblem, session: BenchSession, solved: Solved) -> tuple[FitProblem, Solved]:
    """The problem with fitted starts, and its solution."""
    shot = shoot(problem, session, solved.x)
    with_starts = replace(problem, train=shot.runs)
    cost = session.kernel(shot.runs).costs(problem.candidates(shot.x[None]), problem.offsets(shot.x[None], shot.runs))
    return with_starts, replace(
        solved, x=shot.x, cost=float(cost[0]), evaluations=solved.evaluations + shot.evaluations
    )


def versions() -> dict[str, str]:
    """Of everything a result depends on."""
    return versions_of("cmaes", "scipy", "numba")


def climb(
    problem: FitProblem, session: BenchSession, evaluations: int | None, checkpoint: Path | None, tell: Tell
) -> tuple[tuple[FloatArray, ...], int, Stop]:
    """The best solution of the simpler laws, if there are any, as a point of this problem's cube.

    Returns:
        No point or one, (n,); the candidates simulated; INTERRUPTED when the user stopped it.
    """
    solutions = ladder(problem, session, _below(problem.law), evaluations, checkpoint, tell)
    points = [(solved.cost, point_of(problem, other, solved.x)) for other, solved in solutions.values()]
    last = sorted(points, key=lambda pair: pair[0])[:1]
    interrupted = any(solved.stop is Stop.INTERRUPTED for _, solved in solutions.values())
    return (
        tuple(point for _, point in last),
        sum(solved.evaluations for _, solved in solutions.values()),
        Stop.INTERRUPTED if interrupted else Stop.FINISHED,
    )


def ladder(
    problem: FitProblem,
    session: BenchSession,
    laws: Sequence[str],
    evaluations: int | None,
    checkpoint: Path | None,
    tell: Tell,
) -> dict[str, tuple[FitProblem, Solved]]:
    """Every law of a list fitted on the problem's runs with its effects, simple ones first; an interrupt ends it."""
    found: dict[str, tuple[FitProblem, Solved]] = {}
    for law in laws:
        one = with_law(problem, law, problem.effects)
        nested = [point_of(one, *_pair(found[below])) for below in _BELOW[law] if below in found]
        solved = solve(one, session, evaluations, nested=nested, checkpoint=checkpoint, tell=_named(tell, law))
        found[law] = (one, solved)
        if solved.stop is Stop.INTERRUPTED:
            break
    return found


def with_law(problem: FitProblem, law: str, effects: Sequence[str]) -> FitProblem:
    """The same runs and servo with another law and other effects."""
    delay = next(((one.low, one.high) for one in problem.free if one.field == "delay"), (0.0, 0.0))
    return state_problem(
        problem.servo,
        problem.plain,
        problem.train,
        problem.held_out,
        delay,
        problem.hold_out_rule,
        problem.seed,
        law,
        effects,
    )


def misfits(problem: FitProblem, kernel: BenchKernel, points: Sequence[FloatArray | None]) -> list[Misfit]:
    """Errors of parameter values, (n,) each, on a kernel's runs; None stands for nominal."""
    errors = []
    for values in points:
        if values is None:
            rows = kernel.readings(nominal_candidate(problem)[None])
        else:
            offsets = problem.offsets(problem.to_unit(values)[None], kernel.runs)
            rows = kernel.readings(exact_candidate(problem, values)[None], offsets)
        errors.append(misfit(kernel.runs, kernel.split(rows[0])))
    return errors


def nominal_candidate(problem: FitProblem) -> FloatArray:
    """Numbers of the nominal servo for the kernel, shape (fields,)."""
    return ServoValues(**problem.plain).array()


def simulated(result: FitResult, session: BenchSession, runs: Sequence[BenchRun]) -> list[FloatArray]:
    """What the fit sees on runs: readings at the measured times [rad], one array per run."""
    kernel = session.kernel(runs)
    x = result.problem.to_unit(result.values)[None]
    # Not through the unit cube: a number that went back to nominal may lie outside it.
    table = exact_candidate(result.problem, result.values)[None]
    return kernel.split(kernel.readings(table, result.problem.offsets(x, runs))[0])


def exact_candidate(problem: FitProblem, values: FloatArray) -> FloatArray:
    """Numbers for the kernel of exactly these parameter values, (n,) to (fields,)."""
    return problem.servo_values(values).array()


def _below(law: str) -> tuple[str, ...]:
    order: list[str] = []
    for below in _BELOW[law]:
        order += [one for one in (*_below(below), below) if one not in order]
    return tuple(order)


def _pair(found: tuple[FitProblem, Solved]) -> tuple[FitProblem, FloatArray]:
    return found[0], found[1].x


def _named(tell: Tell, law: str) -> Tell:
    return lambda stage, count, best: tell(f"{law} {stage}", count, best)


def _drop_unexcited(
    problem: FitProblem, kernel: BenchKernel, values: FloatArray, weighed: Evidence
) -> tuple[FloatArray, int]:
    """Numbers the logs do not speak of, and delays on their bound, go back to nominal unless the cost objects.

    Returns:
        The values, shape (n,), and the number of evaluations used.
    """

    def cost(point: FloatArray) -> float:
        x = problem.to_unit(point)[None]
        return float(kernel.costs(exact_candidate(problem, point)[None], problem.offsets(x, kernel.runs))[0])

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


def _with_restarts(problem: FitProblem, weighed: Evidence, solved: Solved) -> Evidence:
    """Intervals that hold what every other start found that fits the logs about as well.

    Where the cost is rough (an arm that sticks in one place or the next) a slope at one point knows nothing of it.
    """
    # After multiple shooting no restart is as good: their starts are as measured.
    alike = [solved.x, *(one.x for one in solved.restarts if one.cost <= solved.cost * (1.0 + AGREE))]
    found = np.array([problem.from_unit(x) for x in alike])
    estimates = tuple(
        widened(one, free, float(column.min()), float(column.max()))
        for one, free, column in zip(weighed.estimates, problem.free, found.T, strict=True)
    )
    return replace(weighed, estimates=estimates)


def _restated(weighed: Evidence, values: FloatArray) -> Evidence:
    estimates = tuple(
        replace(one, value=float(value), low=min(one.low, float(value)), high=max(one.high, float(value)))
        for one, value in zip(weighed.estimates, values, strict=True)
    )
    return replace(weighed, estimates=estimates)

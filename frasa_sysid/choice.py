"""Which friction law and which effects: chosen by the error on runs that were held out, not by the fit's own.

Runs are held out by rig, by gain and by trajectory in turn. A richer model is taken only if its held-out
error is lower by more than `WORTH` and a paired one-sided t test over the folds says that it is no
accident; among laws the simplest one that no other beats in that way wins. Errors are compared as
ratios: a fold without any torque-off run is ten times harder than the others and would drown them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import stats

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.finish import finish
from frasa_sysid.fit import ladder, misfits, with_law
from frasa_sysid.pieces import independent
from frasa_sysid.problem import FitProblem, possible, several_loads
from frasa_sysid.recording import FloatArray
from frasa_sysid.restarts import Solved, Tell, point_of, solve
from frasa_sysid.rig import BenchRun
from frasa_sysid.search import Stop
from frasa_sysid.spread import Spread

WORTH = 0.02  # relative gain in held-out error below which a richer model is not worth its numbers
# Effects are ten to choose from, so that one of them is better by a little, and by accident, more often than not.
WORTH_OF_EFFECT = 0.05
SIGNIFICANCE = 0.05
_FOLDS = 4  # of each kind at most
_ITERATIONS = 8  # of the finisher for each fold, from the solution on all runs
_PROMISING = 0.01  # relative gain in training cost below which an effect is not tried further


@dataclass(frozen=True)
class Fold:
    """Runs that are held out together.

    Attributes:
        kind: `rig`, `gain` or `trajectory`.
        label: which.
        held: indices of the runs.
    """

    kind: str
    label: str
    held: tuple[int, ...]


@dataclass(frozen=True)
class Trial:
    """One model weighed.

    Attributes:
        law: friction law.
        effects: switched on.
        numbers: free parameters.
        train: mean absolute error on all training runs [rad].
        held_out: geometric mean over folds of the mean absolute error on the fold's held-out runs [rad].
        by_fold: the same by fold [rad], in the order of `Choice.folds`.
        p_value: of the paired test against the model it competes with; NaN where there is none.
        against: that model, as text.
    """

    law: str
    effects: tuple[str, ...]
    numbers: int
    train: float
    held_out: float
    by_fold: tuple[float, ...]
    p_value: float = float("nan")
    against: str = ""


@dataclass(frozen=True)
class Choice:
    """What was chosen and why.

    Attributes:
        problem: with the chosen law and effects.
        x: its solution, a point of the unit cube.
        laws: a trial for each law, with the chosen effects.
        effects: trials of the effects that were tried on the way.
        folds: what was held out.
        reason: in words.
        evaluations: candidates simulated on all runs.
    """

    problem: FitProblem
    x: FloatArray
    laws: tuple[Trial, ...]
    effects: tuple[Trial, ...]
    folds: tuple[Fold, ...]
    reason: str
    evaluations: int


def choose(
    problem: FitProblem,
    session: BenchSession,
    laws: Sequence[str],
    effects: Sequence[str] | None,
    spread: Spread,
    tell: Tell,
) -> Choice:
    """Choose among laws, and among effects when they are not given.

    Args:
        problem: any law; its training runs, bounds and seed count.
        session: simulates.
        laws: to choose from.
        effects: to switch on; None to choose them too.
        spread: does folds side by side.
        tell: told (stage, evaluations, best cost [rad]).
    """
    folds = folds_of(problem.train)
    used = 0
    trials: list[Trial] = []
    if effects is None:
        law = _screening_law(problem, laws)
        effects, trials, used = _choose_effects(problem, session, law, folds, spread, tell)
    base = with_law(problem, laws[0], effects)
    climbed = _ladder_of(base, session, laws, tell)
    used += sum(solved.evaluations for _, solved in climbed.values())
    weighed = {law: _weigh(*climbed[law], session, folds, spread, tell) for law in laws}
    chosen, table, reason = _simplest(weighed, folds)
    one, solved = climbed[chosen]
    return Choice(one, solved.x, tuple(table), tuple(trials), tuple(folds), reason, used)


def folds_of(runs: Sequence[BenchRun]) -> list[Fold]:
    """What to hold out in turn: rigs, gains and trajectories, at most four groups of each kind."""
    kinds: dict[str, Callable[[BenchRun], str]] = {
        "rig": lambda run: run.rig,
        "gain": lambda run: f"P{run.kp_scale / run.force_scale:.4g}" if not run.absolute else "",
        "trajectory": lambda run: run.trajectory,
    }
    found = []
    for kind, label in kinds.items():
        groups: dict[str, list[int]] = {}
        for i, run in enumerate(runs):
            groups.setdefault(label(run), []).append(i)
        if len(groups) > 1:
            found += _merged(kind, groups)
    if not found and len(runs) > 1:
        # One rig, one gain, one trajectory: repetitions are all there is to hold out.
        groups = {runs[log[0]].name: log for log in independent(runs)}
        found = _merged("run", groups)
    return found


def _merged(kind: str, groups: dict[str, list[int]]) -> list[Fold]:
    names = sorted(groups)
    parts = [names[i :: min(_FOLDS, len(names))] for i in range(min(_FOLDS, len(names)))]
    return [Fold(kind, ", ".join(part), tuple(i for name in part for i in groups[name])) for part in parts]


def _screening_law(problem: FitProblem, laws: Sequence[str]) -> str:
    wanted = "m4" if several_loads(problem.train) else "m2"
    return wanted if wanted in laws else laws[-1]


def _choose_effects(
    problem: FitProblem, session: BenchSession, law: str, folds: Sequence[Fold], spread: Spread, tell: Tell
) -> tuple[tuple[str, ...], list[Trial], int]:
    """Effects one by one, the most promising first, as long as the held-out error says so."""
    chosen: tuple[str, ...] = ()
    start = with_law(problem, law, chosen)
    climbed = _whole_ladder(start, session, _needed(law), tell)
    best = climbed[law]
    used = sum(solved.evaluations for _, solved in climbed.values())
    score = _weigh(*best, session, folds, spread, tell)
    trials = [score]
    waiting = [name for name in possible(problem.train) if name not in chosen]
    while waiting:
        tried = {name: _extended(best, session, (*chosen, name), tell) for name in waiting}
        used += sum(solved.evaluations for _, solved in tried.values())
        promising = sorted(waiting, key=lambda name: tried[name][1].cost)
        accepted = None
        for name in promising:
            if tried[name][1].cost > best[1].cost * (1.0 - _PROMISING):
                break
            trial = _compared(_weigh(*tried[name], session, folds, spread, tell), score, folds)
            trials.append(trial)
            if _beats(trial, score, WORTH_OF_EFFECT):
                accepted, score = name, replace(trial, p_value=float("nan"), against="")
                break
        # What did nothing for the fit now will not do more beside another effect.
        waiting = [n for n in waiting if n != accepted and tried[n][1].cost < best[1].cost * (1.0 - _PROMISING)]
        if accepted is None:
            break
        chosen, best = (*chosen, accepted), tried[accepted]
    return chosen, trials, used


def _extended(
    best: tuple[FitProblem, Solved], session: BenchSession, effects: tuple[str, ...], tell: Tell
) -> tuple[FitProblem, Solved]:
    problem = with_law(best[0], best[0].law, effects)
    nested = [point_of(problem, best[0], best[1].x)]
    name = f"{problem.law} with {', '.join(effects)}"
    solved = solve(problem, session, nested=nested, tell=lambda s, c, b: tell(f"{name}, {s}", c, b))
    _go_on(solved)
    return problem, solved


def _ladder_of(
    base: FitProblem, session: BenchSession, laws: Sequence[str], tell: Tell
) -> dict[str, tuple[FitProblem, Solved]]:
    needed = [law for law in LAWS if law in {step for wanted in laws for step in _needed(wanted)}]
    return _whole_ladder(base, session, needed, tell)


def _whole_ladder(
    base: FitProblem, session: BenchSession, laws: Sequence[str], tell: Tell
) -> dict[str, tuple[FitProblem, Solved]]:
    """All laws of a list fitted; a choice among some of them would not be the one that was asked for."""
    found = ladder(base, session, laws, None, None, tell)
    _go_on(*(solved for _, solved in found.values()))
    return found


def _go_on(*solved: Solved) -> None:
    """End here when the user interrupted a fit.

    Raises:
        KeyboardInterrupt: the user did.
    """
    if any(one.stop is Stop.INTERRUPTED for one in solved):
        raise KeyboardInterrupt


def _needed(law: str) -> tuple[str, ...]:
    """The law and all simpler ones it starts from, in order."""
    return tuple(one for one in LAWS if one <= law)


def _weigh(
    problem: FitProblem, solved: Solved, session: BenchSession, folds: Sequence[Fold], spread: Spread, tell: Tell
) -> Trial:
    """Error of a model on all runs, and on those of each fold when fitted without them."""
    tell(f"{_name(problem.law, problem.effects)} held out", solved.evaluations, solved.cost)
    tasks = [(problem, solved.x, fold) for fold in folds]
    errors = spread.map(partial(_held_out, session=session), tasks)
    train = misfits(problem, session.kernel(problem.train), [problem.from_unit(solved.x)])[0]
    held = float(np.exp(np.mean(np.log(errors)))) if errors else float("nan")
    return Trial(problem.law, problem.effects, len(problem.free), train.mae_rad, held, tuple(errors))


def _held_out(task: tuple[FitProblem, FloatArray, Fold], session: BenchSession) -> float:
    return held_out_error(*task, session)


def held_out_error(problem: FitProblem, x: FloatArray, fold: Fold, session: BenchSession) -> float:
    """Mean absolute error on a fold's runs of a fit without them [rad].

    The fit starts from the solution on all runs, so only the basin, not the numbers, knows the held-out runs.
    """
    held = set(fold.held)
    kept = [run for i, run in enumerate(problem.train) if i not in held]
    out = [run for i, run in enumerate(problem.train) if i in held]
    part = replace(problem, train=tuple(kept), held_out=tuple(out))
    found = finish(part, session.kernel(kept), x, _ITERATIONS)
    return misfits(part, session.kernel(out), [part.from_unit(found.x)])[0].mae_rad


def _compared(trial: Trial, other: Trial, folds: Sequence[Fold]) -> Trial:
    """The trial with the p-value of its gain over another model."""
    gains = np.log(other.by_fold) - np.log(trial.by_fold)
    if len(folds) < 2 or np.ptp(gains) == 0.0:
        p_value = 0.0 if gains.size and np.all(gains > 0.0) else 1.0
    else:
        p_value = float(stats.ttest_1samp(gains, 0.0, alternative="greater").pvalue)
    return replace(trial, p_value=p_value, against=_name(other.law, other.effects))


def _beats(trial: Trial, other: Trial, worth: float = WORTH) -> bool:
    return trial.held_out < other.held_out * (1.0 - worth) and trial.p_value < SIGNIFICANCE


def _simplest(weighed: dict[str, Trial], folds: Sequence[Fold]) -> tuple[str, list[Trial], str]:
    """The simplest law that no richer one beats; every trial compared with the choice before it."""
    laws = list(weighed)
    chosen = laws[0]
    table = [weighed[chosen]]
    for law in laws[1:]:
        trial = _compared(weighed[law], weighed[chosen], folds)
        table.append(trial)
        if folds and _beats(trial, weighed[chosen]):
            chosen = law
    if not folds:
        return chosen, table, "one run only: there is nothing to hold out, so the simplest law stays"
    kinds = ", ".join(dict.fromkeys(fold.kind for fold in folds))
    reason = (
        f"{chosen}: held out by {kinds}, no richer law is better by more than {WORTH:.0%} "
        f"with p < {SIGNIFICANCE} (paired t test over {len(folds)} folds)"
    )
    return chosen, table, reason


def _name(law: str, effects: Sequence[str]) -> str:
    return " + ".join((law, *effects))

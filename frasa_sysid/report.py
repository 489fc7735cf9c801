"""The page of a fit: one HTML file, pictures inside, opens offline."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from frasa_sysid import report_figures as figures
from frasa_sysid import report_tables as tables
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, image, look
from frasa_sysid.calibration.page import Html, join, page, section, tag
from frasa_sysid.fit import FitResult, nominal_candidate, simulated
from frasa_sysid.fit_record import Extras
from frasa_sysid.pieces import count_of
from frasa_sysid.report_figures import Trace
from frasa_sysid.report_residuals import error_picture, residual_picture
from frasa_sysid.rig import BenchRun

_SHOWN = 8  # runs drawn; all of them are in the table


def write_fit_report(
    path: Path, result: FitResult, extras: Extras, session: BenchSession, beforehand: Sequence[str] = ()
) -> Path | None:
    """Write the page of a fit: errors, numbers with intervals and verdicts, traces, correlations, choices.

    Args:
        path: HTML file to make.
        result: the fit.
        extras: what was found beside it.
        session: simulates the runs that are drawn.
        beforehand: logs to record next as the recordings themselves say (`identifiability.next_logs`).

    Returns:
        The file, or None where matplotlib is not installed.
    """
    if not has_matplotlib():
        return None
    problem = result.problem
    runs = [*problem.train, *problem.held_out]
    kernel = session.kernel(runs)
    nominal = kernel.split(kernel.readings(nominal_candidate(problem)[None])[0])
    fitted = simulated(result, session, runs)
    traces = [Trace(run, {"nominal": a, "fitted": b}) for run, a, b in zip(runs, nominal, fitted, strict=True)]
    with look():
        parts = _parts(result, extras, traces, beforehand)
    write_atomic(path, page(f"{problem.servo.name}: fit of {count_of(problem.train)}", parts))
    return path


def _parts(result: FitResult, extras: Extras, traces: Sequence[Trace], beforehand: Sequence[str]) -> list[Html]:
    """The summary and all sections."""
    held = {run.name for run in result.problem.held_out}
    runs = [trace.run for trace in traces]
    errors = {
        "nominal": {**result.nominal.by_run, **result.held_out_nominal.by_run},
        "fitted": {**result.fitted.by_run, **result.held_out.by_run},
    }
    return [
        tables.summary(result, extras),
        section("Numbers", tables.parameter_table(result, extras)),
        section("What to record next", tables.record_next(result, beforehand)),
        section("Simulated over measured", trace_picture(traces, held, errors["fitted"])),
        section("Residuals", residual_picture(traces)),
        section("How the numbers move together", _correlation(result), _profiles(result)),
        section("Which friction law, which effects", _choice(result, extras)),
        section("Coulomb-viscous stand-in", tables.stand_in_text(extras.stand_in) if extras.stand_in else ""),
        section("Restarts", tables.restart_table(result), _search(result)),
        section("Error of every run", error_picture(errors, runs, held), tables.run_table(result)),
        section("What this rests on", tables.origins(result)),
    ]


def shown(runs: Sequence[BenchRun], errors: Mapping[str, float], held: set[str]) -> list[BenchRun]:
    """At most eight runs: the worst, the worst held out, then those most unlike the ones picked before.

    Args:
        runs: all of them.
        errors: by run.
        held: names of those held out.
    """
    worst = sorted(runs, key=lambda run: -errors.get(run.name, 0.0))
    picked = worst[:1] + [run for run in worst[1:] if run.name in held][:1]

    def alike(run: BenchRun) -> int:
        """How many traits it shares with those picked."""
        return sum(
            2 * (run.trajectory == other.trajectory)
            + (run.rig == other.rig)
            + (run.group == other.group)
            + ((run.name in held) == (other.name in held))
            for other in picked
        )

    while len(picked) < min(_SHOWN, len(runs)):
        names = {run.name for run in picked}
        picked.append(min((run for run in runs if run.name not in names), key=alike))
    return sorted(picked, key=lambda run: (run.name in held, run.trajectory, run.group, run.name))


def trace_picture(traces: Sequence[Trace], held: set[str], errors: Mapping[str, float]) -> Html:
    """Some of the runs, simulated over measured.

    Args:
        traces: of all runs.
        held: names of those held out.
        errors: by run, which decide what is drawn.
    """
    names = [run.name for run in shown([trace.run for trace in traces], errors, held)]
    by_name = {trace.run.name: trace for trace in traces}
    worst = max(errors, key=lambda name: errors[name]) if errors else ""
    words = "Grey where the torque is off. The error panels are scaled to the better candidate; others may leave them."
    figure = figures.trace_figure([by_name[name] for name in names], held, worst)
    picture = image(figure, "simulated over measured angle, with errors below")
    return join([tag("p", tag("small", words)), picture]) if traces else Html()


def _correlation(result: FitResult) -> Html:
    names = [one.field + (f" {one.rig}" if one.rig else "") for one in result.problem.free]
    return image(figures.correlation_figure(names, result.evidence.correlation), "correlation of the estimates")


def _profiles(result: FitResult) -> Html:
    profiles = result.evidence.profiles
    if not profiles or not result.solved.cost > 0.0:
        return Html()
    words = (
        "The most strongly tied numbers, each held at several values while all others are fitted anew. A flat curve "
        "means that the others make up for it; dashed where the rise reaches what the interval's end would give."
    )
    picture = image(figures.profile_figure(profiles, result.solved.cost), "profile likelihoods")
    return join([tag("p", words), picture])


def _choice(result: FitResult, extras: Extras) -> Html:
    choice = extras.choice
    if choice is None:
        return Html()
    words = tables.choice_table(choice, result.friction)
    # Laws are compared with the chosen effects; where only effects were chosen, these are what is compared.
    trials = choice.laws if len(choice.laws) > 1 else (*choice.effects, *choice.laws)
    if not choice.folds or not np.isfinite([trial.held_out for trial in trials]).all():
        return words
    names = [trial.law == result.friction and trial.effects == result.problem.effects for trial in trials]
    chosen = len(names) - 1 - names[::-1].index(True) if any(names) else -1
    return join([words, image(figures.choice_figure(choice, trials, chosen), "held-out errors by fold")])


def _search(result: FitResult) -> Html:
    return image(figures.search_figure(result), "cost by generation of the first search") if result.trace else Html()

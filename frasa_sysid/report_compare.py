"""The page of a comparison on the bench: nominal, models and fits, simulated over measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, look
from frasa_sysid.calibration.page import Html, card, cards, folded, join, page, section, table, tag
from frasa_sysid.cost import Misfit
from frasa_sysid.report import trace_picture
from frasa_sysid.report_figures import Trace
from frasa_sysid.report_residuals import error_picture, residual_picture
from frasa_sysid.servo_values import FIELDS, ServoValues

_ALWAYS = ("kp", "forcerange", "damping", "frictionloss", "armature", "delay")


@dataclass(frozen=True)
class ComparisonPage:
    """What the page shows.

    Attributes:
        servo: its name.
        errors: by candidate; the first is what the others are measured by.
        values: the numbers of each candidate.
        traces: of all runs, with what each candidate makes of them.
        inputs: sha256 by log.
        origin: of the logs.
        candidates: where each candidate's numbers are from.
    """

    servo: str
    errors: Mapping[str, Misfit]
    values: Mapping[str, ServoValues]
    traces: Sequence[Trace]
    inputs: Mapping[str, str]
    origin: str
    candidates: Mapping[str, str]


def write_comparison(path: Path, one: ComparisonPage) -> Path | None:
    """Write the page; None where matplotlib is not installed."""
    if not has_matplotlib():
        return None
    errors = {name: found.by_run for name, found in one.errors.items()}
    last = list(errors.values())[-1]
    runs = [trace.run for trace in one.traces]
    with look():
        parts = [
            _summary(one),
            section("Simulated over measured", trace_picture(one.traces, set(), last)),
            section("Residuals", residual_picture(one.traces)),
            section("Error of every run", error_picture(errors, runs, set()), _runs(errors)),
            section("Numbers of the candidates", _numbers(one.values)),
            section("What this rests on", _origins(one)),
        ]
    write_atomic(path, page(f"{one.servo}: simulated over measured", parts))
    return path


def _summary(one: ComparisonPage) -> Html:
    count = len(one.traces)
    words = (
        f"{count} {'run' if count == 1 else 'runs'} of {one.origin} logs of the {one.servo}, simulated from the "
        "recorded goals and initial state alone. Errors are simulated minus measured angles; every run weighs the same."
    )
    base = next(iter(one.errors.values())).mae_rad
    found = []
    for name, error in one.errors.items():
        share = base / error.mae_rad if error.mae_rad > 0.0 else 1.0
        smaller = f", {share:.1f} times smaller than {next(iter(one.errors))}" if share > 1.05 else ""
        found.append(card(name, f"{error.mae_rad * 1e3:.2f}", "mrad", f"rms {error.rmse_rad * 1e3:.2f} mrad{smaller}"))
    return join([tag("p", words), cards(found)])


def _runs(errors: Mapping[str, Mapping[str, float]]) -> Html:
    last = list(errors.values())[-1]
    order = sorted(last, key=lambda run: -last[run])
    rows = [[run, *(f"{one[run] * 1e3:.1f}" for one in errors.values())] for run in order]
    heads = ("run", *(f"{name}, mrad" for name in errors))
    return folded("As a table; a click on a head sorts", table(heads, rows, range(1, len(heads)), css="sort"))


def _numbers(values: Mapping[str, ServoValues]) -> Html:
    """The numbers every servo has, and those in which the candidates differ."""
    fields = [
        field for field in FIELDS if field in _ALWAYS or len({getattr(one, field) for one in values.values()}) > 1
    ]
    rows = [[field, *(f"{getattr(one, field):.4g}" for one in values.values())] for field in fields]
    words = "In SI units; gain and torque limit at the supply and firmware gain of the nominal model."
    return join([table(("", *values), rows, range(1, 1 + len(values))), tag("p", tag("small", words))])


def _origins(one: ComparisonPage) -> Html:
    files = table(("candidate", "file"), [[name, tag("code", file)] for name, file in one.candidates.items()])
    logs = table(("log", "sha256"), [[name, tag("code", digest)] for name, digest in one.inputs.items()])
    return join([files, logs])

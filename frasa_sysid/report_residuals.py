"""Residuals of many runs as pictures: the error of every run, how large samples are off, and when in a run."""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import TYPE_CHECKING

import numpy as np

from frasa_sysid.calibration.figures import INK, image
from frasa_sysid.calibration.page import Html, join, tag
from frasa_sysid.cost import residuals
from frasa_sysid.recording import FloatArray
from frasa_sysid.report_figures import HELD_OUT, Trace, colours_of
from frasa_sysid.rig import BenchRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS = 40  # runs whose names can be read below each other; all of them are in the table
_LONGEST = 40  # letters of a name
_BINS = 60  # of the time in a run
_LEAST = 1e-2  # [mrad] no log resolves less


def error_picture(errors: Mapping[str, Mapping[str, float]], runs: Sequence[BenchRun], held: set[str]) -> Html:
    """The error of every run, for each candidate.

    Args:
        errors: mean error by candidate, then by run [rad]; the last candidate decides the order.
        runs: what they are of.
        held: names of those held out.
    """
    last = list(errors.values())[-1]
    order = sorted(runs, key=lambda run: -last[run.name])
    shown = order[:_ROWS]
    words = "The worst first, on a logarithmic scale."
    if len(shown) < len(order):
        words += f" Shown are {len(shown)} of {len(order)} runs."
    if held:
        words += " Brown: held out."
    picture = image(error_figure(errors, shown, held), "mean error of every run, for each candidate")
    return join([tag("p", tag("small", words)), picture])


def error_figure(
    errors: Mapping[str, Mapping[str, float]], runs: Sequence[BenchRun], held: AbstractSet[str] = frozenset()
) -> "Figure":
    """The mean error of runs, a row for each, a dot for each candidate.

    Args:
        errors: by candidate, then by run [rad].
        runs: from the top down.
        held: names of those held out.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import StrMethodFormatter

    figure = Figure(figsize=(11, 0.21 * len(runs) + 0.9), layout="constrained")
    ax = figure.subplots()
    places = np.arange(len(runs))
    values = np.array([[max(one[run.name] * 1e3, _LEAST) for run in runs] for one in errors.values()])
    ax.hlines(places, values.min(axis=0), values.max(axis=0), color="#b9c3cd", lw=1.4, zorder=1)
    for (name, colour), row in zip(colours_of(list(errors)).items(), values, strict=True):
        ax.plot(row, places, "o", ms=4.5, color=colour, label=name)
    ax.set_yticks(places, [_label(run) for run in runs])
    for label, run in zip(ax.get_yticklabels(), runs, strict=True):
        label.set_color(HELD_OUT if run.name in held else INK)
    ax.set_ylim(len(runs) - 0.4, -0.6)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.set_xlabel("mean error, mrad")
    figure.legend(loc="outside upper left", ncols=6, frameon=False)
    return figure


def _label(run: BenchRun) -> str:
    """What was done in a run, and its name."""
    name = run.name if len(run.name) <= _LONGEST else f"…{run.name[1 - _LONGEST :]}"
    return ", ".join(one[:_LONGEST] for one in (run.trajectory, run.group) if one) + f"   {name}"


def residual_picture(traces: Sequence[Trace]) -> Html:
    """How large the residuals of all samples are, and how they grow along a run."""
    off = _residuals(traces)
    if not any(np.isfinite(one).any() for two in off.values() for one in two):
        return Html()
    return image(residual_figure(traces), "residuals of all samples")


def _residuals(traces: Sequence[Trace]) -> dict[str, list[FloatArray]]:
    """Absolute residuals [mrad] by candidate, one array for each run."""
    names = list(dict.fromkeys(name for trace in traces for name in trace.readings))
    runs = [trace.run for trace in traces]
    return {
        name: [np.abs(one) * 1e3 for one in residuals(runs, [trace.readings[name] for trace in traces])]
        for name in names
    }


def residual_figure(traces: Sequence[Trace]) -> "Figure":
    """How large the residuals of all samples of runs are, and how they grow along a run; for each candidate."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import StrMethodFormatter

    figure = Figure(figsize=(11, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    off = _residuals(traces)
    t = np.concatenate([trace.run.t for trace in traces])
    edges = np.linspace(0.0, float(t.max()), _BINS + 1)
    places = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, _BINS - 1)
    for name, colour in colours_of(list(off)).items():
        values = np.concatenate(list(off[name]))
        known = np.isfinite(values)
        if not known.any():
            continue
        ordered = np.maximum(np.sort(values[known]), _LEAST)
        shares = np.linspace(0.0, 100.0, 400)
        left.plot(np.percentile(ordered, shares), shares, color=colour, lw=1.6, label=name)
        sums, counts = (np.bincount(places[known], weights, _BINS) for weights in (values[known], None))
        with np.errstate(invalid="ignore"):
            right.plot((edges[1:] + edges[:-1]) / 2, sums / counts, color=colour, lw=1.4)
    left.set_title("All samples")
    left.set_xscale("log")
    left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    left.set_xlabel("residual, mrad")
    left.set_ylabel("samples with a smaller one, %")
    left.set_ylim(0.0, 100.0)
    left.legend(loc="lower right")
    right.set_title("Mean over the runs")
    right.set_yscale("log")
    right.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    right.set_xlabel("time in the run, s")
    right.set_ylabel("mean residual, mrad")
    return figure

"""Plots of the report pages: drawn by matplotlib, put into the page as pictures."""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from frasa_sysid.calibration.figures import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, SKY
from frasa_sysid.choice import Choice, Trial
from frasa_sysid.fit import FitResult
from frasa_sysid.recording import FloatArray
from frasa_sysid.resampling import Profile
from frasa_sysid.rig import BenchRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

READABLE = 25  # parameters whose names and numbers fit into a map
_WITH_NUMBERS = 18  # of which every cell can hold one
KNOWN = {"nominal": RED, "before": RED, "fitted": BLUE}
OTHERS = (BLUE, GREEN, PURPLE, ORANGE, SKY, GREY)
HELD_OUT = "#8a5200"


@dataclass(frozen=True)
class Trace:
    """One run with what candidates make of it.

    Attributes:
        run: measured.
        readings: simulated angle [rad] at the run's times, by candidate name, shape (T,) each.
    """

    run: BenchRun
    readings: Mapping[str, FloatArray]


def colours_of(names: Sequence[str]) -> dict[str, str]:
    """A colour for each candidate: what was there before in red, what was found in blue, others as they come."""
    known = {name: KNOWN[name] for name in names if name in KNOWN}
    others = cycle([one for one in OTHERS if one not in known.values()])
    return {name: known.get(name) or next(others) for name in names}


def legend_above(figure: "Figure", axes: "Sequence[Axes]") -> None:
    """One legend over all panels, with whatever any of them shows."""
    found: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), loc="outside upper left", ncols=6, frameon=False)


def trace_figure(traces: Sequence[Trace], held: AbstractSet[str] = frozenset(), worst: str = "") -> "Figure":
    """Simulated over measured, the residuals below each; torque-off time is shaded.

    Args:
        traces: two beside each other.
        held: names of runs that were held out.
        worst: name of the run with the largest error.
    """
    from matplotlib.figure import Figure

    rows = (len(traces) + 1) // 2
    figure = Figure(figsize=(11, 3.1 * rows + 0.3), layout="constrained")
    names = list(dict.fromkeys(name for trace in traces for name in trace.readings))
    colours = colours_of(names)
    cells = np.ravel(figure.subfigures(rows, 2, squeeze=False, hspace=0.02))
    for cell, trace in zip(cells, traces, strict=False):
        above, below = cell.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (2.6, 1)})
        _draw(above, below, trace, colours)
        kind = ["held out"] if trace.run.name in held else []
        kind += ["worst run"] if trace.run.name == worst else []
        # Another colour, so that what was never fitted is seen at a glance.
        above.set_title(" - ".join([_title(trace), *kind]), color=HELD_OUT if kind else INK)
    legend_above(figure, [cell.axes[0] for cell in cells if cell.axes])
    return figure


def _draw(above: "Axes", below: "Axes", trace: Trace, colours: Mapping[str, str]) -> None:
    run = trace.run
    above.plot(run.t, run.y, color="black", lw=2.4, alpha=0.4, label="measured")
    below.axhline(0.0, color="black", lw=0.7, alpha=0.5)
    largest = []
    for name, reading in trace.readings.items():
        residual = (reading - run.y) * 1e3
        above.plot(run.t, reading, lw=1.1, color=colours[name], label=name)
        below.plot(run.t, residual, lw=0.9, color=colours[name])
        largest.append(float(np.abs(residual[np.isfinite(residual)]).max(initial=0.0)))
    # A residual far beyond the best one's is cut off, for the best one is what the page is about.
    limit = min(3.0 * min(largest, default=1.0), max(largest, default=1.0)) * 1.1 + 1.0
    below.set_ylim(-limit, limit)
    spread = max(float(np.ptp(run.y)), 0.02)
    above.set_ylim(run.y.min() - 0.3 * spread, run.y.max() + 0.3 * spread)
    label = "torque off"
    for start, end in unpowered(run):
        for ax in (above, below):
            ax.axvspan(start, end, color="#9aa7b5", alpha=0.2, lw=0, label=label if ax is above else None)
        label = ""
    above.set_ylabel("angle, rad")
    below.set_ylabel("error, mrad")
    below.set_xlabel("time, s")
    for ax in (above, below):
        ax.margins(x=0.01)


def unpowered(run: BenchRun) -> list[tuple[float, float]]:
    """Times [s] from when to when the motor is off."""
    edges = [0.0, *(float(np.clip(one, 0.0, run.t[-1])) for one in run.switches), float(run.t[-1])]
    first = 1 if run.powered_first else 0
    return [(a, b) for a, b in zip(edges[first::2], edges[first + 1 :: 2], strict=False) if b > a]


def _title(trace: Trace) -> str:
    run = trace.run
    last = list(trace.readings.values())[-1]
    error = float(np.mean(np.abs(last - run.y))) * 1e3
    return f"{run.trajectory or run.name}, {run.group.replace('kg', ' kg').replace('m ', ' m ')}: {error:.1f} mrad"


def correlation_figure(names: Sequence[str], correlation: FloatArray) -> "Figure":
    """How estimates move together; names and numbers where there is room for them."""
    from matplotlib.figure import Figure

    n = len(names)
    size = float(np.clip(2.4 + 0.36 * n, 4.0, 9.0))
    figure = Figure(figsize=(size + 0.9, size))
    figure.set_layout_engine("constrained", w_pad=0.15)  # [inch] the longest name fills its margin otherwise
    ax = figure.subplots()
    picture = ax.imshow(correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    ax.grid(visible=False)
    if n <= READABLE:
        ax.set_xticks(range(n), names, rotation=45, ha="right", rotation_mode="anchor")
        ax.set_yticks(range(n), names)
    else:
        ax.set_xlabel("parameters in the order of the table")
    if n <= _WITH_NUMBERS:
        for (i, j), value in np.ndenumerate(correlation):
            if i != j and abs(value) >= 0.1:
                ax.text(j, i, f"{value:.1f}", ha="center", va="center", fontsize=7, color=_over(value))
    figure.colorbar(picture, ax=ax, shrink=0.8)
    return figure


def _over(value: float) -> str:
    """A text colour that is seen on the map's own."""
    return "white" if abs(value) > 0.6 else INK


def profile_figure(profiles: Sequence[Profile], cost: float) -> "Figure":
    """By how much of itself the cost rises while one number is held away from the fit."""
    from matplotlib.figure import Figure

    columns = min(len(profiles), 3)
    rows = -(-len(profiles) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.7 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, one in zip(axes, profiles, strict=False):
        ax.plot(one.values, 100.0 * np.array(one.rise) / cost, "o-", color=BLUE, ms=4, lw=1.3)
        for limit in (one.low, one.high):
            if limit is not None:
                ax.axvline(limit, color=ORANGE, lw=1.0, ls="--")
        ax.set_title(f"{one.name}\nheld; most tied to {one.partner}")
        ax.set_ylabel("rise of the cost, %")
        ax.locator_params(axis="x", nbins=5)
    for ax in axes[len(profiles) :]:
        ax.set_visible(False)
    return figure


def choice_figure(choice: Choice, trials: Sequence[Trial], chosen: int) -> "Figure":
    """Held-out error of every model, fold by fold; the chosen one stands out."""
    from matplotlib.figure import Figure

    labels = [f"{fold.kind}\n{_wrapped(fold.label)}" for fold in choice.folds]
    table = np.array([trial.by_fold for trial in trials]) * 1e3
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    ax = figure.subplots()
    places, width = np.arange(len(labels)), 0.8 / len(trials)
    for i, (trial, errors) in enumerate(zip(trials, table, strict=True)):
        shade = BLUE if i == chosen else str(0.86 - 0.4 * i / len(trials))
        name = " + ".join((trial.law, *trial.effects)) + (" (chosen)" if i == chosen else "")
        ax.bar(places + (i - (len(trials) - 1) / 2) * width, errors, width * 0.92, color=shade, label=name)
    if table.min() > 0.0 and table.max() > 8.0 * table.min():
        _set_log(ax)
        ax.set_ylim(bottom=0.6 * table.min())
    ax.set_xticks(places, labels)
    ax.set_ylabel("held-out error, mrad")
    ax.grid(visible=False, axis="x")
    columns = min(len(trials), 6)
    legend = ax.legend(fontsize=8, ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)
    return figure


def _wrapped(label: str, longest: int = 48) -> str:
    short = label if len(label) <= longest else label[: longest - 1] + "…"
    return short.replace(", ", ",\n").replace("kg ", " kg ")


def _set_log(ax: "Axes") -> None:
    """A logarithmic axis upwards that says 1, 2, 5, 10 and not powers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def search_figure(result: FitResult) -> "Figure":
    """How the first search went."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 2.6), layout="constrained")
    ax = figure.subplots()
    ax.plot(np.arange(1, len(result.trace) + 1), np.array(result.trace) * 1e3, color=BLUE, lw=1.4)
    _set_log(ax)
    ax.set_xlabel("generation of CMA-ES")
    ax.set_ylabel("robust cost, mrad")
    ax.grid(which="both")
    return figure

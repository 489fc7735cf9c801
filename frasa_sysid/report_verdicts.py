"""Fits side by side as pictures: the intervals of their numbers, and the verdict on each."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from frasa_sysid.calibration.figures import GREEN, INK, ORANGE, PURPLE, SKY
from frasa_sysid.evidence import IDENTIFIED, ON_BOUND, ROUGH, Estimate
from frasa_sysid.report_figures import colours_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 4
_SMALL = {"s": ("ms", 1e3), "rad": ("mrad", 1e3)}  # unit that these are read in, and its factor
# What a verdict begins with, its colour and its text's; the unsure ones lighter, so that what is known stands out.
_VERDICTS = {
    IDENTIFIED: (GREEN, "white"),
    ROUGH: (SKY, INK),
    "only in combination": (ORANGE, INK),
    ON_BOUND: (PURPLE, INK),
    "not excited": ("#c9d0d8", INK),
}


def estimate_figure(
    cases: Mapping[str, Sequence[Estimate]],
    truth: Mapping[str, float] | None = None,
    names: Sequence[str] | None = None,
) -> "Figure":
    """The 95 % interval of every number in every fit, a panel for each number; full dots are identified.

    Args:
        cases: estimates by the fit's name.
        truth: by parameter, where it is known: drawn as a line.
        names: parameters to show; by default all of the first fit.
    """
    from matplotlib.figure import Figure

    shown = list(names or [one.name for one in next(iter(cases.values()))])
    rows = -(-len(shown) // _COLUMNS)
    figure = Figure(figsize=(11, (0.55 + 0.17 * len(cases)) * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for ax, name in zip(axes, shown, strict=False):
        found = {case: one for case, several in cases.items() for one in several if one.name == name}
        _intervals(ax, list(cases), found, (truth or {}).get(name))
        ax.set_title(name)
    for ax in axes[len(shown) :]:
        ax.set_visible(False)
    handles = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=6, frameon=False)
    return figure


def _intervals(ax: "Axes", cases: Sequence[str], found: Mapping[str, Estimate], truth: float | None) -> None:
    unit, scale = "", 1.0
    for place, (case, colour) in enumerate(colours_of(cases).items()):
        # An empty line keeps the legend whole where a fit has no such number.
        ax.plot([], [], "-o", ms=5, color=colour, label=case)
        if case not in found:
            continue
        one = found[case]
        unit, scale = _SMALL.get(one.unit, (one.unit, 1.0))
        ax.plot(np.array([one.low, one.high]) * scale, [place, place], color=colour, lw=2.2, solid_capstyle="butt")
        face = colour if one.verdict == IDENTIFIED else "white"
        ax.plot(one.value * scale, place, "o", ms=5.5, color=colour, markerfacecolor=face)
    if truth is not None:
        ax.axvline(truth * scale, color=INK, lw=1.1, ls="--", label="truth", zorder=0)
    ax.set_ylim(len(cases) - 0.4, -0.6)
    ax.set_yticks([])
    ax.grid(visible=False, axis="y")
    ax.locator_params(axis="x", nbins=4)
    ax.set_xlabel(unit)


def verdict_figure(cases: Mapping[str, Sequence[Estimate]]) -> "Figure":
    """What each fit knows of each number: its verdict as a colour, half of its interval in words.

    Args:
        cases: estimates by the fit's name; one that a fit has not stays empty.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch, Rectangle

    names = list(dict.fromkeys(one.name for several in cases.values() for one in several))
    figure = Figure(figsize=(min(2.1 + 1.45 * len(cases), 11), 0.31 * len(names) + 1.1), layout="constrained")
    ax = figure.subplots()
    for column, several in enumerate(cases.values()):
        for one in several:
            row = names.index(one.name)
            back, front = _VERDICTS[kind_of(one.verdict)]
            ax.add_patch(Rectangle((column - 0.48, row - 0.46), 0.96, 0.92, color=back, lw=0))
            ax.text(column, row, half_width(one), ha="center", va="center", fontsize=7.5, color=front)
    ax.set_xlim(-0.5, len(cases) - 0.5)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xticks(range(len(cases)), list(cases))
    ax.xaxis.tick_top()
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    handles = [Patch(color=colour, label=verdict) for verdict, (colour, _) in _VERDICTS.items()]
    figure.legend(handles=handles, loc="outside lower left", ncols=5, frameon=False)
    return figure


def kind_of(verdict: str) -> str:
    """A verdict without what it names: the beginning that all of its kind share."""
    return next(kind for kind in _VERDICTS if verdict.startswith(kind))


def half_width(one: Estimate) -> str:
    """Half of an interval: in per cent of the value, or in milliseconds and milliradians; of what is known at all."""
    if not one.excited:
        return "unknown"  # its interval ends at the bounds of the search, and means nothing
    half = (one.high - one.low) / 2
    if one.unit in _SMALL:
        unit, scale = _SMALL[one.unit]
        return f"± {_short(half * scale)} {unit}"
    if abs(one.value) <= 0.0 or half > 2.0 * abs(one.value):
        return f"± {half:.1g} {one.unit}"
    return f"± {_short(100 * half / abs(one.value))} %"


def _short(value: float) -> str:
    """Two digits, and no powers of ten."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"

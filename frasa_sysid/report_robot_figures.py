"""Plots of whole robots: joints and trunk over time, simulated over measured, and the size of residuals by joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from frasa_sysid.calibration.figures import INK, ORANGE
from frasa_sysid.recording import FloatArray
from frasa_sysid.report_figures import colours_of, legend_above
from frasa_sysid.robot_errors import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WINDOW = 8.0  # [s] of a trace that is drawn; more cannot be told apart on a page


@dataclass(frozen=True)
class Panel:
    """One joint or axis of one run, as several robots have it.

    Attributes:
        title: over the panel.
        label, unit: of the upper axis.
        small, scale: unit of the residual, and its factor on the measured unit.
        series: by robot; the same samples of all.
        held_from: when the part begins that was held out [s]; None where none was.
    """

    title: str
    label: str
    unit: str
    small: str
    scale: float
    series: Mapping[str, Series]
    held_from: float | None = None


def window_of(one: Series) -> tuple[float, float]:
    """The stretch to draw [s]: around the piece that is simulated worst."""
    pieces = np.unique(one.piece)
    means = [float(np.mean(np.abs(one.residuals[one.piece == piece]))) for piece in pieces]
    worst = one.t[one.piece == pieces[int(np.argmax(means))]]
    start = max(min(float(worst.mean()) - WINDOW / 2, float(one.t[-1]) - WINDOW), float(one.t[0]))
    return start, min(start + WINDOW, float(one.t[-1]))


def panel_figure(panels: Sequence[Panel]) -> "Figure":
    """Simulated over measured, the residuals below each; lines break where a piece starts from the measurement."""
    from matplotlib.figure import Figure

    rows = (len(panels) + 1) // 2
    figure = Figure(figsize=(11, 3.1 * rows + 0.3), layout="constrained")
    colours = colours_of(list(dict.fromkeys(name for panel in panels for name in panel.series)))
    cells = np.ravel(figure.subfigures(rows, 2, squeeze=False, hspace=0.02))
    for cell, panel in zip(cells, panels, strict=False):
        above, below = cell.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (2.6, 1)})
        _draw(above, below, panel, colours)
        above.set_title(panel.title, color=INK)
    legend_above(figure, [cell.axes[0] for cell in cells if cell.axes])
    return figure


def _draw(above: "Axes", below: "Axes", panel: Panel, colours: Mapping[str, str]) -> None:
    first = next(iter(panel.series.values()))
    start, end = window_of(list(panel.series.values())[-1])
    shown = (first.t >= start) & (first.t <= end)
    above.plot(first.t[shown], first.y[shown], color="black", lw=2.4, alpha=0.4, label="measured")
    below.axhline(0.0, color="black", lw=0.7, alpha=0.5)
    largest = []
    for name, one in panel.series.items():
        part = (one.t >= start) & (one.t <= end)
        residual = one.residuals[part] * panel.scale
        above.plot(*_broken(one, part, one.y[part] + one.residuals[part]), lw=1.1, color=colours[name], label=name)
        below.plot(*_broken(one, part, residual), lw=0.9, color=colours[name])
        largest.append(float(np.percentile(np.abs(residual), 99.5)))
    # A residual far beyond the best one's is cut off, for the best one is what the page is about.
    limit = max(min(3.0 * min(largest), max(largest)) * 1.15, 1e-3)
    below.set_ylim(-limit, limit)
    spread = max(float(np.ptp(first.y[shown])), 0.02)
    above.set_ylim(first.y[shown].min() - 0.3 * spread, first.y[shown].max() + 0.3 * spread)
    if panel.held_from is not None and panel.held_from < end:
        for ax in (above, below):
            label = "held out" if ax is above else None
            ax.axvspan(max(panel.held_from, start), end, color=ORANGE, alpha=0.12, lw=0, label=label)
    above.set_ylabel(f"{panel.label}, {panel.unit}")
    below.set_ylabel(f"error, {panel.small}")
    below.set_xlabel("time, s")
    for ax in (above, below):
        ax.margins(x=0.01)


def _broken(
    one: Series, part: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]", values: FloatArray
) -> list[FloatArray]:
    """Times and values with a gap between pieces."""
    edges = np.flatnonzero(np.diff(one.piece[part])) + 1
    return [np.insert(one.t[part], edges, one.t[part][edges]), np.insert(values, edges, np.nan)]


def residual_figure(errors: Mapping[str, Mapping[str, float]]) -> "Figure":
    """Mean error of the position of every joint.

    Args:
        errors: by robot, then by joint [rad].
    """
    from matplotlib.figure import Figure

    joints = list(next(iter(errors.values())))
    figure = Figure(figsize=(11, 0.26 * len(joints) + 1.0), layout="constrained")
    ax = figure.subplots()
    colours = colours_of(list(errors))
    height = 0.8 / len(errors)
    places = np.arange(len(joints))
    for i, (name, one) in enumerate(errors.items()):
        lengths = [one.get(joint, 0.0) * 1e3 for joint in joints]
        ax.barh(places + (i - (len(errors) - 1) / 2) * height, lengths, height * 0.92, color=colours[name], label=name)
    ax.set_yticks(places, joints)
    ax.invert_yaxis()
    ax.set_xlabel("mean error of the position, mrad")
    ax.grid(visible=False, axis="y")
    ax.legend()
    return figure

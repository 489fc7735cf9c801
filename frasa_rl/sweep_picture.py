"""The paper's figure of many agents: return and held-out success against steps and minutes, and how they spread."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frasa_rl.config import Task
from frasa_rl.curve import still_return
from frasa_rl.sweep_table import Curve, curve, spread
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import BLUE, RED, look

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE_FILE = "sweep.png"
_COLOURS = {"return": BLUE, "success": RED}
_LABELS = {"return": "return of an episode", "success": "held-out falls that end standing, %"}
_AXES = {"steps": "transitions", "minutes": "training time, min"}


def draw_sweep(out: Path, runs: Sequence[Path], task: Task) -> Path | None:
    """Draw sweep.png: median, quartiles and range of all agents, and each agent thin; None without rows.

    Range and quartiles are drawn as long as all agents are there. Later, while at least half of them are, the median
    goes on dashed: who stops early may be the best, so that it is no longer that of all.

    Args:
        out: the folder of the sweep.
        runs: folders of its agents.
        task: that they learned.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    content = io.BytesIO()
    with look():
        figure = sweep_figure(runs, task)
        if figure is None:
            return None
        figure.savefig(content, dpi=120, format="png")
    write_atomic(out / PICTURE_FILE, content.getvalue())
    return out / PICTURE_FILE


def sweep_figure(runs: Sequence[Path], task: Task) -> "Figure | None":
    """The figure, to be drawn inside `look`; None without rows."""
    from matplotlib.figure import Figure  # no pyplot: no window, no global state

    panels = {(what, against): _curves(runs, what, against) for what in _LABELS for against in _AXES}
    many = len(panels["return", "steps"])
    if not many:
        return None
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for one, ((what, _), curves) in zip(axes.flat, panels.items(), strict=True):
        _panel(one, curves, _COLOURS[what])
    _references(axes, task)
    for one, label in zip(axes[:, 0], _LABELS.values(), strict=True):
        one.set_ylabel(label)
    for one, label in zip(axes[1], _AXES.values(), strict=True):
        one.set_xlabel(label)
        one.set_xlim(0.0, None)
    axes[1, 0].xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}k" if value else "0")
    axes[1, 0].set_ylim(-2, 102)
    for one in axes[:, 1]:
        if one.get_legend_handles_labels()[0]:
            one.legend(loc="best")
    figure.suptitle(f"{many} agent{'s' if many > 1 else ''}")
    return figure


def _curves(runs: Sequence[Path], what: str, against: str) -> list[Curve]:
    found = [curve(one, what, against) for one in runs]
    return [(x, y if what == "return" else 100.0 * y) for x, y in found if len(x)]


def _panel(axes: Any, curves: Sequence[Curve], colour: str) -> None:  # noqa: ANN401 - matplotlib is untyped
    """One panel: bands behind, agents thin, the median in front."""
    for x, y in curves:
        axes.plot(x, y, color=colour, lw=0.6, alpha=0.45, marker="." if len(x) < 12 else None, ms=3)
    if len(curves) < 2:
        return
    all_of = spread(curves)
    whole = all_of.count == len(curves)
    half = all_of.count >= max(2, (len(curves) + 1) // 2)
    least, lower, median, upper, most = (np.where(whole, level, np.nan) for level in all_of.levels)
    axes.fill_between(all_of.x, least, most, color=colour, alpha=0.13, lw=0, label="least to most")
    axes.fill_between(all_of.x, lower, upper, color=colour, alpha=0.28, lw=0, label="quartiles")
    axes.plot(all_of.x, median, color=colour, lw=2.0, label="median")
    if (half & ~whole).any():
        later = np.where(half, all_of.levels[2], np.nan)
        axes.plot(all_of.x, later, color=colour, lw=1.2, ls="--", label="median of those left", zorder=1.9)


def _references(axes: Any, task: Task) -> None:  # noqa: ANN401 - matplotlib is untyped
    """What lying still is worth, and the shares that sweep.csv has the times of."""
    still = still_return(task)
    for one in axes[0]:
        one.axhline(still, color="0.35", ls=":", lw=1.2, label=f"lying still: at most {still:.0f}")
    for one in axes[1]:
        for share in (50.0, 90.0):
            one.axhline(share, color="0.35", ls=":", lw=1.0)

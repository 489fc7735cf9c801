"""How a run learned, as a picture: return and success against steps and minutes."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from frasa_rl.config import Task
from frasa_rl.policy import RUN_FILE, read_run
from frasa_rl.tables import EVALUATIONS, PROGRESS, Table
from frasa_rl.task_file import task_from
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import BLUE, GREEN, GREY, INK, RED, SOFT, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CURVE_FILE = "learning_curve.png"
_AXES = {"steps": "transitions", "minutes": "training time, min"}
_SIDES = {"prone": ("v", RED), "supine": ("^", GREEN)}


def still_return(task: Task) -> float:
    """The most a robot earns in a whole episode without ever nearing the pose: all terms but posture.

    A return below or around it says that the agent learned to keep still, not to stand.
    """
    weights = task.reward
    return (weights.action + weights.variation + weights.self_contact) * task.episode_s / task.control_period_s


def _task_of(run: Path) -> Task:
    path = run / RUN_FILE
    return task_from(read_run(path).get("task", {}), str(path)) if path.is_file() else Task()


def draw_curve(run: Path) -> Path | None:
    """Write learning_curve.png; None without rows.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    if not PROGRESS.read(run):
        return None
    content = io.BytesIO()
    with look():
        curve_figure(run).savefig(content, dpi=120, format="png")
    write_atomic(run / CURVE_FILE, content.getvalue())
    return run / CURVE_FILE


def curve_figure(run: Path) -> "Figure":
    """Return and success of training and of held-out falls, against steps and minutes; drawn inside `look`."""
    from matplotlib.figure import Figure  # no pyplot: no window, no global state

    rows, tried = _columns(PROGRESS, run), _columns(EVALUATIONS, run)
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (against, label) in enumerate(_AXES.items()):
        above, below = axes[:, column]
        above.plot(rows[against], rows["return"], color=BLUE, lw=1.5, label="mean of the last 100 episodes")
        below.plot(rows[against], 100.0 * rows["success"], color=GREY, lw=1.0, label="episodes of training")
        for side, (mark, colour) in _SIDES.items():
            shares = 100.0 * tried[f"success_{side}"]
            below.plot(tried[against], shares, color=colour, marker=mark, ms=5, lw=1.3, label=f"held-out falls, {side}")
        best = tried[against][tried["best"] == 1.0]
        for one in (above, below) if len(best) else ():
            one.axvline(best[-1], color=INK, ls=":", lw=1.1, label="published policy")
        below.set_xlabel(label)
        below.set_xlim(0.0, None)
    _levels(axes[0], _task_of(run))
    axes[0, 0].set_ylabel("return of an episode")
    axes[1, 0].set_ylabel("end standing, %")
    axes[1, 0].set_ylim(-3, 103)
    axes[1, 0].xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}k" if value else "0")
    axes[0, 0].legend(loc="best")
    axes[1, 0].legend(loc="best")
    return figure


def _levels(axes: "Sequence[Axes]", task: Task) -> None:
    """What lying still is worth, and the most that can be had."""
    still = still_return(task)
    most = still + task.reward.posture * task.episode_s / task.control_period_s
    for one in axes:
        one.axhline(still, color=SOFT, ls="--", lw=1.0, label=f"lying still: at most {still:.0f} (of {most:.0f})")


def _columns(table: Table, run: Path) -> dict[str, npt.NDArray[np.float64]]:
    """The columns of a table, shape (rows,) each."""
    rows = np.array(table.read(run), dtype=np.float64).reshape(-1, len(table.columns))
    return dict(zip(table.columns, rows.T, strict=True))

"""The learning curve of a run as a picture."""

from pathlib import Path

from frasa_rl.config import Task
from frasa_rl.policy import RUN_FILE, read_run
from frasa_rl.tables import EVALUATIONS, PROGRESS
from frasa_rl.task_file import task_from


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
    """Return and shares of episodes and held-out falls ending upright against minutes; None without rows.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    from matplotlib.figure import Figure  # no pyplot: no window, no global state

    rows = PROGRESS.read(run)
    if not rows:
        return None
    columns = dict(zip(PROGRESS.columns, zip(*rows, strict=True), strict=True))
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    left = figure.subplots()
    left.plot(columns["minutes"], columns["return"], color="tab:blue")
    task = _task_of(run)
    still, most = still_return(task), task.reward.posture * task.episode_s / task.control_period_s + still_return(task)
    left.axhline(still, color="tab:blue", ls="--", lw=1.0, label=f"lying still: at most {still:.0f}")
    left.legend(loc="lower right")
    left.set(xlabel="training time [min]", ylabel=f"return of an episode (at most {most:.0f})", title=run.name)
    left.grid(alpha=0.3)
    right = left.twinx()
    right.plot(columns["minutes"], [100.0 * one for one in columns["success"]], color="tab:green", label="training")
    evaluated = dict(zip(EVALUATIONS.columns, zip(*EVALUATIONS.read(run), strict=True), strict=False))
    for side, mark in (("prone", "v"), ("supine", "^")):
        if evaluated:
            shares = [100.0 * one for one in evaluated[f"success_{side}"]]
            right.plot(
                evaluated["minutes"], shares, color="tab:red", lw=0.8, marker=mark, ms=4, label=f"held-out, {side}"
            )
    right.legend(loc="upper left")
    right.set(ylabel="episodes that end standing [%]", ylim=(-2, 102))
    path = run / "learning_curve.png"
    figure.savefig(path, dpi=120)
    return path

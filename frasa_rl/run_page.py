"""The page of a training run: how it learned, what its best policy does, and what it rests on."""

from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl.curve import curve_figure
from frasa_rl.evaluate import find_controller
from frasa_rl.page_parts import learning_words, reason, run_origins, settings_tables
from frasa_rl.physics import own_physics
from frasa_rl.policy import RUN_FILE, Policy, read_run
from frasa_rl.protocol import Conditions, evaluation_task
from frasa_rl.strips import standup_strips
from frasa_rl.tables import EVALUATIONS, PROGRESS
from frasa_rl.task_file import task_from
from frasa_sysid.calibration import FrasaError, write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, image, look
from frasa_sysid.calibration.page import Html, card, cards, join, page, section, table, tag, warning

PAGE_FILE = "report.html"
_ENDINGS = {
    "steps": "It ended at the number of transitions that was asked for.",
    "minutes": "It ended when its time was up.",
    "success": "It ended because success on held-out falls held.",
}
INTERRUPTED = "interrupted"


def write_run_page(run: Path, stopped: str) -> Path | None:
    """Write report.html into a run folder, from what the run left there.

    Args:
        run: the folder.
        stopped: why the run ended: `steps`, `minutes`, `success` or `interrupted`.

    Returns:
        The file, or None where matplotlib is not installed.

    Raises:
        InputError: the folder holds no run.
    """
    if not has_matplotlib():
        return None
    said = read_run(run / RUN_FILE)
    task = task_from(said.get("task", {}), str(run / RUN_FILE))
    with look():
        curve = image(curve_figure(run), "return and success against steps and minutes") if PROGRESS.read(run) else ""
    parts = [
        _summary(run, said, stopped),
        section("How it learned", learning_words(task) if curve else "", curve),
        section("What the best policy does", _strips(run)),
        section("Held-out falls", _evaluations(run)),
        section("Settings", settings_tables(said)),
        section("What this rests on", run_origins(said)),
    ]
    write_atomic(run / PAGE_FILE, page(f"Training run {run.name}", parts))
    return run / PAGE_FILE


def _summary(run: Path, said: dict[str, Any], stopped: str) -> Html:
    settings = said.get("settings") or {}
    words = f"An agent ({settings.get('algorithm', '?')}, seed {settings.get('seed', '?')}) that learned to stand up. "
    lines = [tag("p", words + _ENDINGS.get(stopped, ""))]
    if stopped == INTERRUPTED:
        lines.append(
            warning("It was interrupted; all of it is saved. frasa-rl train --resume with its folder goes on.")
        )
    return join([*lines, cards([*_best_cards(run), *_training_cards(run)])], "\n")


def _best_cards(run: Path) -> list[Html]:
    """The published policy on held-out falls."""
    best = [row for row in EVALUATIONS.read(run) if row[-1] == 1.0][-1:]
    if not best:
        return [card("held-out falls", "-", "", "no policy was tried on them")]
    steps, minutes, _, prone, supine, time_s, _ = best[0]
    at = f"best policy, at {steps:,.0f} steps, {minutes:.1f} min"
    found = [card(f"held-out falls, {side}", f"{100 * one:.0f} %", "stand up", at)
             for side, one in (("prone", prone), ("supine", supine))]  # fmt: skip
    return [*found, card("time to stand up", f"{time_s:.2f}", "s", "mean of both sides")] if time_s > 0.0 else found


def _training_cards(run: Path) -> list[Html]:
    rows = PROGRESS.read(run)
    if not rows:
        return []
    now = dict(zip(PROGRESS.columns, rows[-1], strict=True))
    rate = now["steps"] / max(60.0 * now["minutes"], 1e-9)
    found = [card("training", f"{now['minutes']:.1f}", "min", f"{now['steps']:,.0f} steps, {rate:,.0f} a second")]
    known = [row[2] for row in rows if np.isfinite(row[2])]
    return (
        [*found, card("return of an episode", f"{known[-1]:.1f}", "", "last 100", f"{known[0]:.1f}")]
        if known
        else found
    )


def _strips(run: Path) -> Html:
    """The published policy standing up from both sides, as the protocol has it."""
    try:
        policy = Policy.load(run)
        task = own_physics(task_from(policy.run.get("task", {}), str(run / RUN_FILE)))
        controller, model = find_controller(str(run), None, task)
        return standup_strips(controller, Conditions(model=model, task=evaluation_task(task)))
    except FrasaError as error:
        return reason(error)


def _evaluations(run: Path) -> Html:
    rows = EVALUATIONS.read(run)
    cells = [
        [f"{steps:,.0f}", f"{minutes:.2f}", f"{100 * prone:.0f}", f"{100 * supine:.0f}",
         f"{time_s:.2f}" if np.isfinite(time_s) else "-", "first" if which == 0 else "second"]
        for steps, minutes, which, prone, supine, time_s, _ in rows
    ]  # fmt: skip
    best = [i for i, row in enumerate(rows) if row[-1] == 1.0][-1:]
    heads = ("steps", "minutes", "prone, % standing", "supine, % standing", "time, s", "set of falls")
    return table(heads, cells, range(5), marked=best) if rows else Html()

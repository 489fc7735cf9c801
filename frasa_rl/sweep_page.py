"""The page of a sweep: how its agents spread, what each came to, and the best by the protocol."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from frasa_rl.page_parts import learning_words, run_origins, settings_tables
from frasa_rl.rank import CRITERIA
from frasa_rl.sweep_files import SWEEP_FILE, Sweep
from frasa_rl.sweep_picture import sweep_figure
from frasa_rl.sweep_table import AGENTS, by_merit
from frasa_rl.task_file import task_from
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, image, look
from frasa_sysid.calibration.page import Html, card, cards, join, page, section, table, tag

PAGE_FILE = "report.html"
_COLUMNS = {  # of the table: head, factor, format
    "steps": ("steps", 1.0, ",.0f"),
    "minutes": ("minutes", 1.0, ".1f"),
    "success_prone": ("prone, %", 100.0, ".0f"),
    "success_supine": ("supine, %", 100.0, ".0f"),
    "time_s": ("time, s", 1.0, ".2f"),
    "minutes_to_50": ("minutes to 50 %", 1.0, ".1f"),
    "minutes_to_90": ("minutes to 90 %", 1.0, ".1f"),
    "return": ("return", 1.0, ".1f"),
}


def write_sweep_page(
    sweep: Sweep, agents: Sequence[Mapping[str, Any]], ranking: Mapping[str, Any] | None
) -> Path | None:
    """Write report.html into the folder of a sweep.

    Args:
        sweep: with its agents.
        agents: what `frasa-rl sweep --json` says of each.
        ranking: what `frasa-rl rank --json` says of the best; None where nobody asked.

    Returns:
        The file, or None where matplotlib is not installed.
    """
    if not has_matplotlib():
        return None
    task = task_from(sweep.run.get("task", {}), str(sweep.out / SWEEP_FILE))
    with look():
        figure = sweep_figure([sweep.folder(seed) for seed in sweep.seeds], task)
        curve = image(figure, "spread of return and success against steps and minutes") if figure else ""
    parts = [
        _summary(agents),
        section("How they learned", learning_words(task) if curve else "", curve),
        section("Every agent", _agents(agents)),
        section("The best by the protocol", _ranking(ranking)),
        section("Settings", settings_tables(sweep.run)),
        section("What this rests on", run_origins(sweep.run)),
    ]
    write_atomic(sweep.out / PAGE_FILE, page(f"Sweep {sweep.out.name}: {len(agents)} agents", parts))
    return sweep.out / PAGE_FILE


def _summary(agents: Sequence[Mapping[str, Any]]) -> Html:
    states = [one["state"] for one in agents]
    counts = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
    best = by_merit([[one[name] for name in AGENTS.columns] for one in agents])[:1]
    found = []
    for one in (one for one in agents if one["seed"] in best):
        both = f"{100 * one['success_prone']:.0f} % prone, {100 * one['success_supine']:.0f} % supine"
        found.append(card("best agent", f"seed {one['seed']}", "", f"held-out falls that end standing: {both}"))
    times = sorted(one["minutes_to_90"] for one in agents if one["minutes_to_90"] == one["minutes_to_90"])
    below = f"to 90 % of held-out falls; fastest {times[0]:.1f} min" if times else "90 % of held-out falls standing"
    found.append(card("agents that came to 90 %", f"{len(times)} of {len(agents)}", "", below))
    return join([tag("p", f"Agents that differ in nothing but their seeds: {counts}."), cards(found)])


def _agents(agents: Sequence[Mapping[str, Any]]) -> Html:
    heads = ("seed", "state", *(head for head, _, _ in _COLUMNS.values()), "why")
    best = by_merit([[one[name] for name in AGENTS.columns] for one in agents])[:1]
    rows = [
        [one["seed"], one["state"], *(_shown(one[name], *how[1:]) for name, how in _COLUMNS.items()), one["why"] or ""]
        for one in agents
    ]
    marked = [i for i, one in enumerate(agents) if one["seed"] in best]
    return table(heads, rows, (0, *range(2, 2 + len(_COLUMNS))), css="sort", marked=marked)


def _shown(value: float, factor: float, form: str) -> str:
    return format(factor * value, form) if value == value else "-"


def _ranking(ranking: Mapping[str, Any] | None) -> Html:
    if ranking is None:
        return Html()
    heads = ("place", "agent", *CRITERIA, "mean rank")
    rows = [
        [
            one["place"],
            Path(one["name"]).name,
            *(f"{one['ranks'][name]:g}" for name in CRITERIA),
            f"{one['mean_rank']:.2f}",
        ]
        for one in ranking["candidates"]
    ]
    words = tag("p", tag("small", "Rank in each criterion of the protocol, on the robot as it is and on random ones."))
    return join([words, table(heads, rows, (0, *range(2, len(heads))))])

"""The protocol's tables as text, the paper's numbers beside ours."""

from typing import Any

from frasa_rl.instruments import MEASURES
from frasa_rl.protocol import PAPER_PUSH, PAPER_STANDUP

_DASH = "-"


def tables(result: dict[str, Any]) -> str:
    """All tables of an evaluation.

    Args:
        result: what `frasa-rl evaluate --json` prints.
    """
    robots = "robots and floors drawn at random" if result["randomized"] else "the robot as its file says"
    head = f"{result['controller']} on {result['model']}, {result['rate_hz']:g} decisions a second, {robots}"
    parts = [head]
    if result["standup"]:
        parts.append(standup_table(result["standup"]))
    if result["push"]:
        parts.append(push_table(result["push"]))
    if result["strain"]:
        parts.append(_strain_lines(result["strain"]))
    if result["divergences"]:
        parts.append(f"the simulation blew up in {result['divergences']} trials: counted as failures")
    return "\n\n".join(parts)


def standup_table(rows: dict[str, Any]) -> str:
    """The rows of `standup_cells`, aligned."""
    return _aligned(standup_cells(rows))


def standup_cells(rows: dict[str, Any]) -> list[list[str]]:
    """Stand-up, heads first: from the first movement until all six errors stay below 5 deg for 0.5 s."""
    head = ["stand-up", "trials", "stood up", "time [s]", "paper: agent", "paper: keyframes"]
    lines = []
    for side, one in rows.items():
        paper = PAPER_STANDUP[side]
        lines.append([
            side, str(one["trials"]), f"{one['success_rate']:.0%}", spread(one["time_mean_s"], one["time_std_s"], 3),
            spread(*paper["agent"], 3), spread(*paper["keyframes"], 3),
        ])  # fmt: skip
    return [head, *lines]


def push_table(rows: list[dict[str, Any]]) -> str:
    """The rows of `push_cells`, aligned."""
    return _aligned(push_cells(rows))


def push_cells(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Pushes, heads first: from the first deviation above 5 deg until stable again."""
    head = ["push", "trials", "stable again", "falls", "not standing", "missed", "instability [s]", "paper: agent"]
    lines = []
    for one in rows:
        paper = PAPER_PUSH.get((one["direction"], one["energy_j"]))
        lines.append([
            f"{one['direction']} {one['energy_j']:.1f} J", str(one["trials"]), f"{one['success_rate']:.0%}",
            str(one["falls"]), str(one["not_standing"]), str(one["missed"]),
            spread(one["instability_mean_s"], one["instability_std_s"]), spread(paper, None),
        ])  # fmt: skip
    return [head, *lines]


def _strain_lines(strain: dict[str, float]) -> str:
    lines = [[one.name, f"{strain[one.name]:.3g} {one.unit}", f"{one.meaning}, mean of all trials"] for one in MEASURES]
    return "\n".join(f"{name:<18}{value:>14}   {meaning}" for name, value, meaning in lines)


def spread(mean: float | None, std: float | None, digits: int = 2) -> str:
    """A mean with its deviation; a dash for none."""
    if mean is None:
        return _DASH
    return f"{mean:.{digits}f}" + ("" if std is None else f" +- {std:.{digits}f}")


def _aligned(rows: list[list[str]]) -> str:
    """Columns wide enough for their longest word, the first to the left, a line below the head."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(word.ljust(width) if column == 0 else word.rjust(width) for column, (word, width) in enumerate(pairs))
        for pairs in (list(zip(row, widths, strict=True)) for row in rows)
    ]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])

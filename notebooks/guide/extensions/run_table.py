"""What training time bought the policy in the box, from the evaluations of its own run."""

import csv
from pathlib import Path

SHOWN = (25_000, 75_000, 100_000, 150_000, 200_000, 300_000, 375_000)  # transitions, about


def quality(root: Path) -> str:
    """A table: held-out falls that end standing, and how long they take, over transitions and minutes."""
    with (root / "robot_model" / "policies" / "standup" / "evaluations.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    lines = ["| transitions | minutes | prone | supine | mean time to stand |", "|---|---|---|---|---|"]
    for wanted in SHOWN:
        one = min(rows, key=lambda row: abs(int(row["steps"]) - wanted))
        prone, supine = (f"{100 * float(one[f'success_{side}']):.0f} %" for side in ("prone", "supine"))
        time = f"{float(one['time_s']):.2f} s" if one["time_s"] else "-"
        lines.append(f"| {int(one['steps']):,} | {float(one['minutes']):.1f} | {prone} | {supine} | {time} |")
    return "\n".join(lines) + "\n"

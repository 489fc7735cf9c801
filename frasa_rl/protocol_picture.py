"""The protocol's tables as a picture: a bar for each row, the paper's beside ours."""

import io
from pathlib import Path
from typing import Any

from frasa_rl.protocol import PAPER_PUSH, PAPER_STANDUP
from frasa_sysid.calibration import FrasaError, UsageError, write_atomic

_WIDTH = 0.27
_COLOURS = {"simulated": "tab:blue", "paper: agent": "tab:orange", "paper: keyframes": "tab:gray"}
FORMATS = (".png", ".svg", ".pdf")


class PictureError(FrasaError):
    """matplotlib is not installed."""


def check_picture(path: Path) -> None:
    """Say early when a picture cannot be drawn.

    Raises:
        UsageError: another suffix than those of `FORMATS`.
        PictureError: matplotlib is not installed.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"cannot write {path}: a picture is one of {', '.join(FORMATS)}")
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError:
        raise PictureError("no picture: matplotlib is not installed (pip install 'frasa[report]')") from None


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw what `frasa-rl evaluate --json` prints, complete or not at all.

    Raises:
        UsageError: a format that cannot be written.
        PictureError: matplotlib is not installed.
    """
    check_picture(path)
    from matplotlib.figure import Figure  # no pyplot: no window, no global state

    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.8))
    _bars(left, _standup_rows(result["standup"]), "stand-up", "time to stand up [s]")
    _bars(right, _push_rows(result["push"]), "push", "time unstable after a push [s]")
    robots = "random robots" if result["randomized"] else "as the file says"
    figure.suptitle(f"{result['controller']} on {Path(result['model']).name}, {result['rate_hz']:g} Hz, {robots}")
    handles, labels = left.get_legend_handles_labels()
    if handles:
        left.legend(handles, labels, fontsize=8, loc="upper left")
    content = io.BytesIO()
    figure.savefig(content, dpi=130, format=path.suffix[1:].lower())
    write_atomic(path, content.getvalue())


def _standup_rows(rows: dict[str, Any]) -> list[tuple[str, dict[str, Any], dict[str, float | None]]]:
    return [
        (side, _ours(one, "time"), {name: value[0] for name, value in PAPER_STANDUP[side].items()})
        for side, one in rows.items()
    ]


def _push_rows(rows: list[dict[str, Any]]) -> list[tuple[str, dict[str, Any], dict[str, float | None]]]:
    return [
        (
            f"{one['direction']}\n{one['energy_j']:.1f} J",
            _ours(one, "instability"),
            {"agent": PAPER_PUSH.get((one["direction"], one["energy_j"]))},
        )
        for one in rows
    ]


def _ours(one: dict[str, Any], what: str) -> dict[str, Any]:
    good = round(one["success_rate"] * one["trials"])
    return {"mean": one[f"{what}_mean_s"], "std": one[f"{what}_std_s"], "share": f"{good}/{one['trials']}"}


def _bars(axes: Any, rows: list[tuple[str, dict[str, Any], dict[str, float | None]]], title: str, label: str) -> None:  # noqa: ANN401 - matplotlib is untyped
    """Groups of bars; how many trials succeeded stands above ours."""
    axes.bar(0, 0.0, _WIDTH, color=_COLOURS["simulated"], label="simulated")  # for the legend, if nothing succeeds
    for place, (_, ours, paper) in enumerate(rows):
        mean = ours["mean"]
        if mean is not None:
            axes.bar(place, mean, _WIDTH, yerr=ours["std"], color=_COLOURS["simulated"], capsize=3)
        height = 0.0 if mean is None else mean + ours["std"]
        axes.annotate(ours["share"], (place, height), (0, 3), textcoords="offset points", ha="center", fontsize=8)
        for offset, (name, value) in enumerate(paper.items(), start=1):
            if value is not None:
                key = f"paper: {name}"
                axes.bar(place + offset * _WIDTH, value, _WIDTH, color=_COLOURS[key], alpha=0.7,
                         label=key if place == 0 else None)  # fmt: skip
    axes.set(title=f"{title} (numbers: trials that succeeded)", ylabel=label)
    middle = [place + 0.5 * _WIDTH * len(paper) for place, (_, _, paper) in enumerate(rows)]
    axes.set_xticks(middle, [name for name, _, _ in rows])
    axes.grid(axis="y", alpha=0.3)
    axes.set(ylim=(0.0, None), xlim=(-0.5, len(rows)))

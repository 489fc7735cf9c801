"""The protocol's tables as a picture: a bar for each row, the paper's beside ours."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frasa_rl.protocol import PAPER_PUSH, PAPER_STANDUP
from frasa_sysid.calibration import FrasaError, UsageError, write_atomic
from frasa_sysid.calibration.figures import BLUE, GREY, HINT, INK, ORANGE, look

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 0.27
_COLOURS = {"simulated": BLUE, "paper: agent": ORANGE, "paper: keyframes": GREY}
_MEANING = {
    "simulated": "simulated; dots are trials, above them how many succeeded",
    "paper: agent": "paper: agent, on the robot",
    "paper: keyframes": "paper: keyframes, on the robot",
}
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
        raise PictureError(f"no picture: {HINT}") from None


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw what `frasa-rl evaluate --json` prints, complete or not at all.

    Raises:
        UsageError: a format that cannot be written.
        PictureError: matplotlib is not installed.
    """
    check_picture(path)
    content = io.BytesIO()
    with look():
        figure = protocol_figure(result)
        robots = "random robots" if result["randomized"] else "as the file says"
        figure.suptitle(f"{result['controller']} on {Path(result['model']).name}, {result['rate_hz']:g} Hz, {robots}")
        figure.savefig(content, dpi=130, format=path.suffix[1:].lower())
    write_atomic(path, content.getvalue())


def protocol_figure(result: dict[str, Any]) -> "Figure":
    """Bars of what `frasa-rl evaluate --json` prints, a dot for every trial; drawn inside `look`."""
    from matplotlib.figure import Figure  # no pyplot: no window, no global state

    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.8))
    _bars(left, _standup_rows(result["standup"]), "Standing up", "time to stand up, s")
    _bars(right, _push_rows(result["push"]), "Pushes", "time unstable after a push, s")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=3, frameon=False)
    return figure


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
    mean, std = one[f"{what}_mean_s"], one[f"{what}_std_s"]
    times = [time_s for time_s in one["times_s"] if time_s is not None]
    return {"mean": mean, "std": std, "share": f"{good}/{one['trials']}", "times": times}


def _bars(axes: Any, rows: list[tuple[str, dict[str, Any], dict[str, float | None]]], title: str, label: str) -> None:  # noqa: ANN401 - matplotlib is untyped
    """Groups of bars; how many trials succeeded stands above ours."""
    for name in _MEANING:  # for the legend, whatever there is
        axes.bar(0, 0.0, _WIDTH, color=_COLOURS[name], label=_MEANING[name])
    for place, (_, ours, paper) in enumerate(rows):
        mean = ours["mean"]
        if mean is not None:
            axes.bar(place, mean, _WIDTH, color=_COLOURS["simulated"], alpha=0.85)
            beside = place + _WIDTH * 0.6 * np.linspace(-0.5, 0.5, len(ours["times"]) + 2)[1:-1]
            axes.plot(beside, sorted(ours["times"]), "o", ms=2.6, color=INK, alpha=0.7)
        height = max([0.0, *ours["times"]])
        axes.annotate(ours["share"], (place, height), (0, 4), textcoords="offset points", ha="center")
        for offset, (name, value) in enumerate(paper.items(), start=1):
            if value is not None:
                key = f"paper: {name}"
                axes.bar(place + offset * _WIDTH, value, _WIDTH * 0.92, color=_COLOURS[key])
    axes.set(title=title, ylabel=label)
    middle = [place + 0.5 * _WIDTH * len(paper) for place, (_, _, paper) in enumerate(rows)]
    axes.set_xticks(middle, [name for name, _, _ in rows])
    axes.grid(visible=False, axis="x")
    axes.margins(y=0.12)
    axes.set(ylim=(0.0, None), xlim=(-0.5, max(len(rows), 1)))

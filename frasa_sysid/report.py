"""Pages a person would rather look at than read: one HTML file each, pictures inside, opens offline."""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frasa_sysid.calibration import say, write_atomic
from frasa_sysid.fit import FitResult, simulated
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import BenchSimulator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = 8  # runs drawn; all of them are in the table
_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#1d2733}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}table{border-collapse:collapse}
td,th{padding:.25em .8em;border-bottom:1px solid #dde3ea;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}
img{max-width:100%}.bad{color:#a15c00}.good{color:#1b7a3d}small{color:#5b6875}"""


@dataclass(frozen=True)
class Trace:
    """One run with what candidates make of it.

    Attributes:
        run: measured.
        readings: simulated angle [rad] at the run's times, by candidate name, shape (T,) each.
    """

    run: BenchRun
    readings: Mapping[str, FloatArray]


def write_fit_report(path: Path, result: FitResult, simulator: BenchSimulator) -> Path | None:
    """Write the page of a fit: errors, numbers with intervals and verdicts, traces, correlations.

    Args:
        path: HTML file to make.
        result: the fit.
        simulator: simulates the runs that are drawn.

    Returns:
        The file, or None where matplotlib is not installed.
    """
    if not _has_matplotlib():
        return None
    problem = result.problem
    runs = _shown([*problem.train, *problem.held_out])
    nominal = simulator.simulate(runs, [problem.servo_values(problem.nominal_values())])[0]
    fitted = simulated(result, simulator, runs)
    traces = [Trace(run, {"nominal": a, "fitted": b}) for run, a, b in zip(runs, nominal, fitted, strict=True)]
    held = {run.name for run in problem.held_out}
    parts = [
        f"<p>{_summary(result)}</p>",
        "<h2>Numbers</h2>" + _parameter_table(result),
        "<h2>Simulated over measured</h2>" + _image(_trace_figure(traces, held)),
        "<h2>How the numbers move together, and the search</h2>" + _image(_evidence_figure(result)),
        "<h2>Error of every run</h2>" + _run_table(result),
    ]
    write_atomic(path, _page(f"{problem.servo.name}: fit of {len(problem.train)} runs", parts))
    return path


def write_trace_report(path: Path, title: str, traces: Sequence[Trace]) -> Path | None:
    """Write a page of traces only; None where matplotlib is not installed."""
    if not _has_matplotlib():
        return None
    shown = {run.name for run in _shown([trace.run for trace in traces])}
    drawn = [trace for trace in traces if trace.run.name in shown]
    write_atomic(path, _page(title, [_image(_trace_figure(drawn, set()))]))
    return path


def _has_matplotlib() -> bool:
    try:
        import matplotlib
    except ImportError:
        say("no report page: matplotlib is not installed (pip install 'frasa[report]')")
        return False
    matplotlib.use("Agg")
    return True


def _shown(runs: Sequence[BenchRun]) -> list[BenchRun]:
    """At most eight runs: one of each trajectory first, loads and gains mixed."""
    if len(runs) <= _SHOWN:
        return list(runs)
    by_trajectory: dict[str, list[BenchRun]] = {}
    for run in runs:
        by_trajectory.setdefault(run.trajectory, []).append(run)
    share = max(1, _SHOWN // len(by_trajectory))
    picked = [
        members[i]
        for members in by_trajectory.values()
        for i in np.unique(np.linspace(0, len(members) - 1, share + 2).round().astype(int)[1:-1])
    ]
    return picked[:_SHOWN]


def _summary(result: FitResult) -> str:
    text = (
        f"Mean error <b>{result.nominal.mae_rad * 1e3:.1f} mrad</b> nominal, "
        f"<b>{result.fitted.mae_rad * 1e3:.1f} mrad</b> fitted, friction law {result.friction}."
    )
    if result.problem.held_out:
        text += (
            f" On {len(result.problem.held_out)} runs held out ({html.escape(result.problem.hold_out_rule)}): "
            f"{result.held_out_nominal.mae_rad * 1e3:.1f} nominal, {result.held_out.mae_rad * 1e3:.1f} fitted."
        )
    return (
        text + f"<br><small>{result.evaluations} evaluations, seed {result.problem.seed}; {result.stop.value}</small>"
    )


def _parameter_table(result: FitResult) -> str:
    rows = []
    for one in result.evidence.estimates:
        mood = "good" if one.verdict == "identified" else "bad"
        rows.append(
            f"<tr><td>{one.name}</td><td class=n>{one.nominal:.4g}</td><td class=n><b>{one.value:.4g}</b></td>"
            f"<td class=n>{one.low:.4g} .. {one.high:.4g}</td><td>{one.unit}</td>"
            f"<td class={mood}>{html.escape(one.verdict)}</td><td>{html.escape(one.advice)}</td></tr>"
        )
    heads = ("parameter", "nominal", "fitted", "95 % interval", "unit", "verdict", "to do")
    return "<table><tr>" + "".join(f"<th>{head}</th>" for head in heads) + "</tr>" + "".join(rows) + "</table>"


def _run_table(result: FitResult) -> str:
    rows = []
    for kind, errors, before in (
        ("fitted", result.fitted.by_run, result.nominal.by_run),
        ("held out", result.held_out.by_run, result.held_out_nominal.by_run),
    ):
        rows += [
            f"<tr><td>{html.escape(name)}</td><td>{kind}</td><td class=n>{before[name] * 1e3:.1f}</td>"
            f"<td class=n>{error * 1e3:.1f}</td></tr>"
            for name, error in errors.items()
        ]
    head = "<tr><th>run</th><th></th><th>nominal [mrad]</th><th>fitted [mrad]</th></tr>"
    return f"<details><summary>{len(rows)} runs</summary><table>{head}{''.join(rows)}</table></details>"


def _trace_figure(traces: Sequence[Trace], held: set[str]) -> "Figure":
    from matplotlib.figure import Figure

    colours = {"nominal": "#c44e52", "fitted": "#1f77b4"}
    rows = (len(traces) + 1) // 2
    figure = Figure(figsize=(11, 2.7 * rows), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False).ravel()
    for ax, trace in zip(axes, traces, strict=False):
        ax.plot(trace.run.t, trace.run.y, color="black", lw=2.0, alpha=0.45, label="measured")
        for name, reading in trace.readings.items():
            ax.plot(trace.run.t, reading, lw=1.1, color=colours.get(name), label=name)
        mark = " (held out)" if trace.run.name in held else ""
        ax.set_title(f"{trace.run.trajectory or trace.run.name} {trace.run.group}{mark}", fontsize=9, parse_math=False)
        ax.set_ylabel("angle [rad]", fontsize=8)
        ax.tick_params(labelsize=8)
    for ax in axes[len(traces) :]:
        ax.set_visible(False)
    axes[0].legend(fontsize=8)
    return figure


def _evidence_figure(result: FitResult) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = [one.name.rpartition(".")[2] for one in result.problem.free]
    image = left.imshow(result.evidence.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    left.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=8)
    left.set_yticks(range(len(names)), names, fontsize=8)
    left.set_title("correlation of the estimates", fontsize=9)
    figure.colorbar(image, ax=left)
    right.plot(np.array(result.trace) * 1e3)
    right.set_yscale("log")
    right.set_xlabel("generation of CMA-ES")
    right.set_ylabel("robust cost [mrad]")
    right.set_title("search, before the finisher", fontsize=9)
    return figure


def _image(figure: "Figure") -> str:
    buffer = io.BytesIO()
    # No date in the file, so that the same fit gives the same page.
    figure.savefig(buffer, format="png", dpi=100, metadata={"Software": None})
    return f'<img alt="plot" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def _page(title: str, parts: Sequence[Any]) -> str:
    head = f"<!doctype html><meta charset=utf-8><title>{html.escape(title)}</title><style>{_STYLE}</style>"
    return head + f"<h1>{html.escape(title)}</h1>" + "\n".join(parts) + "\n"

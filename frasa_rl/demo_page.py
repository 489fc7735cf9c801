"""The page `make demo` leaves: what was fitted, how training went, what the robot does. Opens offline."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco

from frasa_rl.config import Task
from frasa_rl.curve import still_return
from frasa_rl.protocol_tables import push_table, standup_table
from frasa_rl.render import Camera, save_film
from frasa_sysid.calibration import FrasaError, load_model, say, write_atomic

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#1d2733}
h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em}table{border-collapse:collapse}
td,th{padding:.25em .8em;border-bottom:1px solid #dde3ea;text-align:left}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%}.bad{color:#a15c00}.good{color:#1b7a3d}
pre{background:#f3f5f8;padding:.8em;overflow:auto}small,summary{color:#5b6875}"""
_CHAIN = "bench log  ->  fit  ->  calibrated.xml + randomization.yaml  ->  stand-up agent  ->  policy"


def write_page(
    out: Path,
    steps: Sequence[tuple[str, str, float]],
    results: dict[str, Any],
    training: Path,
    film: Path,
    model: Path,
) -> Path:
    """Write `index.html`.

    Args:
        out: folder of the page.
        steps: title, command and seconds of each step.
        results: JSON of the steps, by name; fits are those with a `mujoco` part.
        training: run folder with the learning curve.
        film: animated picture of a trial.
        model: the calibrated model, for a still picture.
    """
    fits = {name: one for name, one in results.items() if "mujoco" in one}
    parts = [
        f"<pre>{html.escape(_CHAIN)}</pre>",
        _steps_table(steps),
        *(_fit_section(name, one) for name, one in fits.items()),
        "<h2>The robot</h2>" + _picture_of(model, out),
        "<h2>Training</h2>" + _image(training / "learning_curve.png"),
        _training_text(results["train"]),
        "<h2>Evaluation: six errors below 5 deg for 0.5 s, and pushes by a pendulum</h2>" + _evaluation_tables(results),
        "<h2>One trial, from prone</h2>" + _image(film),
    ]
    head = f"<!doctype html><meta charset=utf-8><title>frasa demo</title><style>{_STYLE}</style>"
    page = out / "index.html"
    write_atomic(page, head + "<h1>frasa: from servo logs to a standing robot</h1>" + "\n".join(parts) + "\n")
    return page


def _steps_table(steps: Sequence[tuple[str, str, float]]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(title)}</td><td><code>{html.escape(command)}</code></td>"
        f"<td class=n>{seconds:.0f} s</td></tr>"
        for title, command, seconds in steps
    )
    total = sum(seconds for _, _, seconds in steps)
    return f"<table>{rows}<tr><td><b>all</b></td><td></td><td class=n>{total:.0f} s</td></tr></table>"


def _fit_section(name: str, fit: dict[str, Any]) -> str:
    errors = fit["misfit"]
    text = (
        f"<p>{fit['runs']['train']} {fit['origin']} runs: "
        f"mean error {errors['nominal']['mae_rad'] * 1e3:.1f} mrad nominal, "
        f"<b>{errors['fitted']['mae_rad'] * 1e3:.1f} mrad</b> fitted, in {fit['seconds']:.0f} s.</p>"
    )
    rows = "".join(
        f"<tr><td>{key}</td><td class=n>{one['nominal']:.4g}</td><td class=n><b>{one['value']:.4g}</b></td>"
        f"<td class=n>{one['low']:.4g} .. {one['high']:.4g}</td><td>{one['unit']}</td>"
        f"<td class={'good' if one['verdict'] == 'identified' else 'bad'}>{html.escape(one['verdict'])}</td></tr>"
        for key, one in fit["parameters"].items()
    )
    head = "<tr><th>parameter<th class=n>nominal<th class=n>fitted<th class=n>95 % interval<th>unit<th>verdict</tr>"
    return f"<h2>Fit of the {name}</h2>{text}<table>{head}{rows}</table>{_traces(fit)}"


def _traces(fit: dict[str, Any]) -> str:
    """The pictures of the fit's own page, which frasa-sysid wrote in this very run."""
    report = fit["outputs"].get("report")
    if report is None:
        return ""
    content = Path(report).read_text(encoding="utf-8")
    images = [piece.partition(">")[0] for piece in content.split("<img ")[1:]]
    return "".join(f"<details open><summary>traces and evidence</summary><img {image}></details>" for image in images)


def _picture_of(model: Path, out: Path) -> str:
    path = out / "robot.png"
    try:
        _draw_standing(model, path)
    except FrasaError as error:
        say(f"no picture of the robot: {error}")
        return f"<p class=bad>{html.escape(str(error))}</p>"
    return _image(path)


def _draw_standing(model_path: Path, path: Path) -> None:
    """A still of the calibrated robot in its neutral keyframe, after 2 s of simulated standing."""
    model = load_model(model_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("neutral").id)
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    camera = Camera(model, width=720, height=540)
    try:
        save_film([camera.picture(data)], path, 1.0)
    finally:
        camera.close()


def _training_text(train: dict[str, Any]) -> str:
    return (
        f"<p>{train['steps']} steps in {train['minutes']:.1f} minutes; mean return of an episode from "
        f"{_number(train['return_first'])} to {_number(train['return_last'])} (at most 125). A robot that only lies "
        f"still earns up to {still_return(Task()):.0f}, and many starts are near the pose or still falling: "
        f"what counts is that {standing(train)}. The paper trains for 13 to 37 minutes on a desktop with a GPU "
        "(235,000 to 575,000 steps, eight updates each).</p>"
    )


def standing(train: dict[str, Any]) -> str:
    """How the best policy of a run did on falls that it never trained on."""
    best = train["held_out"]
    if best is None:
        return "no policy was tried on held-out falls"
    told = (
        f"of the falls it never trained on the best policy stands up from {100 * best['success_prone']:.0f} % on the "
        f"front and {100 * best['success_supine']:.0f} % on the back"
    )
    if best["success_prone"] == best["success_supine"] == 0.0:
        return f"{told}; this run was too short for its seed"
    return f"{told}, in {best['time_mean_s']:.1f} s"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _evaluation_tables(results: dict[str, Any]) -> str:
    """The protocol's own tables, of the trained controller and of doing nothing."""
    parts = []
    for title, key in (("trained", "evaluate"), ("does nothing", "nothing")):
        said = results[key]
        text = f"{standup_table(said['standup'])}\n\n{push_table(said['push'])}"
        parts.append(f"<h3>{title}</h3><pre>{html.escape(text)}</pre>")
    return "".join(parts)


def _image(path: Path) -> str:
    if not path.is_file():
        return f"<p class=bad>no picture: {html.escape(path.name)} was not made</p>"
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{html.escape(path.stem)}" src="data:image/{path.suffix[1:]};base64,{data}">'

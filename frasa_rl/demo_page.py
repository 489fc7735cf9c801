"""The page `make demo` leaves: what was fitted, how training went, what the robot does. Opens offline."""

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco

from frasa_rl.config import Task
from frasa_rl.curve import curve_figure
from frasa_rl.page_parts import learning_words, protocol_picture, protocol_tables, reason
from frasa_rl.render import Camera, save_film
from frasa_sysid.calibration import FrasaError, load_model, say, write_atomic
from frasa_sysid.calibration.figures import image, image_of, look
from frasa_sysid.calibration.page import Html, card, cards, folded, join, page, pill, section, table, tag, warning

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
    task = Task()
    with look():
        pictures = {name: protocol_picture(results[name]) for name in ("evaluate", "nothing")}
        curve = image(curve_figure(training), "return and success against steps and minutes")
    parts = [
        tag("pre", _CHAIN),
        _cards(fits, results["train"]),
        section("Every step", _steps_table(steps)),
        *(section(f"Fit of the {name}", _fit(one)) for name, one in fits.items()),
        section("The robot", _picture_of(model, out)),
        section("Training", learning_words(task), curve, tag("p", _training_text(results["train"]))),
        section("The trained policy beside the paper", protocol_tables(results["evaluate"]), pictures["evaluate"]),
        section("One trial, from prone", _file(film)),
        section("Doing nothing, for comparison", protocol_tables(results["nothing"]), pictures["nothing"]),
    ]
    path = out / "index.html"
    write_atomic(path, page("frasa: from servo logs to a standing robot", parts))
    return path


def _cards(fits: Mapping[str, dict[str, Any]], train: dict[str, Any]) -> Html:
    found = []
    for name, one in fits.items():
        before, after = (1e3 * one["misfit"][part]["mae_rad"] for part in ("nominal", "fitted"))
        found.append(card(f"mean error, {name}", f"{after:.1f}", "mrad", "nominal to fitted", f"{before:.1f}"))
    best = train["held_out"]
    if best is not None:
        share = 50.0 * (best["success_prone"] + best["success_supine"])
        found.append(card("held-out falls", f"{share:.0f} %", "stand up", f"{train['minutes']:.1f} min of training"))
    return cards(found)


def _steps_table(steps: Sequence[tuple[str, str, float]]) -> Html:
    rows: list[list[object]] = [[title, tag("code", command), f"{seconds:.0f} s"] for title, command, seconds in steps]
    total = f"{sum(seconds for _, _, seconds in steps):.0f} s"
    return table(("step", "command", "time"), [*rows, [tag("b", "all"), "", total]], (2,))


def _fit(fit: dict[str, Any]) -> Html:
    errors = fit["misfit"]
    words = (
        f"{fit['runs']['train']} {fit['origin']} runs: mean error {errors['nominal']['mae_rad'] * 1e3:.1f} mrad "
        f"nominal, {errors['fitted']['mae_rad'] * 1e3:.1f} mrad fitted, in {fit['seconds']:.0f} s."
    )
    rows = [
        [key, f"{one['nominal']:.4g}", tag("b", f"{one['value']:.4g}"), f"{one['low']:.4g} to {one['high']:.4g}",
         one["unit"], pill(one["verdict"])]
        for key, one in fit["parameters"].items()
    ]  # fmt: skip
    heads = ("parameter", "nominal", "fitted", "95 % interval", "unit", "verdict")
    return join([tag("p", words), table(heads, rows, (1, 2, 3)), _pictures(fit)])


def _pictures(fit: dict[str, Any]) -> Html:
    """The pictures of the fit's own page, which frasa-sysid wrote in this very run."""
    report = fit["outputs"].get("report")
    if report is None:
        return Html()
    found = re.findall(
        r'<img alt="[^"]*" width="\d+" src="data:image/png;base64,[^"]*">', Path(report).read_text("utf-8")
    )
    return join(folded(_meaning(one), Html(one)) for one in found)


def _meaning(element: str) -> str:
    """What a picture shows, as its page says."""
    return html.unescape(element.split('"')[1])


def _picture_of(model: Path, out: Path) -> Html:
    path = out / "robot.png"
    try:
        _draw_standing(model, path)
    except FrasaError as error:
        say(f"no picture of the robot: {error}")
        return reason(error)
    return _file(path)


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
        f"{train['steps']} steps in {train['minutes']:.1f} minutes; mean return of an episode from "
        f"{_number(train['return_first'])} to {_number(train['return_last'])} (at most 125). Many starts are near the "
        f"pose or still falling: what counts is that {standing(train)}. The paper trains for 13 to 37 minutes on a "
        "desktop with a GPU (235,000 to 575,000 steps, eight updates each)."
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


def _file(path: Path) -> Html:
    """A picture's file."""
    if not path.is_file():
        return warning(f"No picture: {path.name} was not made.")
    return image_of(path.read_bytes(), path.suffix[1:], path.stem)

"""Parts that the pages of training and evaluation share."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from frasa_rl.config import Task
from frasa_rl.curve import still_return
from frasa_rl.instruments import MEASURES
from frasa_rl.protocol_picture import protocol_figure
from frasa_rl.protocol_tables import push_cells, standup_cells
from frasa_sysid.calibration import FrasaError
from frasa_sysid.calibration.figures import image
from frasa_sysid.calibration.page import Html, folded, join, table, tag, warning

_PAPER = (
    "Beside it the paper's numbers (FRASA, Gaspard et al., arXiv 2410.08655), measured on the robot itself; ours are "
    "simulated. Stand-up: from the first movement until all six errors stay below 5 deg for 0.5 s. Push: from the "
    "first deviation above 5 deg until stable again."
)


def protocol_tables(result: Mapping[str, Any]) -> Html:
    """The paper's two tables, as far as they were measured.

    Args:
        result: what `frasa-rl evaluate --json` prints.
    """
    parts = [_cells(standup_cells(result["standup"]))] if result["standup"] else []
    parts += [_cells(push_cells(result["push"]))] if result["push"] else []
    if result["divergences"]:
        parts.append(warning(f"The simulation blew up in {result['divergences']} trials: counted as failures."))
    return join(parts, "\n")


def _cells(cells: Sequence[Sequence[str]]) -> Html:
    heads, *rows = cells
    return table(heads, [[one.replace("+-", "±") for one in row] for row in rows], range(1, len(heads)))


def protocol_picture(result: dict[str, Any]) -> Html:
    """The same as bars, and how to read both; drawn inside `look`."""
    picture = image(protocol_figure(result), "times to stand up and of instability, beside the paper's")
    return join([tag("p", tag("small", _PAPER)), picture])


def strain_table(strain: Mapping[str, float]) -> Html:
    """What the trials ask of the robot."""
    if not strain:
        return Html()
    rows = [[one.meaning, f"{strain[one.name]:.3g}", one.unit] for one in MEASURES]
    return table(("mean of all trials", "", "unit"), rows, (1,))


def learning_words(task: Task) -> Html:
    """How to read a learning curve."""
    return tag(
        "p",
        tag(
            "small",
            f"A robot that only lies still earns up to {still_return(task):.0f}. Held-out falls were never trained on; "
            "the policy that leaves most of them standing, of equals the faster one, is the one that is published.",
        ),
    )


def settings_tables(run: Mapping[str, Any]) -> Html:
    """Settings and task of a run, folded.

    Args:
        run: content of its run.yaml.
    """
    task = run.get("task") or {}
    groups = {
        "Settings of learning": run.get("settings") or {},
        "Reward": task.get("reward") or {},
        "Task": {name: one for name, one in task.items() if isinstance(one, bool | int | float | str)},
    }
    return join(folded(title, table(("", ""), _plain(values), (1,))) for title, values in groups.items() if values)


def run_origins(run: Mapping[str, Any]) -> Html:
    """What a run depends on: model, calibration, ends, seeds, versions.

    Args:
        run: content of its run.yaml.
    """
    ends = {"steps": "transitions", "minutes": "minutes", "until_success": "of held-out falls standing"}
    said = ", ".join(f"{run[name]:g} {unit}" for name, unit in ends.items() if isinstance(run.get(name), int | float))
    rows = [
        ["model", short(str(run.get("model", "")))],
        ["sha256 of the compiled model", tag("code", run.get("model_sha256", ""))],
        ["calibration id", tag("code", run.get("calibration_id") or "none: a nominal model")],
        ["ends at", said],
        ["seeds", ", ".join(f"{name.replace('_', '-')} {seed}" for name, seed in _items(run.get("seeds")))],
        ["versions", ", ".join(f"{name} {one}" for name, one in _items(run.get("versions")))],
    ]
    return table(("", ""), [row for row in rows if str(row[1])])


def reason(error: FrasaError) -> Html:
    """Why there are no pictures of the robot, in one sentence."""
    return warning(f"No pictures of the robot: {error}.")


def short(name: str) -> str:
    """A file as it was given; of an absolute path the end, for a page is no map of a machine."""
    return str(Path(*Path(name).parts[-2:])) if Path(name).is_absolute() else name


def _plain(values: Mapping[str, Any]) -> list[list[str]]:
    return [
        [name, ", ".join(map(str, one)) if isinstance(one, list) else f"{one}"]
        for name, one in values.items()
        if one is not None and one != ""
    ]


def _items(values: object) -> list[tuple[str, object]]:
    return [(str(name), one) for name, one in values.items()] if isinstance(values, Mapping) else []

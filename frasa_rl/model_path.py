"""Where the model of a run is: as it was named, else on the way from the run folder, from whatever folder one looks.

A path is all that is looked up here. Whether the file there is the run's model, the calibration id or the hash says.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import ModelError

NAMED, FROM_RUN = "model", "model_from_run"  # in run.yaml


def from_run(model: Path, run: Path) -> str | None:
    """The way from a run folder to a model; None where it leads over the root: that is a path of one machine."""
    there, here = model.resolve(), run.resolve()
    try:
        common = Path(os.path.commonpath([there, here]))
    except ValueError:  # on other drives
        return None
    return None if common == Path(common.anchor) else Path(os.path.relpath(there, here)).as_posix()


def model_path(said: Mapping[str, Any], run: Path) -> Path:
    """Where a run.yaml says its model is; as it was named where there is none.

    Args:
        said: the content of run.yaml.
        run: the run folder.
    """
    named, way = Path(said[NAMED]), said.get(FROM_RUN)
    if _exists(named) or not isinstance(way, str) or Path(way).is_absolute() or not _exists(run / way):
        return named
    return Path(os.path.relpath((run / way).resolve()))


def run_folder(policy: Path) -> Path:
    """The run folder of a policy folder, or of itself."""
    outer = policy.absolute().parent
    return outer if not (policy / "policy").is_dir() and (outer / "run.yaml").is_file() else policy


def check_there(model: Path) -> None:
    """Raise ModelError where a run has its model from and there is none."""
    if not _exists(model):
        raise ModelError(f"no model at {model}, where this run has it from: say with --model where it is now")


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # no path at all
        return False

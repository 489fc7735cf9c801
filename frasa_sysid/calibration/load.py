"""Loading a model and the ranges that belong to it; files from strangers are not trusted."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from frasa_sysid.calibration import servo_law
from frasa_sysid.calibration.errors import CalibrationError, ModelError
from frasa_sysid.calibration.model_file import check_model_file
from frasa_sysid.calibration.plain_yaml import read_yaml
from frasa_sysid.calibration.ranges import SCHEMA, Calibration, Range

RANGES_FILE = "randomization.yaml"
SHORTEST_STEP, LONGEST_STEP = 1e-5, 1.0  # [s]
_REFUSED = (ValueError, mujoco.FatalError, mujoco.UnexpectedError)  # what MuJoCo raises of a model


def load_model(path: Path) -> mujoco.MjModel:
    """Compile a MuJoCo XML file; one that carries a friction law has it from here on in this process.

    Raises:
        ModelError: no such file, or MuJoCo cannot compile it (MuJoCo's own words are kept), or a
            friction law that cannot be evaluated.
    """
    return compile_model(load_spec(path), path)


def load_spec(path: Path) -> mujoco.MjSpec:
    """Read a MuJoCo XML file without compiling it, so that it can be changed first.

    Raises:
        ModelError: no such file, or MuJoCo cannot read it (MuJoCo's own words are kept).
    """
    if not path.exists() or path.is_dir():
        raise ModelError(f"no model at {path}: expected a MuJoCo XML file")
    check_model_file(path)
    try:
        return mujoco.MjSpec.from_file(str(path))
    except _REFUSED as error:
        raise ModelError(f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from error


def compile_model(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile what was read from a file; a friction law works from here on in this process.

    Raises:
        ModelError: MuJoCo cannot compile it (its own words are kept), or a friction law that cannot be evaluated.
    """
    try:
        model: mujoco.MjModel = spec.compile()
    except _REFUSED as error:
        raise ModelError(f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from error
    if not SHORTEST_STEP <= model.opt.timestep <= LONGEST_STEP:
        raise ModelError(
            f"{path}: timestep is {model.opt.timestep:g} s, expected {SHORTEST_STEP:g} to {LONGEST_STEP:g} s"
        )
    if servo_law.has_law(model):
        try:
            servo_law.check(model)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error
        servo_law.install()
    return model


def calibration_id(model: mujoco.MjModel) -> str | None:
    """The calibration id a model carries as the custom text `calibration_id`; None when nominal."""
    # MjModel has no accessor for custom texts as it has for custom numbers and tuples.
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "calibration_id")
    if index < 0:
        return None
    start = model.text_adr[index]
    return bytes(model.text_data[start : start + model.text_size[index]]).rstrip(b"\0").decode()


def load_calibration(model_path: Path, ranges_path: Path | None = None) -> Calibration | None:
    """The ranges that belong to a model.

    Args:
        model_path: the model file; a nominal model has no calibration.
        ranges_path: the ranges; by default `randomization.yaml` beside the model.

    Returns:
        The calibration, or None for a model without `calibration_id`.

    Raises:
        CalibrationError: the ranges are missing, broken, or carry another id.
    """
    wanted = calibration_id(load_model(model_path))
    if wanted is None and ranges_path is None:
        return None
    path = ranges_path or model_path.with_name(RANGES_FILE)
    found = read_calibration(path)
    if found.id != wanted:
        raise CalibrationError(
            f"{path} carries calibration id {found.id}, {model_path} carries {wanted}; "
            "publish both again from the same fits"
        )
    return found


def read_calibration(path: Path) -> Calibration:
    """Read a ranges file, checked field by field.

    Raises:
        CalibrationError: missing, not YAML, another schema, or a wrong field (named).
    """
    try:
        data = read_yaml(path, CalibrationError)
    except FileNotFoundError:
        raise CalibrationError(f"no ranges file at {path}: run frasa-sysid publish") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise CalibrationError(f"{path}: expected schema '{SCHEMA}'")
    try:
        return _from_dict(data)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CalibrationError(f"{path}: missing or wrong field: {error!r}") from error


def _from_dict(data: dict[str, Any]) -> Calibration:
    ranges = {
        str(name): Range(
            float(one["low"]), float(one["value"]), float(one["high"]), str(one["unit"]), str(one["origin"])
        )
        for name, one in data["parameters"].items()
    }
    together = data.get("correlation") or {"names": [], "matrix": []}
    names = tuple(str(name) for name in together["names"])
    matrix = np.array(together["matrix"], dtype=np.float64).reshape(len(names), len(names))
    return Calibration(str(data["calibration_id"]), ranges, names, matrix)

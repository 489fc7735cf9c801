"""A fit of the whole robot as it stands on disk, read back for publishing; files from strangers are not trusted."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration.bodies import LARGEST_ZERO
from frasa_sysid.errors import CalibrationError, InputError
from frasa_sysid.fit_json import ROBOT, SCHEMA, checked_interval, checked_number, checked_text, read_json
from frasa_sysid.model_mark import ModelMark
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_numbers import for_the_record, is_signed, unit_of

BASES = ("fixed", "floating", "both")  # held by the trunk, on the ground, or logs of either
FIXED = "fixed"  # how the verdict on a number begins that was declared, not fitted
LONGEST_DELAY = 0.5  # [s]; whatever is older than that is no robot under control
_LARGEST_COM, _LEAST_MASS = 1.0, 1e-6  # [m], [kg]
_MOST_PARAMETERS = 1000
_SPREADS = ("spread", "bootstrap")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class StoredRobotFit:
    """The part of a robot fit's file that publishing needs.

    Attributes:
        parameters: value, low, high, spread_low, spread_high, unit, verdict and nominal by parameter name; those of
            the table, and what made them for the record (see `robot_numbers`).
        correlated: names in the order of `correlation`; what was free stands for all that it makes.
        correlation: shape (n, n).
        base: of the robot while it was logged, see `BASES`.
        model: the model it was fitted with.
        stated: supply voltage [V] and firmware gain at which gains and force limits hold.
        frozen: sha256 of the bench fits it stood on.
        inputs: sha256 by log.
        origin: `real`, `simulated` or `mixed` logs.
        sha256: of the file.
        not_in_model: what the robot does beside and a model does not, in words.
        supply_seen: lowest and highest supply of the logs while powered [V].
        delay_jitter: lowest and highest deviation of the interval between commands in the logs [s].
    """

    parameters: dict[str, dict[str, Any]]
    correlated: tuple[str, ...]
    correlation: FloatArray
    base: str
    model: ModelMark
    stated: dict[str, float]
    frozen: tuple[str, ...]
    inputs: dict[str, str]
    origin: str
    sha256: str
    not_in_model: tuple[str, ...] = ()
    supply_seen: tuple[float, float] | None = None
    delay_jitter: tuple[float, float] | None = None

    @property
    def published(self) -> dict[str, dict[str, Any]]:
        """The parameters that have a place in a model."""
        return {name: one for name, one in self.parameters.items() if not for_the_record(name)}


def load(path: Path) -> StoredRobotFit:
    """Read the file of a robot fit.

    Raises:
        InputError: missing, not a fit of a robot, or a wrong field (named).
    """
    data, sha256 = read_json(path)
    try:
        return from_json(data, sha256)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def from_json(data: dict[str, Any], sha256: str = "") -> StoredRobotFit:
    """A robot fit from the content of its file, checked field by field.

    Raises:
        InputError: a wrong field (named).
    """
    if data.get("kind") != ROBOT or data.get("schema") != SCHEMA or data.get("servo") != "":
        raise InputError(f"not a fit of a robot: expected schema '{SCHEMA}', kind '{ROBOT}', servo ''")
    try:
        stored = _stored(data, sha256)
        for name, one in stored.parameters.items():
            _check_parameter(name, one)
        _check_whole(stored)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, CalibrationError) as error:
        raise InputError(f"missing or wrong field: {error!r}") from error
    return stored


def speaks_of(one: Mapping[str, Any]) -> bool:
    """Whether the logs speak of a number: it was neither declared nor left where it was for want of excitation."""
    return "not excited" not in one["verdict"] and not one["verdict"].startswith(FIXED)


def _stored(data: dict[str, Any], sha256: str) -> StoredRobotFit:
    names = tuple(checked_text(name) for name in data["correlation"]["names"])
    if max(len(names), len(data["parameters"])) > _MOST_PARAMETERS:
        raise ValueError(f"more than {_MOST_PARAMETERS} parameters")
    from_logs = data.get("from_logs") or {}
    return StoredRobotFit(
        parameters={checked_text(name): _parameter(data, name, one) for name, one in data["parameters"].items()},
        correlated=names,
        correlation=np.array(data["correlation"]["matrix"], dtype=np.float64).reshape(len(names), len(names)),
        base=checked_text(data["base"]),
        model=ModelMark(checked_text(data["model"]["name"]), checked_text(data["model"]["fingerprint"])),
        stated={
            key: checked_number(data["stated_at"][key], f"stated_at.{key}")
            for key in ("supply_voltage", "firmware_gain")
        },
        frozen=tuple(checked_text(one) for one in data["frozen"]),
        inputs={checked_text(name): checked_text(digest) for name, digest in data["inputs"].items()},
        origin=checked_text(data["origin"]),
        sha256=sha256,
        not_in_model=tuple(checked_text(one) for one in data.get("not_in_model", [])),
        supply_seen=checked_interval(from_logs.get("supply_voltage"), "supply_voltage", 0.0),
        delay_jitter=checked_interval(from_logs.get("delay_jitter"), "delay_jitter", -np.inf),
    )


def _parameter(data: Mapping[str, Any], name: str, one: Mapping[str, Any]) -> dict[str, Any]:
    """One parameter; its spread is the widest of interval, spread and bootstrap, which may both be missing."""
    told = [checked_interval((data.get(key) or {}).get(name), f"{key} of {name}", -np.inf) for key in _SPREADS]
    bounds = [float(one["low"]), float(one["high"]), *(value for pair in told if pair is not None for value in pair)]
    return {
        **{key: float(one[key]) for key in ("value", "low", "high", "nominal")},
        "spread_low": min(bounds),
        "spread_high": max(bounds),
        "unit": checked_text(one["unit"]),
        "verdict": checked_text(one["verdict"]),
    }


def _check_parameter(name: str, one: Mapping[str, Any]) -> None:
    unit = unit_of(name)
    if one["unit"] != unit:
        raise ValueError(f"{name} is in [{one['unit']}], expected [{unit}]")
    if not np.isfinite([one[key] for key in ("value", "low", "high", "nominal", "spread_low", "spread_high")]).all():
        raise ValueError(f"{name}: a number is not finite")
    if not one["low"] <= one["value"] <= one["high"]:
        raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} does not hold {one['value']}")
    low, high = _bounds(name)
    if not low <= one["value"] <= high:
        raise ValueError(f"{name} = {one['value']} {unit}, expected {low:g} .. {high:g}")
    if one["high"] > high or one["low"] < -high:
        raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} reaches beyond {high:g} {unit}")


def _bounds(name: str) -> tuple[float, float]:
    """What no robot goes beyond."""
    field = name.rpartition(".")[2]
    if field == "zero":
        return -LARGEST_ZERO, LARGEST_ZERO
    if is_signed(name):
        return -_LARGEST_COM, _LARGEST_COM
    if field.endswith("delay"):
        return 0.0, LONGEST_DELAY
    return (_LEAST_MASS if name == "trunk.mass" else 0.0), np.inf


def _check_whole(stored: StoredRobotFit) -> None:
    if not stored.published:
        raise ValueError("it holds no parameter of a model")
    if stored.base not in BASES:
        raise ValueError(f"base '{stored.base}', expected {', '.join(BASES)}")
    unknown = sorted(set(stored.correlated) - set(stored.parameters))
    if unknown or len(set(stored.correlated)) != len(stored.correlated):
        raise ValueError(f"correlation of unknown or repeated parameters {unknown}")
    if not np.isfinite(stored.correlation).all():
        raise ValueError("the correlation is not finite")
    if not all(value > 0.0 for value in stored.stated.values()):
        raise ValueError(f"stated_at = {stored.stated}, expected positive numbers")
    wrong = [one for one in stored.frozen if not _SHA256.fullmatch(one)]
    if wrong:
        raise ValueError(f"frozen: '{wrong[0]}' is no sha256 of a fit file")

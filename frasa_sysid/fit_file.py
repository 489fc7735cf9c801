"""A fit on disk: `robot_model/fits/<servo>.json`, written once, read by publish and compare."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration import SERVO_FIELDS, parameter, plain, sha256_of, write_atomic
from frasa_sysid.cost import Misfit
from frasa_sysid.errors import InputError
from frasa_sysid.fit import FitResult
from frasa_sysid.recording import FloatArray

SCHEMA = "frasa.fit/1"
_LARGEST = 50_000_000  # [bytes]


@dataclass(frozen=True)
class StoredFit:
    """The part of a fit file that publishing needs.

    Attributes:
        servo: servo type.
        parameters: value, unit, low, high, spread_low, spread_high, verdict by parameter name.
        correlated: names in the order of `correlation`.
        correlation: shape (n, n).
        stated: supply voltage [V] and firmware gain at which kp and force limit hold.
        inputs: sha256 by log.
        origin: `real`, `simulated` or `mixed` logs.
        sha256: of the file.
    """

    servo: str
    parameters: dict[str, dict[str, Any]]
    correlated: tuple[str, ...]
    correlation: FloatArray
    stated: dict[str, float]
    inputs: dict[str, str]
    origin: str
    sha256: str


def to_json(result: FitResult, origin: str) -> dict[str, Any]:
    """Plain data of a fit, as `--json` prints it (without `outputs`) and as the file holds it."""
    problem = result.problem
    values = problem.servo_values(result.values)
    return {
        "schema": SCHEMA,
        "servo": problem.servo.name,
        "friction": result.friction,
        "origin": origin,
        "stated_at": {
            "supply_voltage": problem.servo.supply_voltage,
            "firmware_gain": problem.servo.firmware_gain,
        },
        "parameters": _parameters(result),
        "mujoco": {field: getattr(values, field) for field in SERVO_FIELDS},
        "correlation": {
            "names": [one.name for one in problem.free],
            "matrix": np.round(result.evidence.correlation, 6).tolist(),
        },
        "misfit": {
            "nominal": _misfit(result.nominal),
            "fitted": _misfit(result.fitted),
            "held_out": _misfit(result.held_out),
            "held_out_nominal": _misfit(result.held_out_nominal),
        },
        "by_run": {"fitted": result.fitted.by_run, "held_out": result.held_out.by_run},
        "hold_out": problem.hold_out_rule,
        "runs": {"train": len(problem.train), "held_out": len(problem.held_out)},
        "stop": result.stop.name.lower(),
        "stop_message": result.stop.value,
        "trace": list(result.trace),
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 3),
        "seed": problem.seed,
        "inputs": result.inputs,
        "versions": result.versions,
    }


def save(path: Path, data: dict[str, Any]) -> None:
    """Write a fit file; it replaces an older one in one move."""
    write_atomic(path, json.dumps(plain(data), indent=2, allow_nan=False) + "\n")


def load(path: Path) -> StoredFit:
    """Read a fit file.

    Raises:
        InputError: missing, not a fit file, or a wrong field (named).
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: larger than any fit file")
        content = path.read_bytes()
        data = json.loads(content)
    except FileNotFoundError:
        raise InputError(f"no fit at {path}: make one with frasa-sysid fit LOG...") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a fit file: {error}") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f"{path} is not a fit file: expected schema '{SCHEMA}'")
    try:
        return _stored(data, sha256_of(content))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: missing or wrong field: {error!r}") from error


def model_parameters(stored: StoredFit) -> dict[str, dict[str, Any]]:
    """The parameters that have a place in a model (not the bench's offset, nor the unpowered damping)."""
    return {
        name: one
        for name, one in stored.parameters.items()
        if name.partition(".")[0] == stored.servo and name.rpartition(".")[2] in SERVO_FIELDS
    }


def _stored(data: dict[str, Any], sha256: str) -> StoredFit:
    names = tuple(str(name) for name in data["correlation"]["names"])
    matrix = np.array(data["correlation"]["matrix"], dtype=np.float64).reshape(len(names), len(names))
    parameters = {
        str(name): {
            **{key: float(one[key]) for key in ("value", "low", "high", "spread_low", "spread_high")},
            "unit": str(one["unit"]),
            "verdict": str(one["verdict"]),
        }
        for name, one in data["parameters"].items()
    }
    stored = StoredFit(
        servo=str(data["servo"]),
        parameters=parameters,
        correlated=names,
        correlation=matrix,
        stated={key: float(data["stated_at"][key]) for key in ("supply_voltage", "firmware_gain")},
        inputs={str(name): str(digest) for name, digest in data["inputs"].items()},
        origin=str(data["origin"]),
        sha256=sha256,
    )
    _check_parameters(stored)
    return stored


def _check_parameters(stored: StoredFit) -> None:
    in_model = model_parameters(stored)
    for name, one in stored.parameters.items():
        if name in in_model:
            if one["unit"] != parameter(name).unit or one["value"] < 0.0:
                raise ValueError(f"{name} = {one['value']} [{one['unit']}], expected >= 0 [{parameter(name).unit}]")
        elif name not in (f"{stored.servo}.damping_off", "bench.offset"):
            raise ValueError(f"unknown parameter '{name}' of servo '{stored.servo}'")
        # Written so that NaN fails too.
        if not (one["low"] <= one["value"] <= one["high"] and one["spread_low"] <= one["spread_high"]):
            raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} does not hold {one['value']}")
        if not np.isfinite([one["low"], one["high"], one["spread_low"], one["spread_high"]]).all():
            raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} is not finite")
    if not set(stored.correlated) <= set(stored.parameters):
        raise ValueError(f"correlation of unknown parameters {sorted(set(stored.correlated) - set(stored.parameters))}")
    if not all(np.isfinite(value) and value > 0.0 for value in stored.stated.values()):
        raise ValueError(f"stated_at = {stored.stated}, expected positive numbers")


def _parameters(result: FitResult) -> dict[str, dict[str, Any]]:
    return {
        one.name: {
            "value": one.value,
            "unit": one.unit,
            "low": one.low,
            "high": one.high,
            "verdict": one.verdict,
            "nominal": one.nominal,
            "spread_low": float(min(low, one.value)),
            "spread_high": float(max(high, one.value)),
            "record_next": one.advice,
        }
        for one, (low, high) in zip(result.evidence.estimates, result.evidence.spread, strict=True)
    }


def _misfit(errors: Misfit) -> dict[str, float]:
    return {"mae_rad": errors.mae_rad, "rmse_rad": errors.rmse_rad}

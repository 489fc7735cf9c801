"""A fit on disk: `robot_model/fits/<servo>.json`, written once, read by publish and compare."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration import SERVO_FIELDS, plain, write_atomic
from frasa_sysid.cost import Misfit
from frasa_sysid.fit import FitResult
from frasa_sysid.stored_fit import StoredFit, load, model_parameters

__all__ = ["SCHEMA", "StoredFit", "load", "model_parameters", "save", "to_json"]

SCHEMA = "frasa.fit/1"


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

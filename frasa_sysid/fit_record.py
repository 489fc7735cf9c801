"""What a fit says in plain data: the content of `robot_model/fits/<servo>.json` and of `fit --json`."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration import SERVO_FIELDS, plain, write_atomic
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.choice import Choice, Trial
from frasa_sysid.cost import Misfit
from frasa_sysid.effects import EFFECTS
from frasa_sysid.evidence import IDENTIFIED, ROUGH
from frasa_sysid.fit import FitResult
from frasa_sysid.fit_json import SCHEMA
from frasa_sysid.pieces import by_log
from frasa_sysid.readout import SEPARATED, Readout
from frasa_sysid.recording import FloatArray, Recording
from frasa_sysid.resampling import Profile
from frasa_sysid.stand_in import StandIn


@dataclass(frozen=True)
class Extras:
    """What goes into the record beside the fit itself.

    Attributes:
        origin: `real`, `simulated` or `mixed` logs.
        choice: how law and effects were chosen, when they were.
        stand_in: M1 in place of a richer law.
        bootstrap: 95 % interval of each parameter over fully refitted resampled logs, (n, 2).
        draws: how many of them.
        from_logs: what the recordings say by themselves, see `log_facts`.
        readout: what they say about the ages of their channels ...
        delay_doubt: ... and where the fitted delay is not what they say; see `readout.disagreement`.
    """

    origin: str
    choice: Choice | None = None
    stand_in: StandIn | None = None
    bootstrap: FloatArray | None = None
    draws: int = 0
    from_logs: dict[str, list[float]] | None = None
    readout: Readout | None = None
    delay_doubt: str = ""


def to_json(result: FitResult, extras: Extras) -> dict[str, Any]:
    """Plain data of a fit, as `--json` prints it (without `outputs`) and as the file holds it."""
    problem, values = result.problem, result.problem.servo_values(result.values)
    friction = values.friction()
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "servo": problem.servo.name,
        "friction": result.friction,
        "effects": list(problem.effects),
        "not_in_model": [f"{name}: {EFFECTS[name].meaning}" for name in problem.effects] + _ages(extras.readout),
        "origin": extras.origin,
        "stated_at": {
            "supply_voltage": problem.servo.supply_voltage,
            "firmware_gain": problem.servo.firmware_gain,
        },
        "stepping": result.stepping,
        "parameters": _parameters(result, extras),
        "mujoco": {field: getattr(values, field) for field in SERVO_FIELDS},
        "law": {"viscous": friction.viscous, **{name: getattr(friction, name) for name in FRICTION_FIELDS}},
        "torque_off": torque_off(result),
        "correlation": {
            "names": [one.name for one in problem.free],
            "matrix": np.round(result.evidence.correlation, 6).tolist(),
        },
        "profiles": [_profile(one) for one in result.evidence.profiles],
        "misfit": {
            "nominal": _misfit(result.nominal),
            "fitted": _misfit(result.fitted),
            "held_out": _misfit(result.held_out),
            "held_out_nominal": _misfit(result.held_out_nominal),
        },
        "by_run": {"fitted": result.fitted.by_run, "held_out": result.held_out.by_run},
        "hold_out": problem.hold_out_rule,
        "runs": {"train": len(by_log(problem.train)), "held_out": len(by_log(problem.held_out))},
        "restarts": [{"start": one.start, "cost_rad": one.cost} for one in result.solved.restarts],
        "multimodal": result.solved.multimodal,
        "stop": result.stop.name.lower(),
        "stop_message": result.stop.value,
        "trace": list(result.trace),
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 3),
        "seed": problem.seed,
        "inputs": result.inputs,
        "versions": result.versions,
    }
    if any(run.log >= 0 for run in problem.train):
        data["pieces"] = {"train": len(problem.train), "held_out": len(problem.held_out)}
    if extras.choice is not None:
        data["choice"] = _choice(extras.choice)
    if extras.stand_in is not None:
        data["as_m1"] = _stand_in(extras.stand_in)
    if extras.bootstrap is not None:
        data["bootstrap_draws"] = extras.draws
    if extras.from_logs:
        data["from_logs"] = extras.from_logs
    if extras.readout is not None:
        data["readout"] = {**extras.readout.to_json(), "doubt": extras.delay_doubt}
    return data


def save(path: Path, data: dict[str, Any]) -> None:
    """Write a fit file, to be read by `stored_fit.load`; it replaces an older one in one move."""
    write_atomic(path, json.dumps(plain(data), indent=2, allow_nan=False) + "\n")


def torque_off(result: FitResult) -> str:
    """What the servo does with its torque switched off, as far as the logs say: `coast`, `short-brake`, `unclear`."""
    estimates = {one.name.partition(".")[2]: one for one in result.evidence.estimates}
    off, on = estimates.get("damping_off"), estimates.get("damping")
    if off is None or on is None or off.verdict not in (IDENTIFIED, ROUGH):
        return "unclear"
    if off.high < 0.5 * on.low:
        return "coast"
    return "short-brake" if off.low > 0.8 * on.high else "unclear"


def log_facts(recordings: Sequence[Recording]) -> dict[str, list[float]]:
    """Ranges that need no fit: 2.5 and 97.5 % quantiles over all recordings.

    Returns:
        `supply_voltage` [V] while powered and `delay_jitter` [s], how much the interval
        between commands differs from its median; what was not recorded is left out.
    """
    supply, jitter = [], []
    for one in recordings:
        measured, enable = one.signals.get("supply_voltage"), one.signals.get("torque_enable")
        if measured is not None:
            on = np.ones(measured.t.size, bool)
            if enable is not None:
                on = enable.y[np.maximum(np.searchsorted(enable.t, measured.t, side="right") - 1, 0)] > 0.5
            supply.append(measured.y[on])
        goal = one.signals.get("goal")
        if goal is not None and goal.t.size > 2 and one.clock != "file":
            steps = np.diff(goal.t)
            jitter.append(steps - np.median(steps))
    found = {}
    for name, parts in (("supply_voltage", supply), ("delay_jitter", jitter)):
        values = np.concatenate(parts) if parts else np.zeros(0)
        if values.size:
            found[name] = [float(q) for q in np.quantile(values, (0.025, 0.975))]
    return found


def _parameters(result: FitResult, extras: Extras) -> dict[str, dict[str, Any]]:
    evidence = result.evidence
    full = extras.bootstrap if extras.bootstrap is not None else [None] * len(evidence.estimates)
    return {
        one.name: {
            "value": one.value,
            "unit": one.unit,
            "low": one.low,
            "high": one.high,
            "verdict": one.verdict,
            "nominal": one.nominal,
            # What leaving out a rig and gain changes, and what drawing the logs anew does: ranges rest on both.
            "spread_low": float(min(low, step[0], one.value)),
            "spread_high": float(max(high, step[1], one.value)),
            "bootstrap_low": float(min(step[0], one.value)),
            "bootstrap_high": float(max(step[1], one.value)),
            **({} if refit is None else {"refit_low": float(refit[0]), "refit_high": float(refit[1])}),
            "record_next": one.advice,
        }
        for one, (low, high), step, refit in zip(
            evidence.estimates, evidence.spread, evidence.bootstrap, full, strict=True
        )
    }


def _ages(readout: Readout | None) -> list[str]:
    """What a published model's reader must know about its delay, where the logs tell more than a sum."""
    return [f"read-out: {readout.words()}"] if readout is not None and readout.verdict == SEPARATED else []


def _profile(one: Profile) -> dict[str, Any]:
    return {
        "name": one.name,
        "partner": one.partner,
        "values": list(one.values),
        "rise_rad": list(one.rise),
        "low": one.low,
        "high": one.high,
    }


def _choice(choice: Choice) -> dict[str, Any]:
    return {
        "reason": choice.reason,
        "folds": [{"kind": fold.kind, "held_out": fold.label, "runs": len(fold.held)} for fold in choice.folds],
        "laws": [_trial(one) for one in choice.laws],
        "effects": [_trial(one) for one in choice.effects],
    }


def _trial(one: Trial) -> dict[str, Any]:
    return {
        "friction": one.law,
        "effects": list(one.effects),
        "free_parameters": one.numbers,
        "train_mae_rad": one.train,
        "held_out_mae_rad": one.held_out,
        "by_fold_mae_rad": list(one.by_fold),
        "p_value": one.p_value,
        "against": one.against,
    }


def _stand_in(one: StandIn) -> dict[str, Any]:
    return {
        "mujoco": {field: getattr(one.values, field) for field in SERVO_FIELDS},
        "penalty_rad": one.penalty.mae_rad,
        "loads": list(one.loads),
        "speed": one.speed,
    }


def _misfit(errors: Misfit) -> dict[str, float]:
    return {"mae_rad": errors.mae_rad, "rmse_rad": errors.rmse_rad}

"""What the file of a robot fit says."""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from frasa_sysid.bench import inputs_of, origin_of
from frasa_sysid.calibration import input_hashes, load_model, number, read
from frasa_sysid.excerpt import words as said_of
from frasa_sysid.fit import versions
from frasa_sysid.fit_record import log_facts
from frasa_sysid.model_mark import mark_of
from frasa_sysid.recording import Recording
from frasa_sysid.robot_fit import RobotFit
from frasa_sysid.robot_fit_record import Interval, RobotEstimate, RobotFitRecord, base_numbers, with_products
from frasa_sysid.stored_fit import StoredFit

SUM_ONLY = (
    "command delay and delay of positions are known as a sum only: positions are taken to be {age:g} ms old, "
    "all delays are relative to that (--position-delay)"
)


def record_of(
    args: argparse.Namespace, recordings: Sequence[Recording], fits: Sequence[StoredFit], found: RobotFit
) -> RobotFitRecord:
    """The record of a fit.

    Args:
        args: of the command.
        recordings: that were fitted.
        fits: of benches that the model had while it was.
        found: what was.
    """
    model = load_model(args.model)
    estimates = found.estimates()
    declared = _declared(args, read(model, "sensor.position_delay"))
    sd = np.sqrt(np.diag(found.covariance))
    facts = log_facts(recordings)
    bases = {run.base for run in found.problem.runs}
    return RobotFitRecord(
        with_products((*estimates, *declared), base_numbers(model, fits)),
        tuple(one.name for one in estimates),
        found.covariance / np.outer(sd, sd),
        bases.pop() if len(bases) == 1 else "both",
        mark_of(model),
        {name: number(model, f"servo_{name}") for name in ("supply_voltage", "firmware_gain")},
        tuple(one.sha256 for one in fits),
        inputs_of(recordings),
        origin_of(recordings),
        _pair(facts.get("supply_voltage")),
        _pair(facts.get("delay_jitter")),
        (SUM_ONLY.format(age=args.position_delay * 1e3),),
        {"misfit": _misfit(found), "physical_delays": _physical(found), "seed": args.seed, "versions": versions(),
         "models": input_hashes([args.model]), "parts": said_of(recordings),
         "converged": found.settled.converged, "evaluations": found.settled.evaluations},
    )  # fmt: skip


def _declared(args: argparse.Namespace, before: float) -> list[RobotEstimate]:
    """The age of positions, where it is another one than the model's [s]: the command delay is the sum less it."""
    age = float(args.position_delay)
    if age == before:
        return []
    return [RobotEstimate("sensor.position_delay", age, age, age, "fixed: declared by --position-delay", before)]


def _pair(limits: Sequence[float] | None) -> Interval | None:
    return None if limits is None else (float(limits[0]), float(limits[1]))


def _misfit(found: RobotFit) -> dict[str, Any]:
    """By stage: error of positions as for a bench, and of every channel in its own unit."""
    return {
        stage: {
            "mae_rad": channels["position"][0],
            "rmse_rad": channels["position"][1],
            "by_channel": {name: {"mae": pair[0], "rmse": pair[1]} for name, pair in channels.items()},
        }
        for stage, channels in found.errors.items()
    }


def _physical(found: RobotFit) -> dict[str, dict[str, float]]:
    """Delays as they are, without the half step by which a model's differ [s]."""
    return {
        free.name: {"value": float(x), "low": max(float(x - half), 0.0), "high": float(x + half)}
        for free, x, half in zip(found.problem.free, found.settled.x, found.half, strict=True)
        if free.kind.unit == "s"
    }

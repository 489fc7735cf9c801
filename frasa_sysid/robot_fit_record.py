"""What a fit of the whole robot says in plain data: the content of `robot_model/fits/robot.json`.

record = RobotFitRecord(estimates, ..., model=mark_of(nominal), frozen=(sha256 of each bench fit,))
record.save(path)          # read back by stored_robot_fit.load, published by frasa-sysid publish
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from frasa_sysid.calibration import SERVO_FIELDS, TRUNK_FIELDS, plain, read, servo_classes, write_atomic
from frasa_sysid.fit_json import ROBOT, SCHEMA
from frasa_sysid.model_mark import ModelMark
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_numbers import made, makes, unit_of
from frasa_sysid.stored_fit import StoredFit, model_parameters
from frasa_sysid.stored_robot_fit import from_json

Interval = tuple[float, float]


@dataclass(frozen=True)
class RobotEstimate:
    """One number of a robot fit, in the unit of its parameter.

    Attributes:
        name: of the table (`sensor.gyro_delay`, `left_knee.zero`, `mx106.kp`, `trunk.mass`), or of what was free
            (`mx106.gain_scale`, `command.delay`, ...; see `robot_numbers`), which is kept for the record.
        value, low, high: with its 95 % interval.
        verdict: `identified`, `known roughly`, `not excited`, ...; `fixed ...` for a number that was declared.
        nominal: what the fit started from: the nominal model, with the frozen bench fits applied.
        spread: what leaving out logs changes, lowest and highest.
        bootstrap: the 95 % interval over logs or pieces drawn anew.
        advice: what to record next.
    """

    name: str
    value: float
    low: float
    high: float
    verdict: str
    nominal: float
    spread: Interval | None = None
    bootstrap: Interval | None = None
    advice: str = ""


def base_numbers(nominal: mujoco.MjModel, fits: Sequence[StoredFit]) -> dict[str, float]:
    """What a robot fit stands on, by parameter name: bench fits, and the nominal model where they are silent.

    Args:
        nominal: the model.
        fits: the frozen bench fits.

    Raises:
        ModelError: the model has no servo class.
    """
    base = {f"{servo}.{field}": read(nominal, f"{servo}.{field}")
            for servo in servo_classes(nominal) for field in SERVO_FIELDS}  # fmt: skip
    base |= {f"trunk.{field}": read(nominal, f"trunk.{field}") for field in TRUNK_FIELDS}
    for one in fits:
        base |= {name: float(number["value"]) for name, number in model_parameters(one).items()}
    return base


def with_products(found: Sequence[RobotEstimate], base: Mapping[str, float]) -> tuple[RobotEstimate, ...]:
    """What was found, and what it makes of the numbers of the table, with its verdict and widths.

    Args:
        found: estimates of what was free.
        base: by parameter name, what they stand on; see `base_numbers`.
    """
    return (*found, *(_made(one, name, base[name]) for one in found for name in makes(one.name, base)))


def _made(one: RobotEstimate, name: str, base: float) -> RobotEstimate:
    def number(value: float) -> float:
        return made(one.name, value, base)

    def pair(interval: Interval | None) -> Interval | None:
        return None if interval is None else (number(interval[0]), number(interval[1]))

    return RobotEstimate(
        name,
        number(one.value),
        number(one.low),
        number(one.high),
        one.verdict,
        base,
        pair(one.spread),
        pair(one.bootstrap),
        one.advice,
    )


@dataclass(frozen=True)
class RobotFitRecord:
    """A whole-robot fit, ready to be saved.

    Attributes:
        estimates: `with_products` of what was found.
        correlated: names of `estimates` in the order of `correlation`: what was free, which stands there for all
            that it makes.
        correlation: shape (n, n).
        base: `fixed`, `floating` or `both`.
        model: `mark_of` the nominal model.
        stated: `supply_voltage` [V] and `firmware_gain` at which the model's gains and force limits hold.
        frozen: sha256 of the files of the bench fits that it stood on.
        inputs: sha256 by log.
        origin: `real`, `simulated` or `mixed` logs.
        supply_voltage: 2.5 and 97.5 % quantiles of the logged supply while powered [V].
        delay_jitter: the same of the interval between commands less its median [s].
        not_in_model: what the robot does beside and a model does not, in words.
        more: what else the file shall hold (misfit, seed, versions, ...), not read for publishing.
    """

    estimates: Sequence[RobotEstimate]
    correlated: tuple[str, ...]
    correlation: FloatArray
    base: str
    model: ModelMark
    stated: Mapping[str, float]
    frozen: tuple[str, ...]
    inputs: Mapping[str, str]
    origin: str
    supply_voltage: Interval | None = None
    delay_jitter: Interval | None = None
    not_in_model: tuple[str, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain data, checked as a reader of the file will check it.

        Raises:
            InputError: it could not be published (the wrong field is named).
        """
        seen = {"supply_voltage": self.supply_voltage, "delay_jitter": self.delay_jitter}
        data = {
            **self.more,
            "schema": SCHEMA,
            "kind": ROBOT,
            "servo": "",
            "base": self.base,
            "origin": self.origin,
            "model": {"name": self.model.name, "fingerprint": self.model.fingerprint},
            "stated_at": dict(self.stated),
            "parameters": {one.name: _number(one) for one in self.estimates},
            "correlation": {"names": self.correlated, "matrix": np.round(self.correlation, 6)},
            "spread": {one.name: one.spread for one in self.estimates if one.spread is not None},
            "bootstrap": {one.name: one.bootstrap for one in self.estimates if one.bootstrap is not None},
            "from_logs": {name: pair for name, pair in seen.items() if pair is not None},
            "not_in_model": self.not_in_model,
            "frozen": self.frozen,
            "inputs": dict(self.inputs),
        }
        checked: dict[str, Any] = plain(data)
        from_json(checked)
        return checked

    def save(self, path: Path) -> None:
        """Write the fit file; it replaces an older one in one move.

        Raises:
            InputError: it could not be published (the wrong field is named).
        """
        write_atomic(path, json.dumps(self.to_json(), indent=2, allow_nan=False) + "\n")


def _number(one: RobotEstimate) -> dict[str, Any]:
    return {
        "value": one.value,
        "unit": unit_of(one.name),
        "low": one.low,
        "high": one.high,
        "verdict": one.verdict,
        "nominal": one.nominal,
        "record_next": one.advice,
    }

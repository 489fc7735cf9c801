"""A fit as it stands on disk, read back for publishing and comparing; files from strangers are not trusted."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration import LAW_FIELDS, SERVO_FIELDS, parameter
from frasa_sysid.calibration.friction import COEFFICIENTS, FIELDS, LAWS, Friction
from frasa_sysid.calibration.parameters import LAW_COEFFICIENTS
from frasa_sysid.calibration.stepping import EULER, TRAPEZOIDAL
from frasa_sysid.effects import EFFECTS
from frasa_sysid.errors import InputError
from frasa_sysid.fit_json import SCHEMA_M1, SERVO, checked_interval, checked_number, checked_text, read_json
from frasa_sysid.recording import FloatArray

_MOST_PARAMETERS = 1000  # every rig may have an offset of its own
_OFFSET = re.compile(r"bench\.offset(\[.*\])?", re.DOTALL)
_SIGNED = ("offset", "bias", "drag")
NUMBERS = ("value", "low", "high", "spread_low", "spread_high")
_OUTSIDE = {  # unit by field, of what has no place in a model
    owner: {number.field: number.unit for one in EFFECTS.values() for number in one.numbers if number.owner == owner}
    for owner in ("servo", "bench")
}


@dataclass(frozen=True)
class StandIn:
    """The Coulomb-viscous servo that best replaces one with a richer friction law.

    Attributes:
        values: by field of `SERVO_FIELDS`, all of them.
        penalty_rad: its mean difference from that servo on the motions of the logs [rad].
        loads: lowest and highest load [N m] it was made for.
        speed: highest speed it was made for [rad/s].
    """

    values: dict[str, float]
    penalty_rad: float
    loads: tuple[float, float]
    speed: float


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
        friction: law, `m1` to `m6`.
        law: all its coefficients; None in the first schema, which did not hold them.
        stand_in: what replaces it as `m1`; None where the law is that already.
        not_in_model: what the servo does beside and a model does not, in words.
        supply_seen: lowest and highest supply of the logs while powered [V].
        delay_jitter: lowest and highest deviation of the interval between commands in the logs [s].
        stands_for: the law in whose place this fit stands; empty for a fit as it was made.
        stepping: of the bench, `euler` or `trapezoidal`; a model with these numbers has to step likewise.
    """

    servo: str
    parameters: dict[str, dict[str, Any]]
    correlated: tuple[str, ...]
    correlation: FloatArray
    stated: dict[str, float]
    inputs: dict[str, str]
    origin: str
    sha256: str
    friction: str = LAWS[0]
    law: Friction | None = None
    stand_in: StandIn | None = None
    not_in_model: tuple[str, ...] = ()
    supply_seen: tuple[float, float] | None = None
    delay_jitter: tuple[float, float] | None = None
    stands_for: str = ""
    stepping: str = EULER

    @property
    def model_law(self) -> Friction | None:
        """The law that a model has to carry; None where MuJoCo's own friction is enough."""
        return None if self.friction == LAWS[0] else self.law


def load(path: Path) -> StoredFit:
    """Read a fit file.

    Raises:
        InputError: missing, not a fit file, or a wrong field (named).
    """
    data, sha256 = read_json(path)
    if data.get("kind", SERVO) != SERVO:
        raise InputError(f"{path} is a fit of kind '{str(data['kind'])[:20]}'; expected one of a servo")
    try:
        stored = _stored(data, sha256)
        _check_parameters(stored)
        _check_law(stored)
        return stored
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: missing or wrong field: {error!r}") from error


def model_parameters(stored: StoredFit) -> dict[str, dict[str, Any]]:
    """The parameters that have a place in a model: those of its actuators, and of a law beyond `m1`."""
    fields = SERVO_FIELDS if stored.friction == LAWS[0] else SERVO_FIELDS | LAW_FIELDS
    return {
        name: one
        for name, one in stored.parameters.items()
        if name.partition(".")[0] == stored.servo and name.rpartition(".")[2] in fields
    }


def _stored(data: dict[str, Any], sha256: str) -> StoredFit:
    names = tuple(str(name) for name in data["correlation"]["names"])
    if max(len(names), len(data["parameters"])) > _MOST_PARAMETERS:
        raise ValueError(f"more than {_MOST_PARAMETERS} parameters")
    stored = StoredFit(
        servo=checked_text(data["servo"]),
        parameters={
            str(name): {
                **{key: float(one[key]) for key in NUMBERS},
                "unit": checked_text(one["unit"]),
                "verdict": checked_text(one["verdict"]),
            }
            for name, one in data["parameters"].items()
        },
        correlated=names,
        correlation=np.array(data["correlation"]["matrix"], dtype=np.float64).reshape(len(names), len(names)),
        stated={key: float(data["stated_at"][key]) for key in ("supply_voltage", "firmware_gain")},
        inputs={str(name): str(digest) for name, digest in data["inputs"].items()},
        origin=checked_text(data["origin"]),
        sha256=sha256,
    )
    if data["schema"] == SCHEMA_M1:
        return stored
    from_logs = data.get("from_logs") or {}
    return replace(
        stored,
        friction=checked_text(data["friction"]),
        law=Friction(**{name: checked_number(data["law"][name], name) for name in ("viscous", *FIELDS)}),
        stand_in=None if data.get("as_m1") is None else _stand_in(data["as_m1"]),
        not_in_model=tuple(checked_text(one) for one in data.get("not_in_model", [])),
        supply_seen=checked_interval(from_logs.get("supply_voltage"), "supply_voltage", 0.0),
        delay_jitter=checked_interval(from_logs.get("delay_jitter"), "delay_jitter", -np.inf),
        stepping=_stepping(data.get("stepping", EULER)),
    )


def _stepping(value: Any) -> str:  # noqa: ANN401 (whatever JSON holds)
    if value not in (EULER, TRAPEZOIDAL):
        raise ValueError(f"stepping = {str(value)[:40]!r}, expected '{EULER}' or '{TRAPEZOIDAL}'")
    return str(value)


def _stand_in(data: Mapping[str, Any]) -> StandIn:
    loads = checked_interval(data["loads"], "loads", -np.inf)
    if loads is None:
        raise ValueError("as_m1 without loads")
    return StandIn(
        values={field: checked_number(data["mujoco"][field], field) for field in SERVO_FIELDS},
        penalty_rad=checked_number(data["penalty_rad"], "penalty_rad"),
        loads=loads,
        speed=checked_number(data["speed"], "speed"),
    )


def _check_parameters(stored: StoredFit) -> None:
    for name, one in stored.parameters.items():
        unit = _unit(stored, name)
        if one["unit"] != unit or (one["value"] < 0.0 and name.partition(".")[2].partition("[")[0] not in _SIGNED):
            raise ValueError(f"{name} = {one['value']} [{one['unit']}], expected >= 0 [{unit}]")
        # Written so that NaN fails too.
        if not (one["low"] <= one["value"] <= one["high"] and one["spread_low"] <= one["spread_high"]):
            raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} does not hold {one['value']}")
        if not np.isfinite([one[key] for key in NUMBERS]).all():
            raise ValueError(f"{name}: the interval {one['low']} .. {one['high']} is not finite")
    if not set(stored.correlated) <= set(stored.parameters):
        raise ValueError(f"correlation of unknown parameters {sorted(set(stored.correlated) - set(stored.parameters))}")
    if not all(np.isfinite(value) and value > 0.0 for value in stored.stated.values()):
        raise ValueError(f"stated_at = {stored.stated}, expected positive numbers")


def _unit(stored: StoredFit, name: str) -> str:
    """The unit a parameter must have; the names there may be are those of the model, the firmware and the bench."""
    owner, _, field = name.partition(".")
    own = {one for one in COEFFICIENTS[stored.friction] if "=" not in one} | {"damping_off"}
    if owner == stored.servo and (field in SERVO_FIELDS or field in own):
        return parameter(name).unit
    if owner == stored.servo and field in _OUTSIDE["servo"]:
        return _OUTSIDE["servo"][field]
    if owner == "bench" and field in _OUTSIDE["bench"]:
        return _OUTSIDE["bench"][field]
    if _OFFSET.fullmatch(name):
        return "rad"
    raise ValueError(f"unknown parameter '{name}' of servo '{stored.servo}' with friction {stored.friction}")


def _check_law(stored: StoredFit) -> None:
    """The coefficients must be those of the law that is named, and those that the parameters say."""
    law = stored.law
    if law is None:
        return
    if law.stribeck_speed <= 0.0:
        raise ValueError("stribeck_speed of the law is zero")
    named = [name.partition("=") for name in COEFFICIENTS[stored.friction]]
    spare = set(FIELDS) - {"coulomb", "stribeck_speed", "stribeck_exponent"} - {name for name, _, _ in named}
    if any(getattr(law, name) != 0.0 for name in spare):
        raise ValueError(f"the law has coefficients that {stored.friction} does not: {law}")
    if any(leader and getattr(law, name) != getattr(law, leader) for name, _, leader in named):
        raise ValueError(f"motor and load share their coefficients in {stored.friction}: {law}")
    for name, one in stored.parameters.items():
        owner, _, field = name.partition(".")
        if owner == stored.servo and field in LAW_COEFFICIENTS:
            told = getattr(law, LAW_COEFFICIENTS[field])
            if not np.isclose(told, one["value"], rtol=1e-9, atol=1e-12):
                raise ValueError(f"{name} = {one['value']}, but the law says {told}")

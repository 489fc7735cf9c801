r"""Parameter files of Rhoban/bam, `m1.json` to `m6.json`: read as a `Servo`, written from a fit.

BAM's law is this package's: its `friction_viscous` and `friction_base` are K_v and K_c, its
`load_friction_base` stands for K_m = K_e, its `load_friction_external_quad` is Q_e (the load's torque
squared, while the motor is the stronger) and its `load_friction_motor_quad` Q_m. Its `q_offset` is what is
added to a reading to get the true angle, so minus the zero offset here.

A fit has more numbers than BAM; with V, P, e and u_max as in `servo`

.. math::
    \frac{k_t}{R} = \frac{forcerange}{V u_{max}} \text{ or } \frac{kp}{e P V}, \qquad
    \frac{k_t^2}{R} = damping - damping\_off

and what has no place in a BAM file is told by `Exported.notes`:

- the command delay, and every effect but a goal speed (`max_velocity`, of `sts3215` alone);
- zeros of single rigs: the common one goes into `q_offset`;
- intervals, verdicts, and the supply and gain at which kp was stated: BAM takes both from each log;
- kp and forcerange both, where they speak of different kt/R. `sts3215` has `error_gain_ratio`, a factor
  on its error gain, so kt/R is that of the force limit there and the factor makes up for kp. No other
  actuator of BAM reads such a factor: for those kt/R is that of kp, and the force limit follows it.

The other way round, the current limit that BAM gives its xl330 is in no parameter file and not read.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from frasa_sysid.calibration.bounded_read import read_limited
from frasa_sysid.calibration.friction import LAWS, Friction
from frasa_sysid.errors import InputError
from frasa_sysid.servo import NOMINAL, Servo, servo
from frasa_sysid.stored_fit import StoredFit

# BAM's actuators with the voltage law, by servo: an sts3250 is driven as an sts3215 is.
ACTUATORS: Mapping[str, str] = MappingProxyType(
    {"mx106": "mx106", "mx64": "mx64", "xl330": "xl330", "sts3215": "sts3215", "sts3250": "sts3215"}
)
_OTHER_LAWS = ("xl330i", "erob80_100", "erob80_50", "unitree_go1")  # currents and torques, not voltages
_SCALES_GAIN = ("sts3215",)  # actuators that read `error_gain_ratio` and `max_velocity`
_OWN_SPEED = 3400 * 2.0 * math.pi / 4096  # [rad/s] what BAM takes where `max_velocity` is left out
_NO_SPEED = 100.0  # [rad/s] stands for "no limit": BAM lets nothing move faster
_LARGEST_FILE = 2**20  # [bytes]
_LARGEST = 1e6  # of any number: no servo is near it
_AGREE = 1e-9  # relative difference within which kp and forcerange speak of one kt/R

_STRIBECK = {
    "friction_stribeck": ("stribeck",),
    "dtheta_stribeck": ("stribeck_speed",),
    "alpha": ("stribeck_exponent",),
}
_LOAD = {"load_friction_base": ("load_motor", "load_external")}
_LOAD_STRIBECK = {"load_friction_stribeck": ("load_motor_stribeck", "load_external_stribeck")}
_DIRECTIONAL = {
    "load_friction_motor": ("load_motor",),
    "load_friction_external": ("load_external",),
    "load_friction_motor_stribeck": ("load_motor_stribeck",),
    "load_friction_external_stribeck": ("load_external_stribeck",),
}
_QUADRATIC = {"load_friction_motor_quad": ("quad_motor",), "load_friction_external_quad": ("quad_external",)}
_BASE = {"friction_viscous": ("viscous",), "friction_base": ("coulomb",)}
# Key of the file and the coefficients it sets, by law.
_KEYS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "m1": _BASE,
        "m2": {**_BASE, **_STRIBECK},
        "m3": {**_BASE, **_LOAD},
        "m4": {**_BASE, **_STRIBECK, **_LOAD, **_LOAD_STRIBECK},
        "m5": {**_BASE, **_STRIBECK, **_DIRECTIONAL},
        "m6": {**_BASE, **_STRIBECK, **_DIRECTIONAL, **_QUADRATIC},
    }
)


@dataclass(frozen=True)
class BamParameters:
    """What a BAM parameter file says.

    Attributes:
        servo: kt, R, armature and friction of the file, firmware constants of this package; its error gain
            includes the file's `error_gain_ratio`.
        law: `m1` to `m6`.
        actuator: BAM's name of the servo.
        offset: encoder reading with the arm hanging straight down [rad].
        goal_speed: speed limit of the firmware's own goal profile [rad/s]; None without one.
    """

    servo: Servo
    law: str
    actuator: str
    offset: float = 0.0
    goal_speed: float | None = None


@dataclass(frozen=True)
class Exported:
    """A fit as BAM's file.

    Attributes:
        data: content of the file.
        notes: a sentence for each thing that the file does not carry.
    """

    data: dict[str, float | str]
    notes: tuple[str, ...]


def read(path: Path, given: Servo | None = None) -> BamParameters:
    """Read a BAM parameter file.

    Args:
        path: JSON.
        given: whose firmware constants, supply and gain hold; by default those of the servo of the actuator's name.

    Raises:
        InputError: not such a file, an actuator with another control law or that nobody knows, or a number
            that is missing or cannot be (named).
    """
    data = _parse(path)
    law, actuator = data.get("model"), data.get("actuator")
    if law not in LAWS:
        raise InputError(f"{path}: model = {_quoted(law)}, expected {', '.join(LAWS)}")
    if actuator in _OTHER_LAWS:
        raise InputError(f"{path}: actuator '{actuator}' is not driven by a voltage; no servo here is like it")
    if not isinstance(actuator, str) or (given is None and actuator not in NOMINAL):
        known = ", ".join(sorted(set(ACTUATORS.values())))
        raise InputError(f"{path}: unknown actuator {_quoted(actuator)}, expected {known}")
    known_servo = servo(actuator) if given is None else given
    coefficients = {
        name: _number(path, data, key, least=_least(key)) for key, names in _KEYS[law].items() for name in names
    }
    ratio = _number(path, data, "error_gain_ratio", 1.0, least=1e-6)
    speed = _number(path, data, "max_velocity", _OWN_SPEED, least=1e-6) if actuator in _SCALES_GAIN else _NO_SPEED
    return BamParameters(
        replace(
            known_servo,
            error_gain=known_servo.error_gain * ratio,
            kt=_number(path, data, "kt", least=1e-9),
            R=_number(path, data, "R", least=1e-9),
            armature=_number(path, data, "armature", least=0.0),
            friction=Friction(**coefficients),
            source=f"BAM parameter file {path.name}",
        ),
        law,
        actuator,
        # Plus zero, so that nothing ends up as minus zero.
        0.0 - _number(path, data, "q_offset", 0.0, least=-math.pi),
        None if speed >= _NO_SPEED else speed,
    )


def export(stored: StoredFit) -> Exported:
    """A fit in BAM's terms.

    Args:
        stored: of a servo that BAM has an actuator for.

    Raises:
        InputError: BAM has none, or no kt and R belong to the fit's numbers.
    """
    if stored.servo not in ACTUATORS:
        raise InputError(f"BAM has no actuator for '{stored.servo}'; it has some for {', '.join(ACTUATORS)}")
    actuator = ACTUATORS[stored.servo]
    values = {
        name.partition(".")[2]: float(one["value"])
        for name, one in stored.parameters.items()
        if name.partition(".")[0] in (stored.servo, "bench")
    }
    missing = [name for name in ("damping", "armature", "frictionloss") if name not in values]
    if missing or not {"kp", "forcerange"} & values.keys():
        raise InputError(f"the fit of {stored.servo} lacks {', '.join(missing) or 'both kp and forcerange'}")
    friction = _friction(stored, values)
    per_volt, ratio, notes = _torque_per_volt(stored, values, actuator)
    emf = values["damping"] - friction.viscous  # kt^2 / R
    if not (emf > 0.0 and per_volt > 0.0):
        raise InputError(
            f"the fit of {stored.servo} has no kt and R: damping {values['damping']:.4g} must be above damping_off "
            f"{friction.viscous:.4g}, and {per_volt:.4g} N m/V above 0"
        )
    data: dict[str, float | str] = {
        "kt": emf / per_volt,
        "R": emf / per_volt**2,
        "armature": values["armature"],
        "q_offset": 0.0 - values.get("offset", 0.0),
        **{key: float(getattr(friction, names[0])) for key, names in _KEYS[stored.friction].items()},
    }
    if actuator in _SCALES_GAIN:
        data["error_gain_ratio"] = ratio
        data["max_velocity"] = min(values.get("goal_speed", _NO_SPEED), _NO_SPEED)
    return Exported({**data, "model": stored.friction, "actuator": actuator}, (*notes, *_left_out(stored, values)))


def _friction(stored: StoredFit, values: Mapping[str, float]) -> Friction:
    """The law of a fit; the first schema, which is M1, says it by its parameters alone."""
    if stored.law is not None:
        return stored.law
    return Friction(values.get("damping_off", servo(stored.servo).friction.viscous), values["frictionloss"])


def _torque_per_volt(
    stored: StoredFit, values: Mapping[str, float], actuator: str
) -> tuple[float, float, tuple[str, ...]]:
    """kt/R [N m/V], what is left of the gain as a factor, and a note where something is lost."""
    known, volts = servo(stored.servo), stored.stated["supply_voltage"]
    limit = values.get("forcerange", math.nan) / (volts * known.max_duty)
    gain = values.get("kp", math.nan) / (known.error_gain * stored.stated["firmware_gain"] * volts)
    if math.isnan(limit) or math.isnan(gain) or gain <= 0.0 or math.isclose(limit, gain, rel_tol=_AGREE):
        return limit if math.isnan(gain) else gain, 1.0, ()
    if actuator in _SCALES_GAIN:
        return limit, gain / (limit or math.nan), ()
    becomes = gain * volts * known.max_duty
    note = (
        f"torque limit: {values['forcerange']:.4g} N m becomes {becomes:.4g} N m, for BAM's {actuator} has one kt/R "
        "for gain and limit"
    )
    return gain, 1.0, (note,)


def _left_out(stored: StoredFit, values: Mapping[str, float]) -> list[str]:
    notes = []
    if values.get("delay", 0.0) > 0.0:
        notes.append(f"delay: {values['delay'] * 1e3:.3g} ms; BAM acts on commands at once")
    for effect in stored.not_in_model:
        if effect.partition(":")[0] != "profile" or ACTUATORS[stored.servo] not in _SCALES_GAIN:
            notes.append(effect)
    return notes


def _parse(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(read_limited(path, _LARGEST_FILE, InputError))
    except FileNotFoundError:
        raise InputError(f"no BAM parameter file at {path}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a BAM parameter file: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path} is not a BAM parameter file: expected one JSON object")
    return data


def _least(key: str) -> float:
    """Speed and shape of the Stribeck term divide and raise; every other coefficient may be zero."""
    return 1e-9 if key in ("dtheta_stribeck", "alpha") else 0.0


def _number(path: Path, data: Mapping[str, Any], key: str, default: float | None = None, *, least: float) -> float:
    value = data.get(key, default)
    if value is None:
        raise InputError(f"{path}: '{key}' is missing; the law '{data['model']}' needs it")
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= _LARGEST:
        raise InputError(f"{path}: {key} = {_quoted(value)}, expected a number from {least:.3g} to {_LARGEST:.3g}")
    return float(value)


def _quoted(value: object) -> str:
    """Whatever a file held, short and in one line."""
    try:
        text = ascii(value)
    except RecursionError:
        return "lists within lists"
    return text if len(text) <= 80 else f"{text[:77]}..."

"""Physical numbers of a servo table: each with a unit, a source, and bounds where somebody knows some.

    stall_torque = { value = 25, unit = "kg cm", low = 20, high = 30, source = "as sold" }

Nothing is guessed: a number without a unit is refused with the units it may have.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from frasa_sysid.errors import InputError
from frasa_sysid.readers.signal_entry import check_keys

KEYS = ("value", "unit", "low", "high", "source")
_KGF_CM = 9.80665e-2  # [N m]
_TORQUE = {"N m": 1.0, "mN m": 1e-3, "kg cm": _KGF_CM, "kgf cm": _KGF_CM, "oz in": 7.0615518e-3}
_TURN = 2.0 * math.pi

# quantity -> unit -> factor to SI; of a servo that turns, and of a linear axis
UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "error_gain": {"1/rad": 1.0, "1/deg": 360.0 / _TURN},
        "voltage": {"V": 1.0, "mV": 1e-3},
        "kt": {"N m/A": 1.0, "mN m/A": 1e-3, "V s/rad": 1.0, "kg cm/A": _KGF_CM},
        "resistance": {"Ohm": 1.0, "mOhm": 1e-3},
        "stall_torque": _TORQUE,
        "no_load_speed": {"rad/s": 1.0, "deg/s": _TURN / 360.0, "rpm": _TURN / 60.0, "s/60deg": 0.0},
        "armature": {"kg m^2": 1.0, "g cm^2": 1e-7, "kg cm^2": 1e-4},
        "viscous": {"N m s/rad": 1.0, "mN m s/rad": 1e-3},
        "coulomb": _TORQUE,
    }
)
LINEAR_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        **UNITS,
        "error_gain": {"1/m": 1.0},
        "kt": {"N/A": 1.0},
        "stall_torque": {"N": 1.0},
        "no_load_speed": {"m/s": 1.0},
        "armature": {"kg": 1.0},
        "viscous": {"N s/m": 1.0},
        "coulomb": {"N": 1.0},
    }
)
SMALLEST, LARGEST = 1e-12, 1e12  # of any number, in any unit


@dataclass(frozen=True)
class Quantity:
    """A number in SI units.

    Attributes:
        value: above 0.
        limits: lowest and highest it may be; None where nobody says.
        source: where it is from; empty for the table's own.
    """

    value: float
    limits: tuple[float, float] | None = None
    source: str = ""


def quantity(where: str, kind: str, data: Any, linear: bool = False) -> Quantity:  # noqa: ANN401 - whatever TOML holds
    """A number from its inline table.

    Args:
        where: file and key, for messages.
        kind: a key of `UNITS`.
        data: what stands there.
        linear: of an axis that slides.

    Raises:
        InputError: no table, no or another unit, or a number that cannot be.
    """
    units = (LINEAR_UNITS if linear else UNITS)[kind]
    example = f'{{ value = ..., unit = "{next(iter(units))}", source = "..." }}'
    if isinstance(data, int | float) and not isinstance(data, bool):
        raise InputError(f"{where} = {data:g} has no unit: write {example}; units are {', '.join(units)}")
    if not isinstance(data, dict):
        raise InputError(f"{where}: found {str(data)[:30]!r}, expected {example}")
    check_keys(where, data, KEYS)
    if "unit" not in data:
        raise InputError(f"{where} has no unit: expected one of {', '.join(units)}")
    unit = data["unit"]
    if not isinstance(unit, str) or unit not in units:
        raise InputError(f"{where}: unit = {str(unit)[:20]!r}, expected one of {', '.join(units)}")
    source = data.get("source", "")
    if not isinstance(source, str):
        raise InputError(f"{where}: source = {str(source)[:30]!r}, expected text")
    change = _change(str(unit), units)
    value = change(above_zero(f"{where}: value", data.get("value")))
    return Quantity(value, _limits(where, data, value, change), source)


def above_zero(where: str, data: Any) -> float:  # noqa: ANN401 - whatever TOML holds
    """A number above 0, of a size that anything has.

    Raises:
        InputError: it is none.
    """
    if data is None:
        raise InputError(f"{where} is missing: expected a number above 0")
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise InputError(f"{where} = {str(data)[:30]!r}, expected a number above 0")
    if not data > 0 or data == math.inf:
        raise InputError(f"{where} = {data:g}, expected a number above 0")
    if not SMALLEST <= data <= LARGEST:  # beyond it squares and quotients leave what a float can hold
        raise InputError(f"{where} = {data:g}, expected a number from {SMALLEST:g} to {LARGEST:g}")
    return float(data)


def _change(unit: str, units: Mapping[str, float]) -> Callable[[float], float]:
    if unit == "s/60deg":  # how long a sixth of a turn takes
        return lambda value: _TURN / 6.0 / value
    return lambda value: value * units[unit]


def _limits(
    where: str, data: Mapping[str, Any], value: float, change: Callable[[float], float]
) -> tuple[float, float] | None:
    given = [name for name in ("low", "high") if name in data]
    if not given:
        return None
    if len(given) == 1:
        raise InputError(f"{where} has '{given[0]}' alone: expected both low and high, or neither")
    low, high = sorted(change(above_zero(f"{where}: {name}", data[name])) for name in given)
    if not (low < high and low <= value <= high) or (data["low"] > data["high"]):
        raise InputError(
            f"{where}: low = {data['low']:g}, value = {data['value']:g}, high = {data['high']:g}: expected low below "
            "high and the value between them"
        )
    return low, high

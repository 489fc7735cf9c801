"""Ranges of what a fit of the whole robot found, each with a stated floor, and how they move together."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from frasa_sysid.calibration import Range, parameter
from frasa_sysid.claims import Instead
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_numbers import makes
from frasa_sysid.stored_robot_fit import StoredRobotFit, speaks_of

FLOOR_RELATIVE = 0.02  # [1] of the value: another unit or another day differs by more than any interval says
FLOOR_DELAY = 0.0005  # [s] a bus is not steadier than this
FLOOR_ZERO = np.radians(0.2)  # [rad] about two counts of an encoder: horns are taken off and put on again
FLOOR_COM = 0.002  # [m] where a cable or a battery lies today
LEAST_MASS = 1e-3  # [kg]
_LEAST = {"stribeck_speed": 0.01, "mass": LEAST_MASS}  # the law divides by the one, MuJoCo by the other

Block = tuple[tuple[str, ...], FloatArray]


def robot_ranges(robot: StoredRobotFit, instead: Mapping[str, Instead]) -> dict[str, Range]:
    """The range of every number that the logs speak of, by parameter name.

    What was not excited or was declared has its place in the model, but no measured range.

    Args:
        robot: the fit.
        instead: numbers of the bench fits that it replaced. What was scaled is known no better than its base.
    """
    return {
        name: _range(robot, name, one, instead.get(name)) for name, one in robot.published.items() if speaks_of(one)
    }


def robot_block(robot: StoredRobotFit, ranges: Mapping[str, Range]) -> Block:
    """Names and correlations of those that have a range.

    What one free number makes moves as one.
    """
    names: list[str] = []
    rows: list[int] = []
    for i, free in enumerate(robot.correlated):
        for name in makes(free, ranges) or [free]:
            if name in ranges and name not in names and (name == free or name not in robot.correlated):
                names.append(name)
                rows.append(i)
    return tuple(names), robot.correlation[np.ix_(rows, rows)]


def _range(robot: StoredRobotFit, name: str, one: Mapping[str, Any], bench: Instead | None) -> Range:
    value, known = float(one["value"]), parameter(name)
    floor, words = _floor(name, value)
    low, high = min(one["spread_low"], value - floor), max(one["spread_high"], value + floor)
    origin = (
        f"robot fit {robot.sha256[:12]} of {robot.origin} logs, base {robot.base}, {one['verdict']}: 95 % interval, "
        f"joined with spread and bootstrap over logs, at least +-{words}"
    )
    if bench is not None and known.field != "delay" and bench.value > 0.0:
        scale = value / bench.value
        low, high = min(low, scale * bench.low), max(high, scale * bench.high)
        origin += f"; joined with the range of bench fit {bench.sha256[:12]}, scaled by {scale:.4g}"
    if known.field == "delay" and robot.delay_jitter is not None:
        early, late = min(robot.delay_jitter[0], 0.0), max(robot.delay_jitter[1], 0.0)
        low, high = low + early, high + late
        origin += f"; widened by the jitter of the commands, {early * 1e3:.3g} .. {late * 1e3:.3g} ms"
    if not known.signed:
        low = max(low, min(value, _LEAST.get(known.field, 0.0)))
    return Range(low, value, high, one["unit"], origin)


def _floor(name: str, value: float) -> tuple[float, str]:
    """Half of the narrowest range, in the parameter's unit and in words."""
    field = parameter(name).field
    if field.endswith("delay"):
        return FLOOR_DELAY, f"{FLOOR_DELAY * 1e3:g} ms"
    if field == "zero":
        return float(FLOOR_ZERO), f"{np.degrees(FLOOR_ZERO):.2g} deg"
    if field.startswith("com_"):
        return FLOOR_COM, f"{FLOOR_COM * 1e3:g} mm"
    return FLOOR_RELATIVE * abs(value), f"{FLOOR_RELATIVE:.0%}"

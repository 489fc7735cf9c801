"""Ranges of what was fitted: the 95 % interval, the spread over rigs, gains and resampled logs, and a stated floor."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from frasa_sysid.calibration import Calibration, Range
from frasa_sysid.published_as import price
from frasa_sysid.recording import FloatArray
from frasa_sysid.stored_fit import StoredFit, model_parameters

FLOOR_RELATIVE = 0.02  # [1] of the value: another unit or another day differs by more than any interval says
FLOOR_DELAY = 0.0005  # [s] a bus is not steadier than this
SUPPLY = "supply_voltage"
LEAST_SUPPLY = 0.5  # [1] of the stated supply; readings below are gaps of a sensor, no servo runs on so little
_LEAST = {"stribeck_speed": 0.01}  # [rad/s]; the law divides by it


def ranges_of(fits: Sequence[StoredFit], key: str, rooms: Mapping[str, float]) -> Calibration:
    """The ranges of every published parameter, correlated as in its fit.

    Args:
        fits: as they are published; no two of one servo.
        key: calibration id.
        rooms: longest delay that the model can hold [s], by servo.
    """
    ranges: dict[str, Range] = {}
    blocks: list[tuple[tuple[str, ...], FloatArray]] = []
    for stored in fits:
        known = {name: one for name, one in model_parameters(stored).items() if "not excited" not in one["verdict"]}
        ranges.update({name: _range(stored, name, one, rooms[stored.servo]) for name, one in known.items()})
        index = [i for i, name in enumerate(stored.correlated) if name in known]
        blocks.append((tuple(stored.correlated[i] for i in index), stored.correlation[np.ix_(index, index)]))
    ranges.update(_supply(fits))
    names = tuple(name for block, _ in blocks for name in block)
    matrix = np.eye(len(names))
    start = 0
    for block, values in blocks:
        matrix[start : start + len(block), start : start + len(block)] = values
        start += len(block)
    return Calibration(key, ranges, names, matrix)


def _range(stored: StoredFit, name: str, one: dict[str, Any], room: float) -> Range:
    value, field = float(one["value"]), name.rpartition(".")[2]
    floor = FLOOR_DELAY if field == "delay" else FLOOR_RELATIVE * abs(value)
    low = min(one["low"], one["spread_low"], value - floor)
    high = max(one["high"], one["spread_high"], value + floor)
    floor_text = f"{FLOOR_DELAY * 1e3:g} ms" if field == "delay" else f"{FLOOR_RELATIVE:.0%}"
    origin = (
        f"fit {stored.sha256[:12]} of {stored.origin} logs, {one['verdict']}: 95 % interval by log, joined with the "
        f"spread when any rig and gain is left out and over resampled logs, at least +-{floor_text}"
    )
    if field == "delay":
        if stored.delay_jitter is not None:
            early, late = min(stored.delay_jitter[0], 0.0), max(stored.delay_jitter[1], 0.0)
            low, high = low + early, high + late
            origin += f"; widened by the jitter of the commands, {early * 1e3:.3g} .. {late * 1e3:.3g} ms"
        high = max(value, min(high, room))  # MuJoCo would cut a longer one in silence
    if stored.stands_for:
        origin += f"; {price(stored)}"
    return Range(max(low, min(value, _LEAST.get(field, 0.0))), value, high, one["unit"], origin)


def _supply(fits: Sequence[StoredFit]) -> dict[str, Range]:
    """One supply feeds all servos: what any fit has seen, joined with the one at which their gains are stated."""
    seen = [one.supply_seen for one in fits if one.supply_seen is not None]
    if not seen:
        return {}
    stated = fits[0].stated[SUPPLY]
    low = max(LEAST_SUPPLY * stated, min(stated * (1.0 - FLOOR_RELATIVE), *(one[0] for one in seen)))
    high = max(stated * (1.0 + FLOOR_RELATIVE), *(one[1] for one in seen))
    logs = ", ".join(f"{one.sha256[:12]} of {one.origin} logs" for one in fits if one.supply_seen is not None)
    origin = (
        f"fit {logs}: 2.5 and 97.5 % quantiles of the supply measured while powered, joined with the {stated:g} V at "
        f"which gains and torque limits are stated, at least +-{FLOOR_RELATIVE:.0%}"
    )
    return {SUPPLY: Range(low, stated, high, "V", origin)}

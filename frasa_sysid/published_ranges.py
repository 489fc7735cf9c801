"""Ranges of what was fitted: the 95 % interval, the spread over rigs, gains and resampled logs, and a stated floor."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from frasa_sysid.calibration import Calibration, Range
from frasa_sysid.claims import Claims
from frasa_sysid.published_as import price
from frasa_sysid.published_robot_ranges import FLOOR_DELAY, FLOOR_RELATIVE, Block, robot_block, robot_ranges
from frasa_sysid.stored_fit import StoredFit, model_parameters
from frasa_sysid.stored_robot_fit import StoredRobotFit

SUPPLY = "supply_voltage"
LEAST_SUPPLY = 0.5  # [1] of the stated supply; readings below are gaps of a sensor, no servo runs on so little
_LEAST = {"stribeck_speed": 0.01}  # [rad/s]; the law divides by it


def ranges_of(claims: Claims, key: str, rooms: Mapping[str, float]) -> Calibration:
    """The ranges of every published parameter, correlated as in its fit.

    Args:
        claims: what is published.
        key: calibration id.
        rooms: longest delay that the model can hold [s], by servo, for those that a bench fit tells.
    """
    ranges: dict[str, Range] = {}
    blocks: list[Block] = []
    for stored in claims.benches:
        known = {name: one for name, one in model_parameters(stored).items() if "not excited" not in one["verdict"]}
        ranges.update({name: _range(stored, name, one, rooms[stored.servo]) for name, one in known.items()})
        index = [i for i, name in enumerate(stored.correlated) if name in known]
        blocks.append((tuple(stored.correlated[i] for i in index), stored.correlation[np.ix_(index, index)]))
    if claims.robot is not None:
        told = robot_ranges(claims.robot, claims.instead)
        ranges.update(told)
        blocks.append(robot_block(claims.robot, told))
    ranges.update(_supply(claims))
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


def _supply(claims: Claims) -> dict[str, Range]:
    """One supply feeds all servos: the robot's battery, else what any bench has seen.

    It is joined with the supply at which the servos' gains are stated, where the model stands.
    """
    robot = claims.robot
    sources: Sequence[StoredFit | StoredRobotFit] = claims.benches
    if robot is not None and robot.supply_seen is not None:
        sources = [robot]
    seen = [(one, one.supply_seen) for one in sources if one.supply_seen is not None]
    if not seen:
        return {}
    stated = seen[0][0].stated[SUPPLY]
    low = max(LEAST_SUPPLY * stated, min(stated * (1.0 - FLOOR_RELATIVE), *(pair[0] for _, pair in seen)))
    high = max(stated * (1.0 + FLOOR_RELATIVE), *(pair[1] for _, pair in seen))
    logs = ", ".join(f"{one.sha256[:12]} of {one.origin} logs" for one, _ in seen)
    kind = "robot fit" if seen[0][0] is robot else "fit"
    origin = (
        f"{kind} {logs}: 2.5 and 97.5 % quantiles of the supply measured while powered, joined with the {stated:g} V "
        f"at which gains and torque limits are stated, at least +-{FLOOR_RELATIVE:.0%}"
    )
    return {SUPPLY: Range(low, stated, high, "V", origin)}

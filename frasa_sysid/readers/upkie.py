"""A run of the wheeled biped Upkie, JSON lines -> recording.

stephane-caron/foxplot, commit 65d3914, `examples/data/robot.json`, Apache-2.0. A line is one cycle, nested:
`action/servo/<joint>` is commanded at `time`, `observation` was taken at `observation/time` (both seconds since 1970).
Joints have position [rad], velocity [rad/s], torque [N m], currents [A], voltage [V]; the IMU has
`angular_velocity`, `linear_acceleration` and `orientation` (w first). Every other number is kept under its path.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.clocks import compare_clocks
from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble, number
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import FloatArray, Recording, RigFacts

SERVO = {
    "position": ("position", "rad"),
    "velocity": ("velocity", "rad/s"),
    "torque": ("torque", "N m"),
    "q_current": ("q_current", "A"),
    "d_current": ("d_current", "A"),
    "voltage": ("supply_voltage", "V"),
    "temperature": ("temperature", "degC"),
}
GOALS = {"position": ("goal", "rad"), "velocity": ("goal_velocity", "rad/s"), "torque": ("goal_torque", "N m")}
IMU = {
    "angular_velocity": ("gyro", "rad/s", ("x", "y", "z")),
    "linear_acceleration": ("acceleration", "m/s^2", ("x", "y", "z")),
    "orientation": ("orientation", "1", ("w", "x", "y", "z")),
}
Cycle = Mapping[str, Any]


def read_upkie(path: Path) -> list[Recording]:
    """The one recording of such a file.

    Raises:
        LogError: not such a file, or a line of it that was cut off.
    """
    cycles = list(_cycles(path))
    sent = _column(cycles, ("time",))
    taken = _column(cycles, ("observation", "time"))
    parts = [
        *_joints(cycles, ("action", "servo"), GOALS, "goal_", sent),
        *_joints(cycles, ("observation", "servo"), SERVO, "", taken),
    ]
    if not any(part.name == "position" for part in parts):
        raise LogError(f"{path} is not an Upkie log: no observation/servo/<joint>/position")
    for key, (name, unit, axes) in IMU.items():
        y = np.array([_vector(_at(cycle, ("observation", "imu", key)), len(axes)) for cycle in cycles])
        if np.isfinite(y).any():
            parts.append(Part(name, unit, taken, y, axes))
    known = {"action.servo", "observation.servo", "observation.imu", "time", "observation.time"}
    for name in sorted({leaf for cycle in cycles for leaf in _leaves(cycle, "")}):
        if not any(name == one or name.startswith(f"{one}.") for one in known):
            clock = taken if name.startswith("observation.") else sent
            parts.append(Part(name, "raw", clock, _column(cycles, tuple(name.split(".")))))
    clocks = compare_clocks("sent", sent, "observed", taken)
    return [assemble(path, parts, RigFacts(), extra={"clocks": [clocks] if clocks else []})]


def _cycles(path: Path) -> Iterator[Cycle]:
    try:
        lines = read_bytes(path).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not JSON lines: {error}") from error
    count = 0
    for i, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            cycle = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise LogError(f"{path}: line {i} is not JSON: {error}") from error
        if not isinstance(cycle, dict) or number(cycle.get("time")) is None:
            raise LogError(f"{path}: line {i} is not an Upkie cycle: it has no 'time'")
        count += 1
        yield cycle
    if not count:
        raise LogError(f"{path} holds no cycle")


def _at(cycle: Any, keys: tuple[str, ...]) -> Any:  # noqa: ANN401 - whatever JSON holds
    for key in keys:
        cycle = cycle.get(key) if isinstance(cycle, dict) else None
    return cycle


def _column(cycles: list[Cycle], keys: tuple[str, ...]) -> FloatArray:
    values = [_at(cycle, keys) for cycle in cycles]
    found = [float(one) if isinstance(one, bool) else number(one) for one in values]
    return np.array([np.nan if one is None else one for one in found])


def _vector(value: Any, size: int) -> list[float]:  # noqa: ANN401 - whatever JSON holds
    if not isinstance(value, list) or len(value) != size:
        return [np.nan] * size
    numbers = [number(one) for one in value]
    return [np.nan if one is None else one for one in numbers]


def _joints(
    cycles: list[Cycle], place: tuple[str, ...], known: Mapping[str, tuple[str, str]], prefix: str, t: FloatArray
) -> list[Part]:
    """One signal for each quantity, one column for each joint that ever has a number of it."""
    servos = [_at(cycle, place) for cycle in cycles]
    servos = [one if isinstance(one, dict) else {} for one in servos]
    joints = sorted({joint for one in servos for joint in one if isinstance(one[joint], dict)})
    keys = dict.fromkeys(key for one in servos for joint in one.values() if isinstance(joint, dict) for key in joint)
    parts = []
    for key in keys:
        name, unit = known.get(key, (f"{prefix}{key}", "raw"))
        y = np.stack([_column(servos, (joint, key)) for joint in joints], axis=1)
        # A wheel has no commanded position, by nature: that is no fault of the log.
        alive = np.atleast_1d(np.isfinite(y).any(axis=0))
        if alive.any():
            columns = tuple(joint for joint, lives in zip(joints, alive, strict=True) if lives)
            parts.append(Part(name, unit, t, y[:, alive], columns))
    return parts


def _leaves(value: Any, path: str) -> Iterator[str]:  # noqa: ANN401 - whatever JSON holds
    if isinstance(value, dict):
        for key, one in value.items():
            if "." not in key:
                yield from _leaves(one, f"{path}.{key}" if path else key)
    elif isinstance(value, bool) or number(value) is not None:
        yield path

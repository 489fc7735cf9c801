"""A K-Bot's squat, a flat JSON list of records -> one recording of several joints.

kscalelabs/zbot-unit-tests, commit 1f12ca9, MIT. A record has `time` [s], `actuator_id`, `position` and
`commanded_position` [deg], `velocity` and `commanded_velocity` [deg/s], `torque` [N m] and gains. The records of
one instant share their time; they do not stand in its order.
"""

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble, number, read_json
from frasa_sysid.readers.robstride import joint_names
from frasa_sysid.readers.sampling import plural
from frasa_sysid.recording import Fault, Recording, RigFacts

DEGREE = np.pi / 180
# key -> signal, unit, factor
SIGNALS = {
    "position": ("position", "rad", DEGREE),
    "velocity": ("velocity", "rad/s", DEGREE),
    "commanded_position": ("goal", "rad", DEGREE),
    "commanded_velocity": ("goal_velocity", "rad/s", DEGREE),
    "torque": ("torque", "N m", 1.0),
    "commanded_torque": ("goal_torque", "N m", 1.0),
}
KEYS = ("time", "actuator_id", "position")
Frames = dict[float, dict[int, Mapping[str, Any]]]


def read_kbot(path: Path) -> list[Recording]:
    """The one recording of such a file.

    Raises:
        LogError: not such a file.
    """
    records = read_json(path)
    if not isinstance(records, list) or not records or not all(isinstance(one, dict) for one in records):
        raise LogError(f"{path} is not a K-Bot log: expected a list of records")
    found: list[Fault] = []
    frames, actuators = _frames(path, records, found)
    times = np.array(list(frames))
    names = joint_names(path.parent)
    columns = tuple(names[one][0] if one in names else str(one) for one in actuators)
    parts = []
    for key in _keys(records):
        name, unit, factor = SIGNALS.get(key, (key, "raw", 1.0))
        rows = [[_value(frame.get(one), key) for one in actuators] for frame in frames.values()]
        parts.append(Part(name, unit, times, factor * np.array(rows), columns))
    extra = {"actuators": {column: one for column, one in zip(columns, actuators, strict=True)}}
    return [assemble(path, parts, RigFacts(trajectory="squat"), found, extra)]


def _frames(path: Path, records: list[dict[str, Any]], found: list[Fault]) -> tuple[Frames, list[int]]:
    """Records by time, in the order of time, and the actuators."""
    by_time: dict[float, dict[int, Mapping[str, Any]]] = defaultdict(dict)
    backwards, again, last = 0, 0, -np.inf
    for i, record in enumerate(records):
        time, actuator = number(record.get("time")), record.get("actuator_id")
        if time is None or not isinstance(actuator, int) or isinstance(actuator, bool):
            raise LogError(f"{path}: record {i} lacks one of {', '.join(KEYS)}")
        backwards += time < last
        last = time
        again += actuator in by_time[time]
        by_time[time].setdefault(actuator, record)
    if backwards:
        text = f"records: time ran backwards {plural(backwards, 'time')}; sorted by stamp"
        found.append(Fault("time_order", backwards, text))
    if again:
        text = f"records: {plural(again, 'record')} of an actuator and a time that were there before; dropped"
        found.append(Fault("repeated_time", again, text))
    actuators = sorted({one for frame in by_time.values() for one in frame})
    lacking = sum(len(frame) < len(actuators) for frame in by_time.values())
    if lacking:
        text = f"records: {plural(lacking, 'instant')} without all of {len(actuators)} actuators; left out"
        found.append(Fault("missing_joint", lacking, text))
    whole = {time: by_time[time] for time in sorted(by_time) if len(by_time[time]) == len(actuators)}
    if not whole:
        raise LogError(f"{path}: no instant at which all of actuators {', '.join(map(str, actuators))} were read")
    return whole, actuators


def _keys(records: list[dict[str, Any]]) -> list[str]:
    keys = dict.fromkeys(key for record in records for key in record)
    return [key for key in keys if key not in ("time", "actuator_id") and _numeric(records, key)]


def _numeric(records: list[dict[str, Any]], key: str) -> bool:
    return any(number(record.get(key)) is not None for record in records)


def _value(record: Mapping[str, Any] | None, key: str) -> float:
    value = None if record is None else number(record.get(key))
    return np.nan if value is None else value

"""Runs of one Robstride actuator (chirps and steps of a K-Bot leg), JSON -> recording.

kscalelabs/ktune, history of 116a9e4, `rs_prelim/data` (2025-05), MIT. One object: `config` with the gains, `data` with
one record a sample: `time_since_start` [s], `position` and `commanded_position` [deg], chirps also `torque` [N m] and
`freq` [Hz]. A `metadata.json` in the same folder names the actuators by their number.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble, column, number, read_json
from frasa_sysid.recording import Recording, RigFacts

METADATA = ("metadata.json", "metadata.json.gz")
TIME = "time_since_start"
# key -> signal, unit, factor
SIGNALS = {
    "position": ("position", "rad", np.pi / 180),
    "commanded_position": ("goal", "rad", np.pi / 180),
    "torque": ("torque", "N m", 1.0),
    "freq": ("chirp_frequency", "Hz", 1.0),
}


def read_robstride(path: Path) -> list[Recording]:
    """The one recording of such a file.

    Raises:
        LogError: not such a file.
    """
    log = read_json(path)
    records = log.get("data") if isinstance(log, dict) else None
    config = log.get("config") if isinstance(log, dict) else None
    if not isinstance(config, dict) or not isinstance(records, list) or not records:
        raise LogError(f"{path} is not a Robstride run: expected an object with 'config' and a list 'data'")
    if not all(isinstance(one, dict) and {TIME, "position"} <= one.keys() for one in records):
        raise LogError(f"{path} is not a Robstride run: a record lacks '{TIME}' or 'position'")
    t = column(records, TIME)
    keys = [key for key in dict.fromkeys(key for one in records for key in one) if key != TIME]
    parts = []
    for key in keys:
        name, unit, factor = SIGNALS.get(key, (key, "raw", 1.0))
        parts.append(Part(name, unit, t, factor * column(records, key)))
    actuator = _actuator(config)
    rig = RigFacts(
        servo=_servo(path, actuator),
        firmware_gain=number(config.get("kp")),
        trajectory="chirp" if "freq" in keys else "steps",
    )
    return [assemble(path, parts, rig, extra={"config": config, **_joint(path, actuator)})]


def _actuator(config: Mapping[str, Any]) -> int | None:
    found = config.get("actuator_id", config.get("actuator_ids"))
    if isinstance(found, list):
        found = found[0] if len(found) == 1 else None
    return found if isinstance(found, int) and not isinstance(found, bool) else None


def joint_names(folder: Path) -> dict[int, tuple[str, str]]:
    """Joint and actuator type by number, from the metadata beside the logs; empty without it."""
    for name in METADATA:
        if (folder / name).is_file():
            table = read_json(folder / name)
            entries = table.get("joint_name_to_metadata") if isinstance(table, dict) else None
            if not isinstance(entries, dict):
                return {}
            return {
                one["id"]: (joint, str(one.get("actuator_type") or "robstride"))
                for joint, one in entries.items()
                if isinstance(one, dict) and isinstance(one.get("id"), int)
            }
    return {}


def _joint(path: Path, actuator: int | None) -> dict[str, str]:
    names = joint_names(path.parent)
    if actuator is None:
        return {}
    return {"joint": names[actuator][0] if actuator in names else str(actuator)}


def _servo(path: Path, actuator: int | None) -> str:
    names = joint_names(path.parent)
    return names[actuator][1].lower() if actuator in names else "robstride"

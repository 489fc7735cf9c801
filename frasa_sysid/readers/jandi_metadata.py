"""`metadata.json` of a Jandi run: which servo, on which rig, in which mode, with which registers."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Fault, RigFacts

MODELS = {30: "mx28", 311: "mx64", 321: "mx106"}  # Dynamixel model numbers, protocol 2
POSITION_MODES = {3: "position", 4: "extended position", 5: "current-based position"}
TICKS = 4096
_LARGEST = 2**53  # whole numbers that JSON means exactly
KEPT = ("campaign_id", "condition", "repeat", "started_at", "register_readback", "bench")


@dataclass(frozen=True)
class Facts:
    """What the metadata say.

    Attributes:
        rig: facts of the rig.
        direction: +1 or -1: the joint's sense against the servo's.
        zero_tick: encoder tick at joint angle zero.
        extra: what has no field of its own.
    """

    rig: RigFacts
    direction: int
    zero_tick: int
    extra: Mapping[str, Any]


def read_facts(path: Path) -> tuple[Facts, list[Fault]]:
    """The facts of a run, and what is to be known before they are used.

    Raises:
        LogError: not such a file, a value that cannot be, or a mode that does not follow positions.
    """
    try:
        metadata = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path} is not JSON: {error}") from error
    registers = _object(path, metadata, "register_readback")
    resolved = _object(path, _object(path, metadata, "config_snapshot"), "resolved")
    hardware = _object(path, resolved, "hardware")
    mode = _whole(path, registers, "operating_mode")
    if mode not in POSITION_MODES:
        known = ", ".join(f"{number} ({name})" for number, name in POSITION_MODES.items())
        raise LogError(f"{path}: operating mode {mode}, expected one that follows a position: {known}")
    direction = _whole(path, hardware, "direction")
    if direction not in (-1, 1):
        raise LogError(f"{path}: direction = {direction}, expected 1 or -1")
    zero_tick = _whole(path, hardware, "zero_tick")
    if not 0 <= zero_tick < TICKS:
        raise LogError(f"{path}: zero_tick = {zero_tick}, expected 0 to {TICKS - 1}")
    gain = _whole(path, registers, "position_p_gain")
    trajectory = metadata.get("trajectory")
    bare = _object(path, metadata, "bench").get("bare_horn") is True
    rig = RigFacts(
        servo=MODELS.get(_whole(path, metadata, "model_number")),
        mass=0.0 if bare else None,
        length=0.0 if bare else None,
        firmware_gain=float(gain),
        trajectory=trajectory if isinstance(trajectory, str) else None,
    )
    extra = {key: metadata[key] for key in KEPT if key in metadata} | {
        "hardware": dict(hardware),
        "operating_mode": mode,
        "control": POSITION_MODES[mode],
        "trajectory": resolved.get("trajectory"),
    }
    return Facts(rig, direction, zero_tick, extra), _notices(metadata, mode, gain, bare)


def _notices(metadata: Mapping[str, Any], mode: int, gain: int, bare: bool) -> list[Fault]:
    text = (
        f"firmware gain {gain} is in protocol 2's unit, the published numbers of mx servos go with protocol 1's: "
        "a fitted kp holds for these logs, not for a servo with the other firmware"
    )
    found = [Fault("firmware_unit", 1, text)]
    if mode == 5:
        text = (
            "operating mode 5: the position loop asks for current, not for duty; a voltage law is only an approximation"
        )
        found.append(Fault("current_based", 1, text))
    if not bare:
        found.append(
            Fault("load_unknown", 1, "not a bare horn: give --mass KG --length M, or a fit cannot know the load")
        )
    if metadata.get("valid_flag") is False:
        reason = str(metadata.get("invalid_reason") or "no reason given")[:120]
        found.append(
            Fault("declared_invalid", 1, f"its authors marked the run as invalid ({reason}); read all the same")
        )
    return found


def _object(path: Path, parent: Any, key: str) -> Mapping[str, Any]:  # noqa: ANN401 - whatever JSON holds
    value = parent.get(key) if isinstance(parent, dict) else None
    if not isinstance(value, dict):
        raise LogError(f"{path} is not the metadata of a Jandi run: no object '{key}' where one is expected")
    return value


def _whole(path: Path, parent: Mapping[str, Any], key: str) -> int:
    value = parent.get(key)
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else 0.5
    if not abs(number) < _LARGEST or number != int(number):
        raise LogError(f"{path}: '{key}' = {str(value)[:40]!r}, expected a whole number")
    return int(number)

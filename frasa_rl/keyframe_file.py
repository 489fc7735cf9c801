"""Reading and writing a file of keyframes, strictly: whatever is not as it should be is one line of error.

joints: [...], prone: {keys, rise_s}, supine: {keys, rise_s}, standing: {...}, detector: {...}
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import yaml

from frasa_rl.routine import Detector, Key, KeyframeError, Keyframes, Routine, Standing
from frasa_sysid.calibration import read_yaml, write_atomic

SCHEMA = "frasa.keyframes/1"


def load_keyframes(path: Path) -> Keyframes:
    """Read a file of keyframes.

    Raises:
        KeyframeError: no such file, not YAML, or anything in it that is not as it should be.
    """
    try:
        data = read_yaml(path, KeyframeError)
    except FileNotFoundError:
        raise KeyframeError(f"no file of keyframes at {path}") from None
    try:
        return _keyframes(data)
    except KeyframeError as error:
        raise KeyframeError(f"{path}: {error}") from None


def save_keyframes(keyframes: Keyframes, path: Path, comment: str = "") -> None:
    """Write the file, complete or not at all.

    Args:
        keyframes: what it says.
        path: where.
        comment: stands above, each line behind a `#`.
    """
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    text = yaml.dump({"schema": SCHEMA, **asdict(keyframes)}, Dumper=_Flow, sort_keys=False, width=110)
    write_atomic(path, head + text)


def _keyframes(data: object) -> Keyframes:
    top = _fields(data, "the file", {"schema", *(one.name for one in fields(Keyframes))})
    if top["schema"] != SCHEMA:
        raise KeyframeError(f"schema is {top['schema']!r}, expected {SCHEMA}")
    joints = top["joints"]
    if not isinstance(joints, list) or not all(isinstance(one, str) for one in joints):
        raise KeyframeError("joints: expected a list of names")
    standing = _fields(top["standing"], "standing", {one.name for one in fields(Standing)})
    detector = _fields(top["detector"], "detector", {one.name for one in fields(Detector)})
    return Keyframes(
        joints=tuple(joints),
        prone=_routine(top["prone"], "prone"),
        supine=_routine(top["supine"], "supine"),
        standing=Standing(
            _numbers(standing["command_deg"], "standing: command_deg"),
            _number(standing["gain"], "standing: gain"),
            _number(standing["correction_max_deg"], "standing: correction_max_deg"),
        ),
        detector=Detector(**{name: _number(value, f"detector: {name}") for name, value in detector.items()}),
    )


def _routine(data: object, side: str) -> Routine:
    routine = _fields(data, side, {"keys", "rise_s"})
    if not isinstance(routine["keys"], list):
        raise KeyframeError(f"{side}: keys: expected a list")
    keys = []
    for index, one in enumerate(routine["keys"]):
        where = f"{side}: key {index + 1}"
        key = _fields(one, where, {"duration_s", "angles_deg"})
        keys.append(Key(_number(key["duration_s"], where), _numbers(key["angles_deg"], where)))
    return Routine(tuple(keys), _number(routine["rise_s"], f"{side}: rise_s"))


def _fields(data: object, where: str, wanted: set[str]) -> Mapping[str, Any]:
    if not isinstance(data, dict):
        raise KeyframeError(f"{where}: expected a mapping with {', '.join(sorted(wanted))}")
    unknown, missing = sorted(map(str, set(data) - wanted)), sorted(wanted - set(data))
    if unknown or missing:
        parts = [f"unknown {', '.join(unknown)}"] * bool(unknown) + [f"missing {', '.join(missing)}"] * bool(missing)
        raise KeyframeError(f"{where}: {'; '.join(parts)}")
    return data


def _numbers(value: object, where: str) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise KeyframeError(f"{where}: expected a list of numbers")
    return tuple(_number(one, where) for one in value)


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise KeyframeError(f"{where}: {str(value)[:40]!r} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise KeyframeError(f"{where}: a number of {len(str(value))} digits, expected a smaller one") from None


class _Flow(yaml.SafeDumper):
    """Poses on one line each, everything else as a block."""


def _flow(dumper: _Flow, pose: tuple[Any, ...]) -> yaml.Node:
    """A tuple as a list, on one line unless it holds mappings."""
    return dumper.represent_sequence(
        "tag:yaml.org,2002:seq", pose, flow_style=not any(isinstance(one, dict) for one in pose)
    )


_Flow.add_representer(tuple, _flow)

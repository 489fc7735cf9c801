"""BAM's JSON logs (raw and processed, plain or gzipped) -> recordings.

One object a file: facts of the rig at the top, `entries` with one reading each. A raw
log has irregular `timestamp`s; a processed one has `dt` and may leave them out. What `load` is depends on the
servo: for an XL330 it is the present PWM. Its recorder (Rhoban/bam af22604, bam/xl330/record.py) reads every register
in an exchange of its own, position first and PWM third of five, and puts the stamp in their middle: so the PWM is
as old as its register, and the position two exchanges (1.4 ms) older than its own.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.sampling import make_signal
from frasa_sysid.readers.sources import Unit, read_bytes
from frasa_sysid.recording import UNITS, Fault, FloatArray, Recording, RigFacts, Signal

# entry key -> signal and unit; other numbers are kept under their own name, unit `raw`.
SIGNALS = {
    "position": ("position", "rad"),
    "speed": ("velocity", "rad/s"),
    "goal_position": ("goal", "rad"),
    "torque_enable": ("torque_enable", "1"),
    "input_volts": ("supply_voltage", "V"),
    "temp": ("temperature", "degC"),
}
# servo -> its present PWM at full duty, where `load` is that register (e-manual: 885 for 100 %)
FULL_PWM = {"xl330": 885.0}
ANGLES = ("position", "speed", "goal_position")
# header key -> rig fact
FACTS = {
    "mass": "mass",
    "length": "length",
    "arm_mass": "arm_mass",
    "kp": "firmware_gain",
    "vin": "supply_voltage",
    "motor": "servo",
    "trajectory": "trajectory",
}


def read_bam(path: Path, unit: Unit = "auto") -> list[Recording]:
    """The one recording of a BAM log.

    Args:
        path: raw or processed JSON, may be gzipped.
        unit: of angles; `deg` converts, `auto` refuses goals that can only be degrees.

    Raises:
        LogError: not such a file, or a fact or sample in it that cannot be used.
    """
    log = _parse(path)
    rig = _rig(path, log)
    times = _times(path, log)
    signals: dict[str, Signal] = {}
    found: list[Fault] = []
    for key in _keys(log["entries"]):
        name, signal_unit = SIGNALS.get(key, (key, UNITS.get(key, "raw")))
        y = _column(path, log["entries"], key)
        if unit == "deg" and key in ANGLES:
            y = np.deg2rad(y)
        signal, faults = make_signal(name, signal_unit, times, y)
        found += faults
        if signal is not None:
            signals[name] = signal
    if "position" not in signals:
        raise LogError(f"{path}: its entries hold no position")
    if unit == "auto":
        known_faults.check_radians(signals, rig, str(path), "bam")
    signals, handled = known_faults.clean(signals, rig)
    signals.update(_duty(signals, rig))
    return [
        Recording(
            name=path.name,
            signals=signals,
            rig=rig,
            origin="real",
            source=str(path),
            sha256=sha256_of_file(path),
            clock="file",
            faults=known_faults.unique([*found, *handled]),
            extra={key: value for key, value in log.items() if key != "entries" and key not in FACTS},
        )
    ]


def _duty(signals: Mapping[str, Signal], rig: RigFacts) -> dict[str, Signal]:
    """The `duty` of servos whose `load` is the present PWM, in counts or, from newer recorders, as a share of full."""
    load, full = signals.get("load"), FULL_PWM.get(rig.servo or "")
    if load is None or full is None or "duty" in signals:
        return {}
    share = np.abs(load.y).max() <= 1.0 and bool((load.y != np.round(load.y)).any())
    return {"duty": Signal("duty", "1", load.t, load.y if share else load.y / full)}


def _parse(path: Path) -> dict[str, Any]:
    data = read_bytes(path)
    try:
        log = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path} is not JSON: {error}") from error
    entries = log.get("entries") if isinstance(log, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise LogError(f"{path} is not a BAM log: expected an object with a list 'entries'")
    if not entries:
        raise LogError(f"{path}: 'entries' is empty")
    result: dict[str, Any] = log
    return result


def _rig(path: Path, log: Mapping[str, Any]) -> RigFacts:
    facts: dict[str, Any] = {}
    for key, name in FACTS.items():
        value = log.get(key)
        if value is None:
            continue
        word = name in ("servo", "trajectory")
        if isinstance(value, bool) or not isinstance(value, str if word else int | float):
            raise LogError(f"{path}: header '{key}' = {value!r}, expected {'a name' if word else 'a number'}")
        facts[name] = str(value) if word else float(value)
    if "servo" in facts:
        facts["servo"] = facts["servo"].lower()
    try:
        return RigFacts(**facts)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error


def _times(path: Path, log: Mapping[str, Any]) -> FloatArray:
    entries = log["entries"]
    if all("timestamp" in entry for entry in entries):
        times: FloatArray = _column(path, entries, "timestamp")
    elif isinstance(log.get("dt"), int | float) and log["dt"] > 0:
        times = np.arange(len(entries), dtype=np.float64) * float(log["dt"])
    else:
        raise LogError(f"{path}: neither a 'timestamp' in every entry nor a 'dt' in the header")
    finite = times[np.isfinite(times)]
    return times - finite.min() if finite.size else times


def _keys(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys of numbers, in the order of their first appearance."""
    seen: dict[str, bool] = {}
    for entry in entries:
        for key, value in entry.items():
            seen[key] = seen.get(key, False) or isinstance(value, int | float)
    return [key for key, number in seen.items() if number and key != "timestamp"]


def _column(path: Path, entries: Sequence[Mapping[str, Any]], key: str) -> FloatArray:
    """One value an entry; NaN where it has none, so that the sample is dropped and counted."""
    try:
        return np.array([math.nan if entry.get(key) is None else float(entry[key]) for entry in entries])
    except (TypeError, ValueError, OverflowError) as error:
        raise LogError(f"{path}: '{key}' is not a number in every entry: {error}") from error

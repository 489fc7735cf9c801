"""Sessions of the quadruped "Harold" (12 ST3215 servos), a wide CSV table -> recording.

mstradiotto316/harold, commit 3246cc9; no licence is stated. A row has the wall clock in `timestamp` (ISO, ms) and the
controller's own in `timestamp_ms`, `pos_`, `cmd_pos_`, `load_`, `curr_` and `temp_` of each joint [rad, raw, degC],
`bus_voltage_v`, `mode`, and further numbers; some have an IMU. The wall clock is used, the controller's is compared.
"""

from collections import defaultdict
from datetime import datetime
from pathlib import Path

import numpy as np

from frasa_sysid.clocks import compare_clocks
from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble
from frasa_sysid.readers.tables import Table, read_table
from frasa_sysid.recording import FloatArray, Recording, RigFacts

# What a column begins with -> signal and unit; the rest of its name is the joint. The longer ones first.
GROUPS = (
    ("cmd_pos_", "goal", "rad"),
    ("pos_", "position", "rad"),
    ("load_", "load", "raw"),
    ("curr_", "current", "raw"),
    ("temp_", "temperature", "degC"),
    ("imu_gyro_", "gyro", "rad/s"),
    ("imu_lin_vel_", "linear_velocity", "m/s"),
    ("imu_proj_g_", "projected_gravity", "1"),
)
CLOCK, OWN = "timestamp", "timestamp_ms"
TEXT = ("mode",)


def read_harold(path: Path) -> list[Recording]:
    """The one recording of a session.

    Raises:
        LogError: not such a file, or a field that is no number.
    """
    table = read_table(path, (CLOCK, OWN), everything=True)
    if not any(name.startswith("pos_") for name in table.names):
        raise LogError(f"{path} is not a Harold session: no column 'pos_...'")
    t = _times(table)
    groups, single = _grouped(table)
    parts = []
    for (signal, unit), members in groups.items():
        y = np.stack([table.numbers(name) for name, _ in members], axis=1)
        parts.append(Part(signal, unit, t, y, tuple(joint for _, joint in members)))
    for name in single:
        signal, unit = ("supply_voltage", "V") if name == "bus_voltage_v" else (name, "raw")
        columns = ("battery",) if name == "bus_voltage_v" else ()
        y = table.numbers(name)
        parts.append(Part(signal, unit, t, y[:, None] if columns else y, columns))
    clocks = compare_clocks("file", t, "controller", table.numbers(OWN) / 1e3)
    extra = {"modes": sorted(set(table.text("mode"))) if "mode" in table.names else []}
    return [assemble(path, parts, RigFacts(), extra={**extra, "clocks": [clocks] if clocks else []})]


def _grouped(table: Table) -> tuple[dict[tuple[str, str], list[tuple[str, str]]], list[str]]:
    groups: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    single = []
    for name in table.names:
        if name in (CLOCK, OWN, *TEXT):
            continue
        for prefix, signal, unit in GROUPS:
            if name.startswith(prefix) and len(name) > len(prefix):
                groups[signal, unit].append((name, name[len(prefix) :]))
                break
        else:
            single.append(name)
    return groups, single


def _times(table: Table) -> FloatArray:
    stamps = table.text(CLOCK)
    times = np.empty(table.rows)
    try:
        first = datetime.fromisoformat(stamps[0])
        for i, text in enumerate(stamps):
            times[i] = (datetime.fromisoformat(text) - first).total_seconds()
    except (ValueError, TypeError, OverflowError) as error:
        raise LogError(f"{table.path}: {CLOCK} is not an ISO time: {error}") from error
    return times

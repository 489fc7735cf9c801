"""Inertia and gravity of a pendulum bench from a table made by its owners, joined on mass and length."""

import csv
import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Recording

COLUMNS = ("mass", "length", "total_inertia", "total_g_bias")
SAME = 1e-6  # kg and m: closer together no two rigs are built


@dataclass(frozen=True)
class RigRow:
    """One rig of a table.

    Attributes:
        mass: load at the end of the arm [kg].
        length: axis to load [m].
        inertia: whole pendulum about the axis [kg m^2].
        gravity_torque: torque that holds the arm horizontal [N m].
    """

    mass: float
    length: float
    inertia: float
    gravity_torque: float


def read_rig_table(path: Path) -> list[RigRow]:
    """The rows of a CSV with the columns mass, length, total_inertia and total_g_bias.

    `total_g_bias` is the torque that gravity exerts at the horizontal, a negative number.

    Raises:
        LogError: not such a table, or a value in it that no rig can have.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not a text table: {error}") from error
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=None), skipinitialspace=True) if row]
    except csv.Error as error:
        raise LogError(f"{path} is not a text table: {error}") from error
    header = [name.strip() for name in (rows[0] if len(rows) > 1 else [])]
    lines = [dict(zip(header, row, strict=False)) for row in rows[1:]]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise LogError(f"{path}: no column {', '.join(missing)}; it has {', '.join(header) or 'no rows'}")
    return [_row(path, number, line) for number, line in enumerate(lines, start=2)]


def _row(path: Path, number: int, line: dict[str, str]) -> RigRow:
    try:
        mass, length, inertia, bias = (float(line[name]) for name in COLUMNS)
    except (KeyError, ValueError):  # a short row, or no number
        raise LogError(f"{path}: line {number} is not four numbers") from None
    if not all(math.isfinite(value) for value in (mass, length, inertia, bias)) or inertia < 0 or bias > 0:
        raise LogError(f"{path}: line {number}: expected total_inertia >= 0 and total_g_bias <= 0, both finite")
    return RigRow(mass, length, inertia, abs(bias))


def with_rig(recording: Recording, table: list[RigRow], source: Path) -> Recording:
    """The recording with inertia and gravity torque of its rig.

    Raises:
        LogError: the recording does not say its mass and length, or the table has no row, or two, for them.
    """
    mass, length = recording.rig.mass, recording.rig.length
    if mass is None or length is None:
        raise LogError(
            f"{recording.name}: the log declares no mass and length to look up in {source}; "
            "give --mass KG --length M, or [rig] in the map"
        )
    rows = [row for row in table if abs(row.mass - mass) <= SAME and abs(row.length - length) <= SAME]
    if len(rows) != 1:
        what = "no row" if not rows else f"{len(rows)} rows"
        raise LogError(f"{recording.name}: {source} has {what} for mass {mass:g} kg and length {length:g} m")
    rig = replace(recording.rig, inertia=rows[0].inertia, gravity_torque=rows[0].gravity_torque)
    return replace(recording, rig=rig)

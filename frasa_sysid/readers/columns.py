"""Columns and a map -> recordings: what CSV, Parquet and .npz have in common.

A format says which columns there are and gives those that are asked for, as numbers; the rest of a file is not kept.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import LogError
from frasa_sysid.readers.fields import ReadingError
from frasa_sysid.readers.parts import Part, assemble
from frasa_sysid.readers.sampling import BoolArray
from frasa_sysid.readers.signal_entry import Entry, ordered
from frasa_sysid.readers.signal_map import SignalMap, TimeSource
from frasa_sysid.readers.stamps import nanoseconds
from frasa_sysid.readers.units import TIME_UNITS
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts

PERIODS = (1e-5, 10.0)  # [s] usual time between samples; outside it the unit of the times is wrong
Values = npt.NDArray[Any]


@dataclass
class Loaded:
    """What a file holds of some columns.

    Attributes:
        columns: by name, shape (T,) or (T, k): numbers with NaN where empty; times as they stand.
        faults: what was lost.
        blank: rows in which nothing stands, shape (T,), of columns that have such.
    """

    columns: Mapping[str, Values]
    faults: list[Fault] = field(default_factory=list)
    blank: Mapping[str, BoolArray] = field(default_factory=dict)


class ColumnFile(Protocol):
    """A file of columns of one length."""

    path: Path

    def names(self) -> Sequence[str]:
        """The columns that there are."""

    def load(self, wanted: Sequence[str], times: Sequence[str]) -> Loaded:
        """Some columns: `wanted` as numbers, `times` in the type that they have."""


def read_columns(file: ColumnFile, mapping: SignalMap | None) -> list[Recording]:
    """The recordings of a table.

    Args:
        file: it.
        mapping: which columns are which signals.

    Raises:
        LogError: no map, a column that is missing, or times that cannot be those of a log.
    """
    names = list(file.names())
    listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    if mapping is None:
        raise LogError(
            f"{file.path}: say with --map FILE.toml which columns are which signals, in which unit; it holds {listed}"
        )
    entries = mapping.of("column")
    time = mapping.time
    if time is None or (time.column is None and time.rate is None):
        raise LogError(
            f"{file.path}: map {mapping.name} declares no [time] with column and unit, or rate; columns are {listed}"
        )
    chosen, lost = _chosen(entries, names, mapping.builtin)
    if not chosen:
        raise LogError(f"{file.path}: nothing that map {mapping.name} names; it holds {listed}")
    stamps = [one for one in (time.column, time.run) if one is not None]
    absent = [one for one in stamps if one not in names]
    if absent:
        raise LogError(
            f"{file.path}: no column {absent[0]}, which [time] of map {mapping.name} names; it holds {listed}"
        )
    wanted = list(dict.fromkeys(name for _, several in chosen for name in several))
    loaded = file.load(wanted, stamps)
    parts = _parts(file.path, mapping, chosen, loaded)
    t = _seconds(file.path, time, loaded.columns, parts[0].y.shape[0])
    return _recordings(file.path, time, [part._replace(t=t) for part in parts], loaded, lost)


def _chosen(
    entries: Sequence[Entry], names: Sequence[str], builtin: bool
) -> tuple[list[tuple[Entry, list[str]]], list[Fault]]:
    """The columns of each entry, and which entries have none."""
    chosen, lost = [], []
    for entry in entries:
        several = [name for name in names if entry.match(name) is not None]
        if several:
            chosen.append((entry, several))
        elif not builtin:
            lost.append(Fault("map_unused", 1, f"{entry.where}: no column {entry.column}"))
    return chosen, lost


def _parts(path: Path, mapping: SignalMap, chosen: Sequence[tuple[Entry, list[str]]], loaded: Loaded) -> list[Part]:
    """Signals without their times: the columns of all entries of one signal side by side."""
    blocks: dict[str, list[tuple[str, FloatArray]]] = {}
    places: dict[str, list[str]] = {}
    units: dict[str, str] = {}
    for entry, names in chosen:
        units.setdefault(entry.signal, entry.unit)
        if units[entry.signal] != entry.unit:
            raise LogError(f"{path}: {entry.where}: '{entry.signal}' in {entry.unit}, in {units[entry.signal]} before")
        for name in names:
            blocks.setdefault(entry.signal, []).extend(_block(path, entry, name, loaded.columns[name]))
            places.setdefault(entry.signal, []).append(name)
    parts = [_part(path, mapping, signal, units[signal], block) for signal, block in blocks.items()]
    return [part._replace(blank=_blank(loaded, places[part.name])) for part in parts]


def _blank(loaded: Loaded, names: Sequence[str]) -> BoolArray | None:
    """Rows in which some of the columns of a signal are blank and none else is missing, shape (T,); None for none."""
    # One joint that never reports must not make all rows blank; it is left out elsewhere.
    alive = [name for name in names if name not in loaded.blank or not loaded.blank[name].all()] or list(names)
    blanks = [loaded.blank[name] for name in alive if name in loaded.blank]
    if not blanks:
        return None
    found: BoolArray = np.logical_or.reduce(blanks)
    for name in alive:
        values = np.asarray(loaded.columns[name], dtype=np.float64)
        read = np.isfinite(values.reshape(len(values), math.prod(values.shape[1:]))).all(axis=1)
        found &= read | loaded.blank[name] if name in loaded.blank else read
    return found


def _block(path: Path, entry: Entry, name: str, values: Values) -> list[tuple[str, FloatArray]]:
    """Joint (empty: not named) and values of each column of one array."""
    y = entry.convert(np.asarray(values, dtype=np.float64))
    if y.ndim == 1:
        if entry.joints and len(entry.joints) > 1:
            raise LogError(
                f"{path}: {entry.where}: {len(entry.joints)} joints, but {name} is one column; give each its entry"
            )
        return [(entry.joints[0] if entry.joints else entry.match(name) or "", y)]
    if y.ndim != 2:
        raise LogError(f"{path}: {name} has {y.ndim} dimensions, expected (samples,) or (samples, joints)")
    if entry.joints is None:
        raise LogError(f"{path}: {entry.where}: {name} has {y.shape[1]} columns; name them in order: joints = [...]")
    if len(entry.joints) != y.shape[1]:
        raise LogError(f"{path}: {entry.where}: {len(entry.joints)} joints, but {name} has {y.shape[1]} columns")
    return [(joint, y[:, i]) for i, joint in enumerate(entry.joints)]


def _part(path: Path, mapping: SignalMap, signal: str, unit: str, block: Sequence[tuple[str, FloatArray]]) -> Part:
    joints = [joint for joint, _ in block]
    try:
        axes = ordered(signal, joints)
    except ReadingError as error:
        raise LogError(f"{path}: map {mapping.name}: {error}") from error
    if axes is not None:
        joints, block = [joints[i] for i in axes], [block[i] for i in axes]
    else:
        joints = [mapping.joint(joint) for joint in joints]
    if len(block) == 1:
        # One joint that the map does not name is the rig's own.
        columns = (joints[0],) if joints[0] else ()
        y = block[0][1]
        return Part(signal, unit, y, y.reshape(-1, 1) if columns else y, columns)
    if "" in joints:
        raise LogError(f'{path}: map {mapping.name}: {signal} has a joint without a name; name each: joint = "..."')
    twice = sorted({joint for joint in joints if joints.count(joint) > 1})
    if twice:
        raise LogError(f"{path}: map {mapping.name}: {signal} has joint '{twice[0]}' twice")
    y = np.stack([one for _, one in block], axis=1)
    return Part(signal, unit, y[:, 0], y, tuple(joints))


def _seconds(path: Path, time: TimeSource, columns: Mapping[str, Values], rows: int) -> FloatArray:
    """Times [s] from the first, shape (rows,); NaN where there is none."""
    if time.rate is not None:
        return np.arange(rows, dtype=np.float64) / time.rate
    values = columns[str(time.column)]
    t = _from_values(path, time, values)
    period = float(np.median(np.abs(np.diff(t[np.isfinite(t)])))) if np.isfinite(t).sum() > 2 else PERIODS[1]
    if time.run is None and not PERIODS[0] <= period <= PERIODS[1] and period > 0:
        raise LogError(
            f"{path}: samples {period:.3g} s apart if {time.column} is in {time.unit}; is that the unit of [time]?"
        )
    return t


def _from_values(path: Path, time: TimeSource, values: Values) -> FloatArray:
    dates = values.dtype.kind == "M"
    text = values.dtype.kind in "OUS"
    if time.unit == "iso" and not (dates or text):
        raise LogError(f"{path}: {time.column} holds numbers, not dates; declare its unit: s, ms, us or ns")
    if time.unit != "iso" and (dates or text):
        what = "dates" if dates else f"text such as {str(values[0])[:30]!r}"
        raise LogError(
            f'{path}: {time.column} holds {what}, not numbers in {time.unit}; declare unit = "iso" for dates'
        )
    if dates:
        whole = values.astype("datetime64[ns]").astype(np.int64)
        return np.where(np.isnat(values), np.nan, (whole - whole[~np.isnat(values)].min(initial=whole.max())) / 1e9)
    if text:
        return _from_text(path, str(time.column), values)
    factor = TIME_UNITS[time.unit]
    if values.dtype.kind in "iu":
        # Subtracted as whole numbers: a float cannot hold an epoch time to the nanosecond.
        since: FloatArray = (values - values.min()).astype(np.float64) * (factor / 1e9)
        return since
    seconds: FloatArray = values.astype(np.float64) * (factor / 1e9)
    return seconds


def _from_text(path: Path, column: str, values: Values) -> FloatArray:
    stamps = np.zeros(values.size, dtype=np.int64)
    empty = np.zeros(values.size, dtype=bool)
    for i, text in enumerate(values):
        empty[i] = text is None or not str(text).strip()
        try:
            stamps[i] = 0 if empty[i] else nanoseconds(str(text).strip(), "iso")
        except ValueError:
            raise LogError(f"{path}: {column} = {str(text)[:30]!r} in row {i + 1} is no date as in ISO 8601") from None
    first = stamps[~empty].min() if (~empty).any() else 0
    return np.where(empty, np.nan, (stamps - first) / 1e9)


def _recordings(
    path: Path, time: TimeSource, parts: Sequence[Part], loaded: Loaded, lost: Sequence[Fault]
) -> list[Recording]:
    """One recording, or one for each stretch of rows of one run."""
    found = [*loaded.faults, *lost]
    if time.run is None:
        return [assemble(path, parts, RigFacts(), found)]
    marks = loaded.columns[time.run]
    edges = np.flatnonzero(marks[1:] != marks[:-1]) + 1
    recordings = []
    for i, rows in enumerate(np.split(np.arange(marks.size), edges)):
        pieces = [part._replace(t=part.t[rows], y=part.y[rows], blank=_some(part.blank, rows)) for part in parts]
        recordings.append(assemble(path, pieces, RigFacts(), found if i == 0 else (), name=f"{path.name}#{i:02d}"))
    return recordings


def _some(blank: BoolArray | None, rows: npt.NDArray[np.int64]) -> BoolArray | None:
    return None if blank is None else blank[rows]

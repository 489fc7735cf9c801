"""One entry of a map: a topic's field, or a column, that becomes a signal."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from frasa_sysid.errors import InputError
from frasa_sysid.readers.fields import ReadingError
from frasa_sysid.readers.units import AXES, SIGNALS, TICKS, UNITS, units_of
from frasa_sysid.recording import FloatArray

KEYS = ("topic", "field", "column", "joint", "joints", "signal", "unit", "scale", "zero", "ticks_per_turn")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LARGEST = 1e300  # of a number; what is not finite is larger or compares with nothing
INSTEAD = {"N m": "torque", "A": "current"}  # what an effort of a known unit is called


@dataclass(frozen=True)
class Entry:
    """One line of a map.

    Attributes:
        where: map and number, for messages.
        topic: of messages, `*` stands for any text; None for tables.
        fields: of a message; the first that is there is read.
        column: of a table, or array of an .npz; `*` is the joint's name; None for messages.
        joints: names given, or the field of the message that holds them, or None.
        signal: what it becomes.
        unit: its SI unit.
        zero, factor: SI value = (value - zero) * factor.
    """

    where: str
    topic: str | None
    fields: tuple[str, ...]
    column: str | None
    joints: tuple[str, ...] | str | None
    signal: str
    unit: str
    zero: float
    factor: float

    def match(self, text: str) -> str | None:
        """What `*` stands for in a topic or column of that name, empty without `*`; None where it does not match."""
        pattern = self.topic if self.topic is not None else self.column
        found = _pattern(pattern or "").fullmatch(text)
        return None if found is None else "".join(found.groups())

    def convert(self, values: FloatArray) -> FloatArray:
        """Values of the log in the SI unit."""
        return (values - self.zero) * self.factor


@lru_cache(maxsize=256)
def _pattern(text: str) -> "re.Pattern[str]":
    """Of a name with `*`; each but the last takes as little as it can and is not tried again, so that it ends."""
    first, *rest = (re.escape(part) for part in text.split("*"))
    if not rest:
        return re.compile(first)
    return re.compile(first + "".join(f"(?>(.+?){part})" for part in rest[:-1]) + f"(.+){rest[-1]}", re.DOTALL)


def shown(value: object) -> str:
    """Whatever a map holds, short."""
    return repr(value)[:80]


def make_entry(where: str, row: Mapping[str, Any]) -> Entry:
    """An entry from its table.

    Raises:
        InputError: a key, name or unit that cannot be used.
    """
    check_keys(where, row, KEYS)
    topic, column, signal = (text_of(where, row, key) for key in ("topic", "column", "signal"))
    if (topic is None) == (column is None):
        raise InputError(f"{where}: expected either a 'topic' (messages) or a 'column' (tables, .npz)")
    fields = _fields(where, row, topic)
    if signal is None:
        raise InputError(f"{where}: no 'signal'; known are {', '.join(SIGNALS)}, others are kept as they are")
    if not NAME.fullmatch(signal):
        raise InputError(f"{where}: signal = '{signal}', expected a name of letters, digits and _")
    if column is not None and column.count("*") > 1:
        raise InputError(f"{where}: column = '{column}' has more than one *")
    unit, factor = _unit(where, row, signal)
    scale = number_of(where, row, "scale")
    zero = number_of(where, row, "zero")
    if scale == 0:
        raise InputError(f"{where}: scale = 0 leaves nothing")
    joints = _joints(where, row, signal, column)
    return Entry(where, topic, fields, column, joints, signal, unit, zero or 0.0, factor * (scale or 1.0))


def check_keys(where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Refuse a key that means nothing, with the one that may have been meant.

    Raises:
        InputError: such a key.
    """
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key[:60], known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"
            raise InputError(f"{where}: unknown key '{key[:60]}'; {hint}")


def ordered(signal: str, columns: Sequence[str]) -> list[int] | None:
    """For a signal of axes, where each axis stands in the columns; None for one of joints.

    Raises:
        ReadingError: the columns are not its axes.
    """
    axes = AXES.get(signal)
    if axes is None:
        return None
    if sorted(columns) != sorted(axes):
        raise ReadingError(
            f"{signal} has the axes {', '.join(axes)}, found {', '.join(columns) or 'one without a name'}"
        )
    return [list(columns).index(axis) for axis in axes]


def text_of(where: str, table: Mapping[str, Any], key: str) -> str | None:
    """A text of a table, or None.

    Raises:
        InputError: something else stands there.
    """
    value = table.get(key)
    if value is not None and not (isinstance(value, str) and value):
        raise InputError(f"{where}: {key} = {shown(value)}, expected text in quotes")
    return value


def number_of(where: str, table: Mapping[str, Any], key: str) -> float | None:
    """A finite number of a table, or None.

    Raises:
        InputError: something else stands there.
    """
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not -LARGEST <= value <= LARGEST:
        raise InputError(f"{where}: {key} = {shown(value)}, expected a number")
    return float(value)


def _fields(where: str, row: Mapping[str, Any], topic: str | None) -> tuple[str, ...]:
    value = row.get("field")
    if topic is None:
        if value is not None:
            raise InputError(f"{where}: 'field' belongs to a 'topic'; a table has columns only")
        return ()
    fields = tuple(value) if isinstance(value, list) else (value,)
    if not all(isinstance(one, str) and one for one in fields):
        raise InputError(f"{where}: no 'field' of {topic}; expected the place of its values, such as \"position\"")
    return fields


def _joints(where: str, row: Mapping[str, Any], signal: str, column: str | None) -> tuple[str, ...] | str | None:
    joint, joints = text_of(where, row, "joint"), row.get("joints")
    if joint is not None and joints is not None:
        raise InputError(f"{where}: expected 'joint' or 'joints', found both")
    if joint is not None:
        return (joint,)
    if isinstance(joints, list) and joints and all(isinstance(one, str) and one for one in joints):
        if len(set(joints)) < len(joints):
            raise InputError(f"{where}: joints names one twice")
        names = tuple(joints)
        try:
            ordered(signal, names)
        except ReadingError as error:
            raise InputError(f"{where}: {error}") from error
        return names
    if joints is None or (isinstance(joints, str) and joints and column is None):
        return joints
    raise InputError(
        f"{where}: joints = {shown(joints)}, expected names" + ("" if column else " or the field with them")
    )


def _unit(where: str, row: Mapping[str, Any], signal: str) -> tuple[str, float]:
    """SI unit and factor."""
    unit = text_of(where, row, "unit")
    can_be = ", ".join(units_of(signal))
    if unit is None:
        raise InputError(f"{where}: no unit of '{signal}'; declare one of {can_be}")
    if unit not in UNITS:
        raise InputError(f"{where}: unit = '{unit}' of '{signal}' is not known; expected one of {can_be}")
    si, factor = UNITS[unit]
    if si not in SIGNALS.get(signal, (si,)):
        instead = INSTEAD.get(si) if signal in ("effort", "goal_effort") else None
        hint = f"; an effort in {unit} is the signal '{signal.replace('effort', instead)}'" if instead else ""
        raise InputError(f"{where}: '{signal}' in {unit}, expected {can_be}{hint}")
    return si, factor / _ticks(where, row, unit)


def _ticks(where: str, row: Mapping[str, Any], unit: str) -> float:
    ticks = number_of(where, row, "ticks_per_turn")
    if unit not in TICKS:
        if ticks is not None:
            raise InputError(f"{where}: ticks_per_turn belongs to unit = \"tick\", found '{unit}'")
        return 1.0
    if ticks is None or not ticks > 0:
        raise InputError(f"{where}: unit = '{unit}' needs ticks_per_turn, such as 4096")
    if unit == "tick" and "zero" not in row:
        raise InputError(f"{where}: unit = 'tick' needs zero, the tick at 0 rad, such as 2048")
    return ticks

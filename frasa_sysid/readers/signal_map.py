"""The map of a log: which topic or column is which signal, in which unit, of which joints. One small TOML file.

    [time]                          # tables: needed; messages: only where they have no header stamp
    column = "t"                    # or field = "stamp" of a message, or rate = 100.0 [Hz] of a table without times
    unit = "ms"                     # s, ms, us, ns, or iso (2025-03-17T17:36:26.25)

    [[signal]]
    column = "q_*"                  # of a table: * is the joint's name; or topic and field of a message
    signal = "position"
    unit = "deg"                    # always declared
    # joint = "knee"                # or joints = ["hip", "knee"], or the field of a message that holds the names
    # scale = -1.0                  # (value - zero) * scale is in `unit`
    # zero = 2048                   # with unit = "tick" together with ticks_per_turn = 4096

    [joints]                        # names of the log -> names of the model
    LKnee = "left_knee"

    [rig]                           # facts that the log does not hold: those of `RigFacts`, by their names there
    servo = "mx106"
    mass = 1.2                      # [kg]
    length = 0.15                   # [m]
    firmware_gain = 16              # P

Maps that come with frasa stand in the folder `maps` and go by their file's name.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from frasa_sysid.calibration.bounded_read import read_limited
from frasa_sysid.calibration.plain_toml import parse_toml
from frasa_sysid.errors import InputError
from frasa_sysid.readers.rig_facts import rig_of
from frasa_sysid.readers.signal_entry import Entry, check_keys, make_entry, number_of, text_of
from frasa_sysid.readers.units import TIME_UNITS

FOLDER = "maps"
LARGEST = 2**16  # bytes; a map of all joints of a humanoid is a few kB
TIME_KEYS = ("column", "field", "unit", "rate", "run")
TOP_KEYS = ("description", "time", "signal", "joints", "rig")


@dataclass(frozen=True)
class TimeSource:
    """Where the time of a sample stands.

    Attributes:
        column: of a table; None where `rate` says it.
        field: of a message; None for its header stamp.
        unit: a key of `TIME_UNITS`, or `iso` for text and dates.
        rate: of a table without times [Hz].
        run: column of a table that changes where a new run begins.
    """

    column: str | None = None
    field: str | None = None
    unit: str = "s"
    rate: float | None = None
    run: str | None = None


@dataclass(frozen=True)
class SignalMap:
    """A map that was read and checked.

    Attributes:
        name: file or name of the built-in map, for messages.
        builtin: it came with frasa: what it names need not be in the log.
        time: of samples.
        entries: in the order of the file.
        joints: name of a joint in the log -> its name in the model.
        rig: facts of the rig, by their names in `RigFacts`.
    """

    name: str
    builtin: bool
    time: TimeSource | None
    entries: tuple[Entry, ...]
    joints: Mapping[str, str]
    rig: Mapping[str, Any] = field(default_factory=dict)

    def of(self, kind: Literal["topic", "column"]) -> list[Entry]:
        """The entries for messages, or those for tables.

        Raises:
            InputError: there is none of that kind.
        """
        found = [entry for entry in self.entries if getattr(entry, kind) is not None]
        if not found:
            other = "column" if kind == "topic" else "topic"
            what = "messages and tables" if kind == "topic" else "tables and messages"
            needed, given = what.split(" and ")
            raise InputError(
                f"map {self.name} is for {given} ('{other} = ...'), this log holds {needed}: give entries a '{kind}'"
            )
        return found

    def joint(self, name: str) -> str:
        """The model's name of a joint."""
        return self.joints.get(name, name)


def builtin_maps() -> list[str]:
    """Names of the maps that come with frasa."""
    return sorted(one.name.removesuffix(".toml") for one in _folder().iterdir() if one.name.endswith(".toml"))


def load_map(name: str) -> SignalMap:
    """The map of that file, or the built-in one of that name.

    Raises:
        InputError: neither, or a map that cannot be used: the message says which entry, what was found and expected.
    """
    path = Path(name)
    if path.exists():
        return parse_map(name, read_limited(path, LARGEST, InputError), builtin=False)
    known = builtin_maps()
    if name in known:
        return parse_map(name, (_folder() / f"{name}.toml").read_bytes(), builtin=True)
    raise InputError(f"--map {name}: no such file, and no built-in map of that name; built in are {', '.join(known)}")


def parse_map(name: str, content: bytes, builtin: bool) -> SignalMap:
    """A map from the bytes of its file; see `load_map`."""
    where = f"map {name}"
    try:
        table = parse_toml(content)
    except ValueError as error:
        raise InputError(f"{where} is not TOML: {error}") from error
    check_keys(where, table, TOP_KEYS)
    rows = table.get("signal")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError(
            f"{where}: expected entries '[[signal]]', found {'none' if rows is None else 'something else'}"
        )
    entries = tuple(make_entry(f"{where}: [[signal]] {i}", row) for i, row in enumerate(rows, 1))
    joints, rig = _joints(where, table.get("joints", {})), rig_of(where, table.get("rig", {}))
    return SignalMap(name, builtin, _time(where, table.get("time")), entries, joints, rig)


def _time(where: str, table: Any) -> TimeSource | None:  # noqa: ANN401 - whatever TOML holds
    if table is None:
        return None
    where = f"{where}: [time]"
    if not isinstance(table, dict):
        raise InputError(f"{where}: expected a table")
    check_keys(where, table, TIME_KEYS)
    column, field, run = (text_of(where, table, key) for key in ("column", "field", "run"))
    rate = number_of(where, table, "rate")
    if rate is not None and not rate > 0:
        raise InputError(f"{where}: rate = {rate:g}, expected samples a second, above 0")
    if [column, rate].count(None) == 0 or (column, field, rate) == (None, None, None):
        raise InputError(f"{where}: expected a 'column' (or 'rate') for tables, a 'field' for messages")
    unit = text_of(where, table, "unit")
    if unit is None and (column or field):
        raise InputError(f"{where}: no unit of '{column or field}'; declare s, ms, us, ns or iso")
    if unit not in (None, "iso", *TIME_UNITS):
        raise InputError(f"{where}: unit = '{unit}', expected one of {', '.join(TIME_UNITS)}, iso")
    return TimeSource(column, field, unit or "s", rate, run)


def _joints(where: str, table: Any) -> dict[str, str]:  # noqa: ANN401 - whatever TOML holds
    if not isinstance(table, dict) or not all(isinstance(one, str) and one for one in table.values()):
        raise InputError(f'{where}: [joints]: expected lines such as LKnee = "left_knee"')
    twice = sorted({one for one in table.values() if list(table.values()).count(one) > 1})
    if twice:
        raise InputError(f"{where}: [joints]: two joints of the log would become '{twice[0]}'")
    return dict(table)


def _folder() -> Any:  # noqa: ANN401 - a Traversable
    return resources.files("frasa_sysid.readers") / FOLDER

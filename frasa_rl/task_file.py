"""A task as a YAML file: what differs from the Sigmaban's, checked field by field; nothing in it is executed.

    schema: frasa.task/1
    joints: [{name: Knee, target_deg: 60}, ...]
    names: {trunk: pelvis, left: "{}L", right: "{}R"}

`robot_model/standup.yaml` names every field with its default.
"""

import difflib
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml

from frasa_rl.assumed import Assumed
from frasa_rl.config import Task, TaskError
from frasa_rl.task_text import SCHEMA, dump_task
from frasa_sysid.calibration import read_yaml

__all__ = ["SCHEMA", "dump_task", "load_task", "task_from"]

_HELD = tuple[tuple[str, float], ...]


def load_task(path: Path, base: Task | None = None) -> Task:
    """Read a task.

    Args:
        path: a YAML file.
        base: gives what the file does not name; by default the Sigmaban's task.

    Raises:
        TaskError: missing, not YAML, an unknown field, another type, or a number that cannot be; all in one line.
    """
    try:
        data = read_yaml(path, TaskError)
    except FileNotFoundError:
        raise TaskError(f"no task file at {path}: expected YAML; robot_model/standup.yaml shows every field") from None
    return task_from(data, str(path), base)


def task_from(data: object, source: str, base: Task | None = None) -> Task:
    """The task that plain data speaks of, such as those of a run.yaml.

    Args:
        data: a mapping of field names; nested where the task is.
        source: where it is from, for messages.
        base: gives what is not named; by default the Sigmaban's task.

    Raises:
        TaskError: an unknown field, another type, or a number that cannot be.
    """
    if not isinstance(data, dict):
        raise TaskError(f"{source}: found {_found(data)}, expected fields of a task, such as 'joints: ...'")
    said = dict(data)
    schema = said.pop("schema", SCHEMA)
    if schema != SCHEMA:
        raise TaskError(f"{source}: schema is {schema!r}: expected {SCHEMA!r}")
    task: Task = _object(said, Task, base or Task(), _Place(source, ""))
    return task


class _Place:
    """Where in the file something stands."""

    def __init__(self, source: str, path: str) -> None:
        self._source, self._path = source, path

    def __call__(self, name: str) -> "_Place":
        dot = "." if self._path and not name.startswith("[") else ""
        return _Place(self._source, f"{self._path}{dot}{name}")

    def wrong(self, found: object, expected: str) -> TaskError:
        return TaskError(f"{self}: found {_found(found)}, expected {expected}")

    def __str__(self) -> str:
        return f"{self._source}: {self._path}" if self._path else self._source


def _object(data: object, kind: Any, base: Any, place: _Place) -> Any:  # noqa: ANN401 - any dataclass of a task
    """A dataclass from a mapping; what is not named is the base's, and must be named where there is no base."""
    if not isinstance(data, dict):
        raise place.wrong(data, f"a mapping of {', '.join(one.name for one in fields(kind))}")
    known = {one.name: one for one in fields(kind)}
    for name in data:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}"
            raise TaskError(f"{place}: unknown field '{name}'; {hint}")
    hints = get_type_hints(kind)
    given = {name: _value(value, hints[name], getattr(base, name, None), place(name)) for name, value in data.items()}
    missing = [] if base is not None else [name for name in _required(kind) if name not in given]
    if missing:
        raise TaskError(f"{place}: {', '.join(missing)} missing; a {kind.__name__} here names {', '.join(known)}")
    try:
        return kind(**given) if base is None else replace(base, **given)
    except TaskError as error:
        raise TaskError(f"{place}: {error}") from None


def _required(kind: Any) -> list[str]:  # noqa: ANN401
    return [one.name for one in fields(kind) if not hasattr(kind, one.name)]


def _value(data: object, kind: Any, base: Any, place: _Place) -> Any:  # noqa: ANN401 - what an annotation says
    """A field's value, of the type that its annotation says."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        if data is None:
            return None
        rest = [one for one in get_args(kind) if one is not type(None)]
        return _value(data, rest[0], base, place)
    if origin is Literal:
        if data not in get_args(kind):
            raise place.wrong(data, " or ".join(repr(one) for one in get_args(kind)))
        return data
    if kind == _HELD:
        return _held(data, place)
    if origin is tuple:
        return _many(data, get_args(kind)[0], place)
    if is_dataclass(kind):  # an assumed range is given whole: its source speaks for its numbers
        return _object(data, kind, None if isinstance(kind, type) and issubclass(kind, Assumed) else base, place)
    return _PLAIN[kind](data, place)


def _many(data: object, kind: Any, place: _Place) -> tuple[Any, ...]:  # noqa: ANN401
    if not isinstance(data, list):
        raise place.wrong(data, "a list")
    return tuple(_value(one, kind, None, place(f"[{index}]")) for index, one in enumerate(data))


def _held(data: object, place: _Place) -> _HELD:
    """Names and angles: a mapping, or a list of pairs."""
    pairs = list(data.items()) if isinstance(data, dict) else data
    if not isinstance(pairs, list) or not all(isinstance(one, list | tuple) and len(one) == 2 for one in pairs):
        raise place.wrong(data, "actuators with their angles, such as {left_shoulder_roll: -5.0}")
    return tuple((_text(name, place), _number(angle, place(str(name)))) for name, angle in pairs)


def _number(data: object, place: _Place) -> float:
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise place.wrong(data, _number_hint(data))
    try:
        return float(data)
    except OverflowError:
        raise TaskError(f"{place}: a number of {len(str(data))} digits, expected a smaller one") from None


def _number_hint(data: object) -> str:
    """YAML takes 1e-8 for text: it wants a point in the mantissa."""
    try:
        value = float(str(data)) if isinstance(data, str) else None
    except ValueError:
        value = None
    if value is None:
        return "a number"
    return f"a number: write {yaml.safe_dump(value).splitlines()[0]}, without quotes"


def _integer(data: object, place: _Place) -> int:
    if isinstance(data, bool) or not isinstance(data, int):
        raise place.wrong(data, "a whole number")
    if abs(data) > 10**9:
        raise TaskError(f"{place}: found a number of {len(str(data))} digits, expected a smaller one")
    return data


def _text(data: object, place: _Place) -> str:
    if not isinstance(data, str):
        raise place.wrong(data, "text (in quotes where YAML would take it for something else)")
    return data


def _flag(data: object, place: _Place) -> bool:
    if not isinstance(data, bool):
        raise place.wrong(data, "true or false")
    return data


_PLAIN: dict[type, Callable[[object, _Place], object]] = {float: _number, int: _integer, str: _text, bool: _flag}


def _found(data: object) -> str:
    if data is None:
        return "nothing (null)"
    kinds = {dict: "a mapping", list: "a list", str: "the text", bool: "the flag"}
    for kind, said in kinds.items():
        if isinstance(data, kind):
            return said if kind in (dict, list) else f"{said} {str(data)[:40]!r}"
    return f"{str(data)[:40]}"

"""The numbers at a path of a decoded message, whatever the encoding was: objects with attributes, or mappings.

A path is names with dots between them. `[]` stands for all elements of a list, `[2]` for one, `*` for all names of an
object. What is found may be a number, a list of numbers or an object of numbers, whose names then are the joints. In a
DynamicJointState a path is the name of an interface.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

STEP = re.compile(r"([^\[\]]*)((?:\[\d*\])*)")
Place = tuple[str, ...]
Step = Callable[[Place, Any], Iterator[tuple[Place, Any]]]


class ReadingError(ValueError):
    """A message that is not as expected; its text says how, for the report of what was skipped."""


def member(value: Any, name: str) -> Any:  # noqa: ANN401 - attributes of generated messages, keys of objects
    """A field of a message, or None."""
    if isinstance(value, Mapping):
        return value.get(name)
    # Of a generated message only its fields: what begins with _ is Python's own.
    return None if name.startswith("_") or is_list(value) else getattr(value, name, None)


def is_list(value: Any) -> bool:  # noqa: ANN401
    """Whether a value is a list of a message."""
    return isinstance(value, np.ndarray) or (isinstance(value, Sequence) and not isinstance(value, str | bytes))


def read_field(message: Any, path: str) -> tuple[tuple[str, ...] | None, list[float]] | None:  # noqa: ANN401
    """The numbers at a path.

    Args:
        message: objects with attributes, or mappings.
        path: see the top of this file.

    Returns:
        Names (None for a list, which has none) and values, or None where the path leads nowhere. A null is NaN.

    Raises:
        ReadingError: something else than numbers stands there.
    """
    found = leaves(message, path)
    if found is None:
        return None
    names = [".".join(place) for place, _ in found]
    values = [math.nan if value is None else _number(path, value) for _, value in found]
    return (tuple(names) if names and all(names) else None), values


def leaves(message: Any, path: str) -> list[tuple[Place, Any]] | None:  # noqa: ANN401
    """What stands at a path down to single values, each with the names that lead to it; None where it leads nowhere."""
    joints, interfaces = member(message, "joint_names"), member(message, "interface_values")
    if joints is not None and interfaces is not None:
        return _interface(joints, interfaces, path)
    found = walk(message, path)
    if not found or all(value is None for _, value in found):
        return None
    return [leaf for place, value in found for leaf in _below(place, value)]


def walk(message: Any, path: str) -> list[tuple[Place, Any]]:  # noqa: ANN401
    """What stands at a path, as it is."""
    found: list[tuple[Place, Any]] = [((), message)]
    for step in _steps(path):
        found = [one for place, value in found for one in step(place, value)]
    return found


def _interface(joints: Sequence[str], interfaces: Sequence[Any], name: str) -> list[tuple[Place, Any]] | None:
    found: list[tuple[Place, Any]] = []
    for joint, one in zip(joints, interfaces, strict=True):
        values = dict(zip(member(one, "interface_names"), member(one, "values"), strict=True))
        if name in values:
            found.append(((str(joint),), values[name]))
    return found or None


def _steps(path: str) -> list[Step]:
    steps: list[Step] = []
    for part in path.split("."):
        whole = STEP.fullmatch(part)
        name, brackets = whole.groups() if whole else (part, "")
        if name:
            steps.append(_every if name == "*" else _named(name))
        steps += [_element(index) for index in re.findall(r"\[(\d*)\]", brackets)]
    return steps


def _named(name: str) -> Step:
    def step(place: Place, value: Any) -> Iterator[tuple[Place, Any]]:  # noqa: ANN401
        inside = name in value if isinstance(value, Mapping) else member(value, name) is not None
        if inside:
            yield place, member(value, name)

    return step


def _every(place: Place, value: Any) -> Iterator[tuple[Place, Any]]:  # noqa: ANN401
    if isinstance(value, Mapping):
        yield from (((*place, str(key)), one) for key, one in value.items())


def _element(index: str) -> Step:
    def step(place: Place, value: Any) -> Iterator[tuple[Place, Any]]:  # noqa: ANN401
        if is_list(value):
            yield from ((place, one) for one in (value[int(index) : int(index) + 1] if index else value))

    return step


def _below(place: Place, value: Any) -> Iterator[tuple[Place, Any]]:  # noqa: ANN401
    """Single values: those of a list without names, those of an object by their names."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from _below((*place, str(key)), one)
    elif is_list(value):
        yield from ((place, one) for one in value)
    elif axes := [name for name in ("x", "y", "z", "w") if hasattr(value, name)]:
        yield from (((*place, name), getattr(value, name)) for name in axes)
    else:
        yield place, value


def _number(path: str, value: Any) -> float:  # noqa: ANN401
    if isinstance(value, bool | int | float | np.number | np.bool_):
        return float(value)
    raise ReadingError(f"{path} holds {type(value).__name__}, expected numbers")

"""Settings by name and text, as `--set NAME=VALUE` gives them: each is what its field of `Settings` says."""

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from frasa_rl.settings import Settings
from frasa_sysid.calibration import UsageError

_WORDS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def override(settings: Settings, given: Sequence[str]) -> Settings:
    """Settings with some of them changed.

    Args:
        settings: to begin with.
        given: `NAME=VALUE` each; widths are numbers with commas, such as `256,256`; `none` is None where that can be.

    Raises:
        UsageError: no such setting, one that is given twice, or a value that is none of its type or out of range.
    """
    kinds = get_type_hints(Settings)
    changes: dict[str, Any] = {}
    for one in given:
        name, equals, text = (part.strip() for part in one.partition("="))
        if not equals:
            raise UsageError(f"--set {one}: expected NAME=VALUE")
        if name not in kinds:
            known = ", ".join(each.name for each in fields(Settings))
            raise UsageError(f"--set {one}: no setting '{name}'; there are: {known}")
        if name in changes:
            raise UsageError(f"--set {one}: {name} is set twice")
        try:
            changes[name] = _value(kinds[name], text)
        except ValueError:
            raise UsageError(f"--set {one}: expected {_wanted(kinds[name])}") from None
    return replace(settings, **changes)


def _options(kind: Any) -> tuple[Any, ...]:  # noqa: ANN401 - a type, a union or a generic
    """What a hint allows: `int | None` both."""
    return (kind,) if get_origin(kind) is tuple or not get_args(kind) else get_args(kind)


def _value(kind: Any, text: str) -> Any:  # noqa: ANN401
    """A text as what a hint says.

    Raises:
        ValueError: it is not.
    """
    options = _options(kind)
    if NoneType in options and text.lower() == "none":
        return None
    (only,) = (one for one in options if one is not NoneType)
    if only is bool:
        if text.lower() not in _WORDS:
            raise ValueError(text)
        return _WORDS[text.lower()]
    if only is float:
        number = float(text)
        if not math.isfinite(number):
            raise ValueError(text)
        return number
    if get_origin(only) is tuple:
        widths = tuple(int(one) for one in text.strip("()").rstrip(",").split(","))
        if min(widths) < 1:
            raise ValueError(text)
        return widths
    return only(text)


def _wanted(kind: Any) -> str:  # noqa: ANN401
    names: dict[Any, str] = {
        int: "a whole number", float: "a number", bool: "true or false", str: "a word", NoneType: "none",
    }  # fmt: skip
    return " or ".join(names.get(one, "whole numbers from 1 on with commas, such as 256,256") for one in _options(kind))

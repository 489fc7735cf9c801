"""What the numbers of a task may be; each check says what was found and what is expected."""

from collections.abc import Iterable
from math import inf, isfinite

from frasa_sysid.calibration import InputError


class TaskError(InputError):
    """A task is described by numbers or names that cannot be."""


def within(name: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """See that a number is finite and in low .. high, both included; None is not looked at.

    Raises:
        TaskError: it is not.
    """
    if value is not None and not (isfinite(value) and low <= value <= high):
        raise TaskError(f"{name} is {value:g}: expected {_interval(low, high)}{_space(unit)}")


def above(name: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """The same with the lower end left out.

    Raises:
        TaskError: it is not in there.
    """
    if value is not None and not (isfinite(value) and low < value <= high):
        raise TaskError(f"{name} is {value:g}: expected more than {low:g} and at most {high:g}{_space(unit)}")


def one_of(name: str, value: object, allowed: Iterable[object]) -> None:
    """See that a value is one of a few.

    Raises:
        TaskError: it is not.
    """
    choices = list(allowed)
    if value not in choices:
        raise TaskError(f"{name} is {value!r}: expected {' or '.join(repr(one) for one in choices)}")


def name_of(name: str, value: str | None) -> None:
    """See that the name of something in the model is not empty; None is not looked at.

    Raises:
        TaskError: it is.
    """
    if value is not None and not value.strip():
        raise TaskError(f"{name} is empty: expected the name of something in the model")


def pattern(name: str, value: str | None) -> None:
    """See that a name holds one pair of braces for a joint's name, and no other; None is not looked at.

    Raises:
        TaskError: it does not.
    """
    if value is not None and (value.count("{}") != 1 or set("{}") & set(value.replace("{}", ""))):
        raise TaskError(f"{name} is {value!r}: expected a name with {{}} once, where the joint's name goes")


def _interval(low: float, high: float) -> str:
    if low == -inf or high == inf:
        return f"at least {low:g}" if low > -inf else "a finite number"
    return f"{low:g} .. {high:g}"


def _space(unit: str) -> str:
    return f" {unit}" if unit else ""

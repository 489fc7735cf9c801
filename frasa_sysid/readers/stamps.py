"""When a message was made: its header stamp, or where a map says; always whole nanoseconds."""

from datetime import UTC, datetime
from typing import Any

import numpy as np

from frasa_sysid.readers.fields import ReadingError, member, walk
from frasa_sysid.readers.units import TIME_UNITS

SECOND = 10**9
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
ABOVE = ("sec", "seconds", "secs")  # ROS, Protobuf, ROS 1 as JSON
BELOW = ("nanosec", "nsec", "nanos", "nsecs")


def stamp_of(message: Any) -> int | None:  # noqa: ANN401 - a decoded message
    """The header stamp or `timestamp` of a message [ns]; None without one, 0 where it was not filled in.

    Raises:
        ReadingError: a number alone, whose unit nobody declared.
    """
    stamp = member(member(message, "header"), "stamp") or member(message, "timestamp")
    if isinstance(stamp, int | float | str):
        raise ReadingError("a stamp without a unit: declare it as [time] field and unit in a map")
    return None if stamp is None else _of_parts(stamp)


def stamp_at(message: Any, path: str, unit: str) -> int | None:  # noqa: ANN401
    """The stamp at a path of a message [ns]; None where there is none.

    Args:
        message: decoded.
        path: of a number, a text, or seconds with nanoseconds.
        unit: of a number, `iso` for a text.

    Raises:
        ValueError: something else stands there.
    """
    found = walk(message, path)
    if not found or found[0][1] is None:
        return None
    value = found[0][1]
    parts = _of_parts(value)
    return nanoseconds(value, unit) if parts is None else parts


def nanoseconds(value: Any, unit: str) -> int:  # noqa: ANN401
    """A stamp in the unit that was declared, as whole nanoseconds.

    Raises:
        ValueError: it is no such stamp.
    """
    if unit == "iso":
        moment = datetime.fromisoformat(str(value))
        since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - EPOCH
        return (since.days * 86400 + since.seconds) * SECOND + since.microseconds * 1000
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ReadingError(f"a stamp of {type(value).__name__}, expected a number")
    # Whole numbers stay whole: a float cannot hold an epoch time to the nanosecond.
    factor = TIME_UNITS[unit]
    return int(value) * factor if isinstance(value, int | np.integer) else round(float(value) * factor)


def _of_parts(stamp: Any) -> int | None:  # noqa: ANN401
    above, below = _first(stamp, ABOVE), _first(stamp, BELOW)
    return None if above is None or below is None else int(above) * SECOND + int(below)


def _first(stamp: Any, names: tuple[str, ...]) -> Any:  # noqa: ANN401
    return next((value for name in names if (value := member(stamp, name)) is not None), None)

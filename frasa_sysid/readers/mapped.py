"""A decoded message and a map -> readings."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from frasa_sysid.readers.decoders import Decoded, Extract, Reading
from frasa_sysid.readers.fields import ReadingError, leaves, read_field
from frasa_sysid.readers.signal_entry import Entry, ordered
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.readers.stamps import stamp_at, stamp_of
from frasa_sysid.recording import Fault


def extractor_of(mapping: SignalMap, topic: str) -> Extract | None:
    """What reads a topic's messages by the map; None for a topic that it does not name."""
    entries = [entry for entry in mapping.of("topic") if entry.match(topic) is not None]
    if not entries:
        return None

    def extract(message: Any, _topic: str) -> Decoded:  # noqa: ANN401 - a decoded message
        found = [reading for entry in entries if (reading := _reading(entry, mapping, message)) is not None]
        if not found:
            raise ReadingError(f"without {' or '.join(dict.fromkeys(entry.fields[0] for entry in entries))}")
        return Decoded(_stamp(mapping, message), [one for one in found if len(one.values)])

    return extract


def rank_in(mapping: SignalMap, topic: str, signal: str) -> int:
    """Which entry gave a topic's signal: where several do, the first in the map is the main one."""
    entries = enumerate(mapping.of("topic"))
    return next(i for i, entry in entries if entry.signal == signal and entry.match(topic) is not None)


def unused_entries(mapping: SignalMap, found: Iterable[tuple[str, str]]) -> list[Fault]:
    """Entries of a user's own map that met nothing; a built-in map names what a robot may have.

    Args:
        mapping: the map.
        found: topic (or column) and signal of all that was read.
    """
    if mapping.builtin:
        return []
    found = list(found)
    lost = [
        entry
        for entry in mapping.entries
        if entry.topic is not None
        and not any(signal == entry.signal and entry.match(topic) is not None for topic, signal in found)
    ]
    return [Fault("map_unused", 1, f"{one.where}: nothing of '{one.signal}' on {one.topic}") for one in lost]


def _reading(entry: Entry, mapping: SignalMap, message: Any) -> Reading | None:  # noqa: ANN401
    """One signal's reading, without values where the message left them empty; None where the field is absent."""
    found = next((one for field in entry.fields if (one := read_field(message, field)) is not None), None)
    # By the definition of an Imu message a covariance of -1 says that the sensor does not give this quantity.
    if found is None or read_field(message, f"{entry.fields[0]}_covariance[0]") == (None, [-1.0]):
        return None
    names, values = found
    if not values:
        return Reading(entry.signal, entry.unit, (), ())
    columns = _columns(entry, message, names, len(values))
    axes = ordered(entry.signal, columns)
    if axes is None:
        columns = tuple(mapping.joint(one) for one in columns)
    else:
        columns, values = tuple(columns[i] for i in axes), [values[i] for i in axes]
    return Reading(entry.signal, entry.unit, columns, entry.convert(np.array(values, dtype=np.float64)).tolist())


def _columns(entry: Entry, message: Any, names: tuple[str, ...] | None, count: int) -> tuple[str, ...]:  # noqa: ANN401
    given = names or ()
    if isinstance(entry.joints, str):
        told = leaves(message, entry.joints)
        if told is None:
            raise ReadingError(f"without {entry.joints}")
        given = tuple(str(name) for _, name in told)
    elif entry.joints is not None:
        given = entry.joints
    given = given or tuple(str(i) for i in range(count))
    if len(given) != count:
        raise ReadingError(f"{len(given)} names but {count} values of {entry.fields[0]}")
    return given


def _stamp(mapping: SignalMap, message: Any) -> int | None:  # noqa: ANN401
    if mapping.time is None or mapping.time.field is None:
        return stamp_of(message)
    return stamp_at(message, mapping.time.field, mapping.time.unit)

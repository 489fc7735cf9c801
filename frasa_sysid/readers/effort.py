"""Effort: its unit has to be declared. In a JointState it is a current, a load or a torque, as the driver likes."""

from collections.abc import Sequence
from dataclasses import replace

from frasa_sysid.errors import LogError
from frasa_sysid.readers.units import UNITS
from frasa_sysid.recording import Recording

EFFORT_UNITS = ("N m", "mN m", "A", "mA", "raw", "none")
UNDECLARED = (
    "effort in {count} recordings: nobody declared its unit, so it is kept as [raw] and never taken for torque; "
    "'frasa-sysid import --effort-unit' declares N m, mN m, A, mA, raw or none"
)
INSTEAD = {"N m": "torque", "A": "current"}


def is_effort(name: str) -> bool:
    """Whether a signal is an effort, of any topic, measured or commanded."""
    return name.split("@")[0] in ("effort", "goal_effort")


def undeclared(recordings: Sequence[Recording]) -> int:
    """How many recordings hold an effort in no unit."""
    return sum(any(is_effort(one.name) and one.unit == "raw" for one in each.signals.values()) for each in recordings)


def declare_effort(recording: Recording, unit: str) -> Recording:
    """The recording with its effort as `torque` [N m] or `current` [A], as it is for `raw`, or without it for `none`.

    Args:
        recording: any.
        unit: one of `EFFORT_UNITS`.

    Raises:
        LogError: the log has such a signal already, or nothing else than an effort.
    """
    signals = {}
    for name, signal in recording.signals.items():
        if not is_effort(name) or signal.unit != "raw" or unit == "raw":
            signals[name] = signal
        elif unit != "none":
            si, factor = UNITS[unit]
            named = name.replace("effort", INSTEAD[si], 1)
            if named in recording.signals:
                raise LogError(
                    f"{recording.name}: its effort would be '{named}', which the log has already; drop it: none"
                )
            signals[named] = replace(signal, name=named, unit=si, y=signal.y * factor)
    if not signals:
        raise LogError(f"{recording.name} holds an effort and nothing else")
    return replace(recording, signals=signals)

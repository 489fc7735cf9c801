"""Facts of the rig from the command line: they fill what logs leave open, and contradict nothing that logs say."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from frasa_sysid.calibration import say
from frasa_sysid.commands.import_facts import NUMBERS
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.recording import Recording
from frasa_sysid.supply import AGREES, supply_of

OF_ANY = ("firmware_gain", "supply_voltage")  # facts of a robot too
_LOAD = ("mass", "length", "arm_mass")  # an inertia with a gravity torque stands in their place
_SAME = 1e-6  # relative; a log may hold a number as text


def with_facts(recordings: Sequence[Recording], given: Mapping[str, float]) -> list[Recording]:
    """The recordings, with facts where they say none themselves.

    Args:
        recordings: of all logs of a command.
        given: value by name of `NUMBERS`, as on the command line.

    Raises:
        UsageError: a fact that all recordings say themselves, and some differently.
    """
    for name, value in given.items():
        _check(recordings, name, value)
    return [_filled(one, given) for one in recordings]


def _filled(recording: Recording, given: Mapping[str, float]) -> Recording:
    missing: dict[str, Any] = {name: value for name, value in given.items() if getattr(recording.rig, name) is None}
    return replace(recording, rig=replace(recording.rig, **missing)) if missing else recording


def _check(recordings: Sequence[Recording], name: str, value: float) -> None:
    """Refuse a fact that changes nothing and is contradicted; tell of one that some recordings contradict."""
    told = [one for one in recordings if _told(one, name)]
    against = [one for one in told if not _agrees(one, name, value)]
    if not against:
        return
    option, counts = f"--{name.replace('_', '-')} {value:g}", _what_counts(against, name)
    who = _runs(len(against), len(recordings))
    if len(told) == len(recordings):
        raise UsageError(
            f"{option}: {who} {counts}, which counts; leave it out, or import the logs again if they are wrong"
        )
    rest = _runs(len(recordings) - len(told), len(recordings))
    say(f"{option} holds for the {rest} without it; {who} {counts}, which counts there")


def _told(recording: Recording, name: str) -> bool:
    """Whether a recording says a fact itself, or what stands in its place."""
    if getattr(recording.rig, name) is not None or _by_inertia(recording, name):
        return True
    return _measured(recording, name) is not None


def _agrees(recording: Recording, name: str, value: float) -> bool:
    declared = getattr(recording.rig, name)
    if declared is not None:
        return math.isclose(declared, value, rel_tol=_SAME)
    measured = _measured(recording, name)
    return measured is not None and abs(value - measured) < AGREES * measured


def _measured(recording: Recording, name: str) -> float | None:
    """The supply that a log measures and does not declare [V]."""
    if name != "supply_voltage" or name not in recording.signals:
        return None
    try:
        return supply_of(recording)
    except LogError:  # a reading that no servo runs on; whoever needs it says so
        return None


def _by_inertia(recording: Recording, name: str) -> bool:
    rig = recording.rig
    return name in _LOAD and rig.inertia is not None and rig.gravity_torque is not None


def _what_counts(against: Sequence[Recording], name: str) -> str:
    """What the recordings say in a fact's place, in words that go on from "36 runs"."""
    verb = "says" if len(against) == 1 else "say"
    word = name.replace("_", " ")
    own = [value for one in against if (value := getattr(one.rig, name)) is not None]
    if own:
        return f"{verb} {'its' if len(against) == 1 else 'their'} own {word}, {_range(own, NUMBERS[name])}"
    measured = [value for one in against if (value := _measured(one, name)) is not None]
    if measured:
        return f"{'measures' if len(against) == 1 else 'measure'} the supply, {_range(measured, NUMBERS[name])}"
    return f"{verb} inertia and gravity torque in its place"


def _range(values: Sequence[float], unit: str) -> str:
    low, high = min(values), max(values)
    unit = "" if unit == "P" else f" {unit}"  # the gain is in the firmware's own unit
    return f"{low:.4g}{unit}" if math.isclose(low, high, rel_tol=1e-4) else f"{low:.4g} to {high:.4g}{unit}"


def _runs(some: int, every: int) -> str:
    word = "run" if every == 1 else "runs"
    return f"{'the' if every == 1 else 'all'} {every} {word}" if some == every else f"{some} of {every} {word}"

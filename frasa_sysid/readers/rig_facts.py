"""Facts of the rig that somebody declares beside a log: the `[rig]` table of a map, options of `import`.

A log that declares a fact itself is believed: what is declared beside it fills gaps, or says the same.
"""

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from frasa_sysid.bench_record import WORDS
from frasa_sysid.errors import InputError, LogError
from frasa_sysid.readers.faults import unique, voltage_faults
from frasa_sysid.readers.signal_entry import check_keys, number_of, text_of
from frasa_sysid.recording import Recording, RigFacts

KEYS = tuple(one.name for one in fields(RigFacts))
ENDING = ".toml"  # of a servo's table


def rig_of(where: str, table: Any) -> dict[str, Any]:  # noqa: ANN401 - whatever TOML holds
    """The facts of a map's `[rig]` table, by name.

    Raises:
        InputError: a key that is no fact, or a value that no rig can have.
    """
    where = f"{where}: [rig]"
    if not isinstance(table, dict):
        raise InputError(f"{where}: expected a table with lines such as mass = 1.2")
    check_keys(where, table, KEYS)
    facts: dict[str, Any] = {
        key: text_of(where, table, key) if key in WORDS else number_of(where, table, key) for key in table
    }
    if "servo" in facts:
        facts["servo"] = facts["servo"].lower()
        if facts["servo"].endswith(ENDING):
            raise InputError(f"{where}: servo = '{table['servo']}', expected its name; a table is for --servo of 'fit'")
    try:
        RigFacts(**facts)
    except LogError as error:
        raise InputError(f"{where}: {error}") from error
    return facts


def with_facts(
    recording: Recording, options: Mapping[str, Any], table: Mapping[str, Any], table_name: str
) -> Recording:
    """The recording with facts that it does not state itself.

    Args:
        recording: as it was read.
        options: facts of the command line, by name; they go before those of the table.
        table: facts of a map.
        table_name: of the map, for messages.

    Raises:
        LogError: the log states a fact, and another value is declared.
    """
    given = {**table, **options}
    for name, value in given.items():
        stated = getattr(recording.rig, name)
        if _open(name, stated) or _same(stated, value):
            continue
        by = f"--{name.replace('_', '-')}" if name in options else f"{name} in [rig] of {table_name}"
        raise LogError(
            f"{recording.name}: the log declares {name} = {stated}, {by} says {value}: leave that out if the log is "
            "right, else correct it where the log was made"
        )
    changed = {name: value for name, value in given.items() if _open(name, getattr(recording.rig, name))}
    if not changed:
        return recording
    rig = replace(recording.rig, **changed)
    found = voltage_faults(recording.signals, rig) if "supply_voltage" in changed else []
    return replace(recording, rig=rig, faults=unique([*recording.faults, *found]))


def _open(name: str, stated: object) -> bool:
    """Whether the log leaves a fact open; to be driven by goals is what it is taken for where nobody says."""
    return stated is None or (name, stated) == ("control", "position")


def _same(stated: object, value: object) -> bool:
    if isinstance(stated, float | int) and isinstance(value, float | int):
        return math.isclose(stated, value, rel_tol=1e-9)
    return stated == value

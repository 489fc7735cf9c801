"""The `frasa.bench` metadata record: the facts of one run inside an MCAP file, as text fields.

One record a run. The reader and the writer share this file, so that what one writes
the other understands. A record made by hand needs no more than the facts it knows;
with a time window it speaks for that window, without one for the whole file.
"""

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from frasa_sysid.errors import LogError
from frasa_sysid.recording import Fault, Recording, RigFacts

NAME = "frasa.bench"
VERSION = "1"
WORDS = ("servo", "control", "trajectory", "base")


@dataclass(frozen=True)
class BenchRecord:
    """One run's facts.

    Attributes:
        run: label of the run within its file.
        window: first and last time of the run [ns]; None for the whole file. Time zero is the first.
        rig: facts of the rig.
        origin: real or simulated.
        truth: parameters of a simulated run.
        extra: what has no field of its own.
        units: unit by signal, for messages that cannot say.
        faults: what was found and handled before the file was written.
    """

    run: str
    window: tuple[int, int] | None
    rig: RigFacts
    origin: Literal["real", "simulated"]
    truth: Mapping[str, float]
    extra: Mapping[str, Any]
    units: Mapping[str, str]
    faults: tuple[Fault, ...]


def to_fields(run: str, window: tuple[int, int], recording: Recording) -> dict[str, str]:
    """The text fields of a run's record, with a checksum over them (MCAP has none for metadata)."""
    rig = {f.name: getattr(recording.rig, f.name) for f in fields(RigFacts)}
    result = {"version": VERSION, "run": run, "start_ns": str(window[0]), "end_ns": str(window[1])}
    # The text of a float is the shortest that reads back as the same number.
    # A bench has no base: records of benches stay the bytes that they were before robots had one.
    result |= {name: _to_text(value) for name, value in rig.items() if (name, value) != ("base", None)}
    result |= {
        "origin": recording.origin,
        "truth": _to_json(dict(recording.truth)),
        "extra": _to_json(dict(recording.extra)),
        "note": str(recording.extra.get("note", "")),
        "units": _to_json({name: signal.unit for name, signal in recording.signals.items()}),
        "faults": _to_json([[fault.code, fault.count, fault.message] for fault in recording.faults]),
    }
    return result | {"check": _check(result)}


def from_fields(source: str, text: Mapping[str, str]) -> BenchRecord:
    """The facts of a run from its record's text fields.

    Raises:
        LogError: the checksum does not match, or a field cannot be understood.
    """
    run = text.get("run", "0")
    where = f"{source}: {NAME} record of run '{run}'"
    # A record that frasa wrote has a version and a checksum; one made by hand has neither.
    written = "version" in text or "check" in text
    if written and text.get("check") != _check({key: one for key, one in text.items() if key != "check"}):
        raise LogError(f"{where}: its fields do not match their checksum; the file is damaged or was edited by hand")
    origin = text.get("origin") or "real"
    if origin not in ("real", "simulated"):
        raise LogError(f"{where}: origin = '{origin}', expected 'real' or 'simulated'")
    try:
        return BenchRecord(
            run=run,
            window=_window(text),
            rig=_rig(text),
            origin=origin,  # type: ignore[arg-type]
            truth={str(key): float(value) for key, value in _json(text, "truth", "{}").items()},
            extra=_extra(_json(text, "extra", "{}")),
            units={str(key): str(value) for key, value in _json(text, "units", "{}").items()},
            faults=tuple(Fault(str(c), int(n), str(m)) for c, n, m in _json(text, "faults", "[]")),
        )
    except LogError as error:
        raise LogError(f"{where}: {error}") from error
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise LogError(f"{where} cannot be understood: {error}") from error


def _json(text: Mapping[str, str], name: str, default: str) -> Any:  # noqa: ANN401 - whatever JSON holds
    # A whole number that no float is like would raise far from here.
    return json.loads(text.get(name) or default, parse_int=lambda one: int(one) if len(one) < 19 else float(one))


def _extra(value: Any) -> dict[str, Any]:  # noqa: ANN401
    """What has no field of its own; comparisons of clocks, which are added to, must be such."""
    extra = dict(value)
    clocks = extra.get("clocks", [])
    if not isinstance(clocks, list) or not all(isinstance(one, dict) for one in clocks):
        raise ValueError("'clocks' of extra is no list of objects")
    return extra


def _rig(text: Mapping[str, str]) -> RigFacts:
    facts: dict[str, Any] = {}
    for one in fields(RigFacts):
        value = text.get(one.name, "")
        if value != "":
            facts[one.name] = value if one.name in WORDS else _number(one.name, value)
    return RigFacts(**facts)


def _number(name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise LogError(f"{name} = '{value}' is not a number") from None


def _window(text: Mapping[str, str]) -> tuple[int, int] | None:
    if not (text.get("start_ns") and text.get("end_ns")):
        return None
    start, end = int(text["start_ns"]), int(text["end_ns"])
    if not 0 <= start <= end < 2**63:
        raise LogError(f"start_ns = {start}, end_ns = {end}: expected 0 <= start <= end")
    return start, end


def _to_text(value: Any) -> str:  # noqa: ANN401 - a fact of the rig
    if value is None:
        return ""
    return value if isinstance(value, str) else str(float(value))


def _to_json(value: Any) -> str:  # noqa: ANN401 - plain JSON values
    return json.dumps(value, sort_keys=True, ensure_ascii=False)


def _check(text: Mapping[str, str]) -> str:
    return f"{zlib.crc32(json.dumps(dict(text), sort_keys=True).encode()):08x}"

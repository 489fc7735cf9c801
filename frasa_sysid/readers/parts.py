"""Plain parts of readers: arrays -> checked signals -> one recording, with the faults found on the way."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.sampling import BoolArray, make_signal
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts, Signal

LONGEST = 1e7  # [s]; 115 days: what lasts longer has a broken stamp


class Part(NamedTuple):
    """One signal as a file gives it: times [s] (T,) in any order, values (T,) or (T, k) with NaN where empty.

    `blank`, shape (T,), tells samples that a table leaves empty from those that were read and are no numbers.
    """

    name: str
    unit: str
    t: FloatArray
    y: FloatArray
    columns: tuple[str, ...] = ()
    blank: BoolArray | None = None


def assemble(
    path: Path,
    parts: Iterable[Part],
    rig: RigFacts,
    found: Iterable[Fault] = (),
    extra: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Recording:
    """The recording of a file; time zero is its first sample.

    Args:
        path: the file.
        parts: its signals on one time line; those without a finite number are left out and reported.
        rig: facts that the file states.
        found: faults known so far.
        extra: what has no field of its own, as plain JSON values.
        name: of the recording; the file's name by default.

    Raises:
        LogError: no sample is left, or stamps lie months apart.
    """
    parts = list(parts)
    faults = list(found)
    starts = [float(np.nanmin(part.t)) for part in parts if np.isfinite(part.t).any()]
    if not starts:
        raise LogError(f"{path} holds no sample with a time")
    zero = min(starts)
    if max(float(np.nanmax(part.t)) for part in parts if np.isfinite(part.t).any()) - zero > LONGEST:
        raise LogError(f"{path}: its times are months apart, expected those of one run")
    signals: dict[str, Signal] = {}
    for part in parts:
        signal, more = make_signal(part.name, part.unit, part.t - zero, part.y, part.columns, part.blank)
        faults += more
        if signal is not None:
            signals[part.name] = signal
    if not signals:
        raise LogError(f"{path} holds no finite number")
    cleaned, handled = known_faults.clean(signals, rig)
    return Recording(
        name=name or path.name,
        signals=cleaned,
        rig=rig,
        origin="real",
        source=str(path),
        sha256=sha256_of_file(path),
        clock="file",
        faults=known_faults.unique([*_merged(faults), *handled]),
        extra=dict(extra or {}),
    )


def _merged(faults: Iterable[Fault]) -> list[Fault]:
    """Faults of time that signals read together share, said once."""
    first: dict[tuple[str, str], Fault] = {}
    for fault in faults:
        text = fault.message.split(": ", 1)[-1] if fault.code in ("time_order", "repeated_time") else fault.message
        first.setdefault((fault.code, text), fault)
    return list(first.values())


def read_json(path: Path) -> Any:  # noqa: ANN401 - whatever JSON holds
    """The content of a JSON file, which may be gzipped.

    Raises:
        LogError: not such a file.
    """
    try:
        return json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path} is not JSON: {error}") from error


def number(value: Any) -> float | None:  # noqa: ANN401 - whatever JSON holds
    """A finite number, or None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def column(records: Iterable[Mapping[str, Any]], key: str) -> FloatArray:
    """One entry of all records as numbers, shape (T,); NaN where there is none."""
    values = [number(record.get(key)) for record in records]
    return np.array([np.nan if value is None else value for value in values])

"""The EMPS benchmark (a prismatic drive under closed-loop control, 1 kHz), MATLAB file -> recording.

A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS", Nonlinear System
Identification Benchmarks (2019). Read as copied to forgi86/sysid-neural-continuous, commit
956aa7e, `examples/EMPS/data/DATA_EMPS.mat` (that repository: Apache-2.0).

`qm` and `qg` are the carriage's position and its reference [m], `vir` the voltage that
the controller sent [V], `gtau` the drive's gain [N/V]: the force is gtau * vir, held from its
sample to the next. `kp` and `kv` are gains of the controller.
"""

from pathlib import Path

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers.matlab import read_matlab
from frasa_sysid.readers.sampling import make_signal, timing_faults
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts, Signal

COLUMNS = ("t", "qm", "qg", "vir")
GAINS = ("gtau", "kp", "kv")
FARTHEST = 100.0  # m; no benchtop axis is longer


def read_emps(path: Path) -> list[Recording]:
    """The one recording of the data set.

    Raises:
        LogError: not such a file, or numbers in it that no such axis gives.
    """
    arrays = read_matlab(path, (*COLUMNS, *GAINS))
    gains = {name: _number(path, name, arrays[name]) for name in GAINS}
    t = _column(path, "t", arrays["t"])
    columns = {name: _column(path, name, arrays[name]) for name in COLUMNS}
    for name, values in columns.items():
        if values.size != t.size:
            raise LogError(f"{path}: {values.size} values of '{name}' but {t.size} times")
    for name in ("qm", "qg"):
        largest = float(np.nanmax(np.abs(columns[name]), initial=0.0))
        if largest > FARTHEST:
            raise LogError(f"{path}: '{name}' reaches {largest:.4g}, expected metres")
    finite = t[np.isfinite(t)]
    with np.errstate(over="ignore"):  # what is beyond all numbers is left out below, and said
        t = t - (finite.min() if finite.size else 0.0)
        force = gains["gtau"] * columns["vir"]
    signals: dict[str, Signal] = {}
    found: list[Fault] = []
    for name, unit, values in (
        ("position", "m", columns["qm"]),
        ("goal", "m", columns["qg"]),
        ("voltage_command", "V", columns["vir"]),
        ("force", "N", force),
    ):
        signal, faults = make_signal(name, unit, t, values)
        found += faults
        if signal is None:
            raise LogError(f"{path}: no finite '{name}' is left")
        signals[name] = signal
    return [
        Recording(
            name=path.name,
            signals=signals,
            rig=RigFacts(servo="emps", control="force"),
            origin="real",
            source=str(path),
            sha256=sha256_of_file(path),
            clock="file",
            faults=(*found, *timing_faults(signals)),
            extra={
                "axis": "linear",
                "closed_loop": True,
                "force_per_volt": gains["gtau"],
                "controller": {"kp": gains["kp"], "kv": gains["kv"]},
            },
        )
    ]


def _column(path: Path, name: str, values: FloatArray) -> FloatArray:
    if values.size < 2 or max(values.shape) != values.size:
        raise LogError(f"{path}: '{name}' has shape {values.shape}, expected one column of samples")
    return values.reshape(-1)


def _number(path: Path, name: str, values: FloatArray) -> float:
    value = float(values.reshape(-1)[0]) if values.size == 1 else np.nan
    if not (np.isfinite(value) and value > 0):
        raise LogError(f"{path}: '{name}' is not one positive number")
    return value

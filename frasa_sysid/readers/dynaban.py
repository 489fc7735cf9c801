"""Dynaban's text logs (open-loop voltage tests of a Dynamixel at 1 kHz) -> recordings.

Every test begins with the line `Time Command Position Speed`; a line
`StartOfNewTest <type>` stands only where a new type of test begins. Time is in 1e-4 s,
the command in 1/3000 of 12 V, the position in 1/4096 of a turn, the speed in those a
second. The first speed of a test is its command, not a speed. The motor shaft is bare.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.sampling import make_signal, plural
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts, Signal

TICK = 1e-4  # s
SUPPLY = 12.0  # V
FULL_COMMAND = 3000
STEPS_PER_TURN = 4096
STEP = 2 * np.pi / STEPS_PER_TURN  # rad
HEADER = ["Time", "Command", "Position", "Speed"]
TYPES = {"0": "staircase", "1": "sawtooth", "2": "steps"}
# No pendulum hangs on the axis: gravity is known to be absent.
RIG = {"servo": "mx64", "gravity_torque": 0.0, "supply_voltage": SUPPLY, "control": "voltage"}


class Test(NamedTuple):
    """One test: its type, and rows of time, command, position and speed as they stand in the file."""

    kind: str
    rows: list[list[float]]


def read_dynaban(path: Path) -> list[Recording]:
    """The recordings of a Dynaban log, one a test, named `<file>#000` and on.

    Raises:
        LogError: not such a file, or a line in it that cannot be understood.
    """
    tests = _parse(path)
    sha256 = sha256_of_file(path)
    return [_recording(path, i, test, sha256) for i, test in enumerate(tests)]


def _parse(path: Path) -> list[Test]:
    try:
        lines = read_bytes(path).decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not a Dynaban log: {error}") from error
    tests: list[Test] = []
    kind = ""
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        if words[0] == "StartOfNewTest":
            kind = words[1] if len(words) > 1 else ""
        elif words == HEADER:
            tests.append(Test(kind, []))
        elif not tests:
            raise LogError(f"{path} is not a Dynaban log: line {number} stands before any '{' '.join(HEADER)}'")
        else:
            tests[-1].rows.append(_numbers(path, number, words))
    tests = [test for test in tests if test.rows]
    if not tests:
        raise LogError(f"{path} is not a Dynaban log: it holds no test")
    return tests


def _numbers(path: Path, number: int, words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != len(HEADER):
        raise LogError(f"{path}: line {number} is not four numbers: {' '.join(words)[:60]!r}")
    return values


def _recording(path: Path, index: int, test: Test, sha256: str) -> Recording:
    ticks, command, steps, speed = np.array(test.rows).T
    found: list[Fault] = []
    signals: dict[str, Signal] = {}
    t = (ticks - ticks[0]) * TICK
    name = f"{path.name}#{index:03d}"
    position, wraps = known_faults.unwrap(steps, STEPS_PER_TURN)
    if wraps:
        text = f"position: {plural(wraps, 'wrap')} of the encoder; unwrapped"
        found.append(Fault("encoder_wrap", wraps, text))
    found.append(Fault("first_sample", 1, "velocity: the first sample of a test is its command; dropped"))
    columns: list[tuple[str, str, FloatArray, FloatArray]] = [
        ("voltage_command", "V", t, command / FULL_COMMAND * SUPPLY),
        ("position", "rad", t, position * STEP),
        ("velocity", "rad/s", t[1:], speed[1:] * STEP),
    ]
    for signal_name, unit, times, values in columns:
        signal, faults = make_signal(signal_name, unit, times, values)
        found += faults
        if signal is not None:
            signals[signal_name] = signal
    if "position" not in signals:
        raise LogError(f"{name} has no usable position")
    rig = RigFacts(**RIG, trajectory=TYPES.get(test.kind, test.kind) or None)  # type: ignore[arg-type]
    signals, handled = known_faults.clean(signals, rig)
    return Recording(
        name=name,
        signals=signals,
        rig=rig,
        origin="real",
        source=str(path),
        sha256=sha256,
        clock="file",
        faults=(*found, *handled),
        extra={"test": index},
    )

"""An IMU bolted to a motor shaft that turns to and fro at one frequency, text columns -> recording.

dongdaming1966/mcar_simulate, commit c0ab509, `data/10_18_*.dat`; no licence is stated. Seven columns without a
header: time [s], gyro rate [rad/s], angle by the IMU's complementary filter [rad], speed and angle of the motor
[rad/s, rad], angle and rate by a Kalman filter. The motor's columns are the command and its integral, not a
measurement, so they are `goal_velocity` and `goal` here.
"""

from pathlib import Path

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import FloatArray, Recording, RigFacts

SIGNALS = (
    ("gyro", "rad/s"),
    ("imu_angle", "rad"),
    ("goal_velocity", "rad/s"),
    ("goal", "rad"),
    ("kalman_angle", "rad"),
    ("kalman_rate", "rad/s"),
)
FASTEST = 1e3  # rad/s; no gyro on a robot measures more


def read_imu_on_axis(path: Path) -> list[Recording]:
    """The one recording of such a file.

    Raises:
        LogError: not such a file.
    """
    rows = _rows(path)
    largest = float(np.nanmax(np.abs(rows[:, 1]), initial=0.0))
    if largest > FASTEST:
        raise LogError(f"{path}: the gyro reaches {largest:.4g}, expected rad/s")
    parts = [Part(name, unit, rows[:, 0], rows[:, i + 1]) for i, (name, unit) in enumerate(SIGNALS)]
    extra = {"note": "goal_velocity and goal are what the motor was told, not measured"}
    return [assemble(path, parts, RigFacts(trajectory="sine"), extra=extra)]


def _rows(path: Path) -> FloatArray:
    try:
        lines = read_bytes(path).decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not a text log: {error}") from error
    rows = []
    for i, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise LogError(f"{path}: line {i} is not numbers: {line[:60]!r}") from None
        if len(words) != len(SIGNALS) + 1:
            raise LogError(f"{path}: line {i} has {len(words)} numbers, expected {len(SIGNALS) + 1}; was it cut off?")
    if not rows:
        raise LogError(f"{path} holds no line")
    return np.array(rows)

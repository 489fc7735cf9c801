"""Rollouts of a hobby servo with an arm (Miuzei 25 kg, AS5600 encoder), JSON -> recordings.

mauicv/servo-sysid, commit e4a4840, `src/sysid/dataset/response.json`; no licence is
stated. One object: `config` with the rate, `data` with the rollouts, each with goals
(`actions`) and readings (`sensor_data`) as shares of half a turn: 1 is pi. The readings
begin at zero, where the servo was centred.

Nothing was stamped. The loop sent a goal, read the encoder and slept until the next
period, so goal and reading share a time here, and the period is the nominal one.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration.files import sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.readers import faults as known_faults
from frasa_sysid.readers.sampling import make_signal, plural
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts, Signal

LARGEST = 2.0  # share of half a turn: one turn, more than such a servo can make
FASTEST = 10_000.0  # Hz
SIGNALS = {"actions": "goal", "sensor_data": "position"}
# A servo without a register for its gain has the one it has: 1 in its own unit.
GAIN = 1.0


def read_miuzei(path: Path) -> list[Recording]:
    """The recordings of such a file, one a rollout, named `<file>#00` and on.

    Raises:
        LogError: not such a file, or a rollout in it that cannot be used.
    """
    log = _parse(path)
    rate = _rate(path, log)
    sha256 = sha256_of_file(path)
    width = max(2, len(str(len(log["data"]) - 1)))
    return [
        _recording(path, f"{path.name}#{i:0{width}d}", rollout, rate, sha256) for i, rollout in enumerate(log["data"])
    ]


def _parse(path: Path) -> Mapping[str, Any]:
    try:
        log = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path} is not JSON: {error}") from error
    rollouts = log.get("data") if isinstance(log, dict) else None
    if not isinstance(rollouts, list) or not all(
        isinstance(one, dict) and SIGNALS.keys() <= one.keys() for one in rollouts
    ):
        raise LogError(
            f"{path} is not a Miuzei log: expected a list 'data' of rollouts with 'actions' and 'sensor_data'"
        )
    if not rollouts:
        raise LogError(f"{path}: 'data' is empty")
    result: Mapping[str, Any] = log
    return result


def _rate(path: Path, log: Mapping[str, Any]) -> float:
    config = log.get("config")
    rate = config.get("action_hz") if isinstance(config, dict) else None
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate <= FASTEST:
        raise LogError(f"{path}: config.action_hz = {str(rate)[:40]!r}, expected the rate in Hz")
    return float(rate)


def _recording(path: Path, name: str, rollout: Mapping[str, Any], rate: float, sha256: str) -> Recording:
    columns = {key: _angles(name, key, rollout[key]) for key in SIGNALS}
    sizes = {key: angles.size for key, angles in columns.items()}
    if len(set(sizes.values())) != 1:
        raise LogError(f"{name}: {sizes['actions']} actions but {sizes['sensor_data']} readings")
    times = np.arange(sizes["actions"]) / rate
    signals: dict[str, Signal] = {}
    found = _notices(times.size, rate)
    for key, angles in columns.items():
        signal, faults = make_signal(SIGNALS[key], "rad", times, angles)
        found += faults
        if signal is None:
            raise LogError(f"{name}: '{key}' holds no number")
        signals[SIGNALS[key]] = signal
    kind, targets = rollout.get("type"), rollout.get("targets")
    rig = RigFacts(servo="miuzei", firmware_gain=GAIN, trajectory=kind if isinstance(kind, str) and kind else None)
    signals, handled = known_faults.clean(signals, rig)
    return Recording(
        name=name,
        signals=signals,
        rig=rig,
        origin="real",
        source=str(path),
        sha256=sha256,
        clock="file",
        faults=known_faults.unique([*found, *handled]),
        extra={"meant_to_excite": targets} if isinstance(targets, list) else {},
    )


def _angles(name: str, key: str, values: Any) -> FloatArray:  # noqa: ANN401 - whatever JSON holds
    """Shares of half a turn -> rad."""
    if not isinstance(values, list) or not values:
        raise LogError(f"{name}: '{key}' is not a list with numbers in it")
    odd = next((one for one in values if isinstance(one, bool) or not isinstance(one, int | float | None)), None)
    if odd is not None:
        raise LogError(f"{name}: '{key}' holds {str(odd)[:40]!r}, expected numbers")
    try:
        shares = np.array([np.nan if one is None else float(one) for one in values])
    except OverflowError as error:
        raise LogError(f"{name}: '{key}' holds a number too large for an angle") from error
    finite = shares[np.isfinite(shares)]
    if finite.size and np.abs(finite).max() > LARGEST:
        raise LogError(
            f"{name}: '{key}' reaches {np.abs(finite).max():.4g}, expected shares of half a turn (1 = pi rad); "
            "is it in degrees or radians?"
        )
    return shares * np.pi


def _notices(samples: int, rate: float) -> list[Fault]:
    clock = (
        f"{plural(samples, 'sample')} without a time; set {1e3 / rate:g} ms apart as the loop meant to, "
        "so delay and speeds are as good as that"
    )
    rig = "no load, supply voltage or gain is stated: the gain is 1, a fit needs --mass --length --supply-voltage"
    return [Fault("nominal_clock", samples, clock), Fault("rig_not_stated", 1, rig)]

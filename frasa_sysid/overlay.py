"""Simulated traces beside the measured ones, for the writer to put into one MCAP that viewers open.

What a model or fit would have done stands on topics of its own: the last one compared on `/sim/joint_states` (and
`/sim/imu/data`), any other on `/sim/NAME/joint_states`. The layout for Foxglove in `layouts` plots these.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from frasa_sysid.message_definitions import SIMULATED
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.robot_errors import Compared, series
from frasa_sysid.robot_residuals import DIVERGED

LAYOUT = Path(__file__).parent / "layouts" / "foxglove.json"
TOPICS = {"position": "joint_states", "velocity": "joint_states", "gyro": "imu/data"}


def prefixes(names: Sequence[str]) -> dict[str, str]:
    """Where the topics of each model or fit begin, by name; the last one has the shortest."""
    found: dict[str, str] = {}
    for name in names[:-1]:
        # A topic's name holds letters, digits and _; two files may then be called alike.
        safe = re.sub(r"[^A-Za-z0-9_]+", "_", name.removesuffix(".json").removesuffix(".xml")).strip("_") or "model"
        prefix = f"{SIMULATED}{safe}/"
        found[name] = prefix if prefix not in found.values() else f"{SIMULATED}{safe}_{len(found)}/"
    return {**found, names[-1]: SIMULATED}


def bench_overlay(recordings: Sequence[Recording], readings: Mapping[str, Mapping[str, FloatArray]]) -> list[Recording]:
    """Recordings of a bench with simulated positions.

    Args:
        recordings: measured, each with a position.
        readings: by model or fit, by recording: simulated position [rad] at the measured times, shape (T,).
    """
    where = prefixes(list(readings))
    result = []
    for one in recordings:
        position = one.signal("position")
        traces = {
            name: replace(
                position,
                name=f"position@{where[name]}{TOPICS['position']}",
                y=by_run[one.name].reshape(position.y.shape),
            )
            for name, by_run in readings.items()
            if one.name in by_run
        }
        result.append(_with(one, where, traces.values()))
    return result


def robot_overlay(recordings: Sequence[Recording], found: Mapping[str, Sequence[Compared]]) -> list[Recording]:
    """Recordings of a robot with simulated positions, velocities and rates, where they were compared.

    Args:
        recordings: measured.
        found: what was simulated, by model or fit.
    """
    where = prefixes(list(found))
    result = []
    for one in recordings:
        ordered = _in_one_order(one)
        traces = [
            signal
            for name, compared in found.items()
            for channel, topic in TOPICS.items()
            if channel in one.signals
            and (signal := _robot_signal(ordered, channel, f"{channel}@{where[name]}{topic}", compared)) is not None
        ]
        result.append(_with(ordered, where, traces))
    return result


def _robot_signal(recording: Recording, channel: str, name: str, compared: Sequence[Compared]) -> Signal | None:
    """One channel as it was simulated: the joints or axes that were compared, in the order of the measured signal."""
    measured = recording.signal(channel)
    parts = {
        joint: one
        for joint in measured.columns
        if (one := series(compared, recording.name, channel, joint)) is not None
    }
    if not parts:
        return None
    t = next(iter(parts.values())).t
    y = np.stack([one.y + one.residuals for one in parts.values()], axis=1)
    diverged = np.any([one.residuals == DIVERGED for one in parts.values()], axis=0)
    t, kept = np.unique(t[~diverged] + recording.signal("position").t[0], return_index=True)
    return Signal(name, measured.unit, t, y[~diverged][kept], tuple(parts)) if t.size else None


def _in_one_order(recording: Recording) -> Recording:
    """The recording with the joints of all its signals in the order of its positions: viewers plot them by number."""
    joints = recording.signal("position").columns
    signals = {}
    for name, one in recording.signals.items():
        if sorted(one.columns) == sorted(joints) and one.columns != joints:
            one = replace(one, y=one.y[:, [one.columns.index(joint) for joint in joints]], columns=joints)
        signals[name] = one
    return replace(recording, signals=signals)


def _with(recording: Recording, where: Mapping[str, str], traces: Iterable[Signal]) -> Recording:
    signals = {**recording.signals, **{one.name: one for one in traces}}
    return replace(recording, signals=signals, extra={**recording.extra, "simulated": dict(where)})

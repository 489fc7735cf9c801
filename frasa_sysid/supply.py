"""The supply of a bench run: its level, its level without load, and its course."""

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray, Recording, Signal

_SUPPLY_SMOOTHING = 0.1  # [s] readings of a sagging supply alias with the PWM; their mean does not
_REST = 0.2  # share of a run, that of the smallest errors, in which the supply counts as unloaded
AGREES = 0.02  # relative difference within which a declared supply is believed
_SUPPLY_RATE = 5.0  # [Hz] below it a measured supply says nothing about sag within a run


def supply_of(recording: Recording) -> float:
    """Supply while powered [V]: the median of what was measured, else what was declared."""
    measured = recording.signals.get("supply_voltage")
    if measured is None:
        return _declared_supply(recording)
    values = measured.y
    enable = recording.signals.get("torque_enable")
    if enable is not None:
        powered = enable.y[np.maximum(np.searchsorted(enable.t, measured.t, side="right") - 1, 0)] > 0.5
        values = values[powered] if powered.any() else values
    supply = float(np.median(values))
    if supply <= 0.0:
        raise LogError(f"{recording.name}: 'supply_voltage' measures {supply:g} V while powered; no servo runs on that")
    return supply


def _declared_supply(recording: Recording) -> float:
    if not recording.rig.supply_voltage:
        raise LogError(f"{recording.name}: no supply voltage, measured or declared; give --supply-voltage V")
    return recording.rig.supply_voltage


def rest_of(recording: Recording, drive: Signal, position: Signal) -> float:
    """Supply [V] while the servo pulls least: mean of what was measured at the smallest errors."""
    measured = recording.signals.get("supply_voltage")
    declared = recording.rig.supply_voltage
    if measured is None:
        return _declared_supply(recording)
    goal = drive.y[np.maximum(np.searchsorted(drive.t, measured.t, side="right") - 1, 0)]
    error = np.abs(goal - np.interp(measured.t, position.t, position.y))
    rest = float(np.mean(measured.y[error <= np.quantile(error, _REST)]))
    # A declared supply that agrees is the better number: a servo measures in steps of 0.1 V.
    return declared if declared and abs(declared - rest) < AGREES * rest else rest


def supply_course(recording: Recording, start: float, steps: int, timestep: float) -> FloatArray:
    """Supply in each step over its median while powered, shape (steps,)."""
    measured = recording.signals.get("supply_voltage")
    flat = np.ones(steps)
    if measured is None or recording.rig.control != "position":
        return flat
    changes = int(np.count_nonzero(np.diff(measured.y)))
    if changes < _SUPPLY_RATE * (measured.t[-1] - measured.t[0]):
        return flat
    course = np.interp((np.arange(steps) + 0.5) * timestep, measured.t - start, measured.y)
    half = max(int(_SUPPLY_SMOOTHING / timestep / 2.0), 1)
    total = np.concatenate([[0.0], np.cumsum(course)])
    low, high = np.maximum(np.arange(steps) - half, 0), np.minimum(np.arange(steps) + half + 1, steps)
    return np.asarray((total[high] - total[low]) / (high - low) / supply_of(recording))

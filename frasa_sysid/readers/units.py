"""Units that a map may declare, each with the SI unit it becomes; nothing is ever guessed from a name."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

TURN = 2 * np.pi
TICKS = ("tick", "tick/s")  # of an encoder: how many make a turn has to be said beside them

# unit -> SI unit, factor; a tick is one turn here, divided by the ticks of a turn where it is used
UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "rad": ("rad", 1.0),
        "deg": ("rad", np.pi / 180),
        "turn": ("rad", TURN),
        "tick": ("rad", TURN),
        "m": ("m", 1.0),
        "mm": ("m", 1e-3),
        "rad/s": ("rad/s", 1.0),
        "deg/s": ("rad/s", np.pi / 180),
        "rpm": ("rad/s", TURN / 60),
        "tick/s": ("rad/s", TURN),
        "m/s": ("m/s", 1.0),
        "mm/s": ("m/s", 1e-3),
        "rad/s^2": ("rad/s^2", 1.0),
        "m/s^2": ("m/s^2", 1.0),
        "g": ("m/s^2", 9.80665),
        "V": ("V", 1.0),
        "mV": ("V", 1e-3),
        "A": ("A", 1.0),
        "mA": ("A", 1e-3),
        "N m": ("N m", 1.0),
        "mN m": ("N m", 1e-3),
        "N": ("N", 1.0),
        "degC": ("degC", 1.0),
        "Hz": ("Hz", 1.0),
        "1": ("1", 1.0),
        "%": ("1", 0.01),
        "raw": ("raw", 1.0),
    }
)

# signal -> SI units that it may have; any other name may have any of them
SIGNALS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "position": ("rad", "m"),
        "goal": ("rad", "m"),
        "velocity": ("rad/s", "m/s"),
        "goal_velocity": ("rad/s", "m/s"),
        "gyro": ("rad/s",),
        "acceleration": ("m/s^2",),
        "orientation": ("1",),
        "voltage_command": ("V",),
        "supply_voltage": ("V",),
        "torque_enable": ("1",),
        "duty": ("1",),
        "force": ("N",),
        "temperature": ("degC",),
        "current": ("A",),
        "goal_current": ("A",),
        "torque": ("N m",),
        "goal_torque": ("N m",),
        "effort": ("raw",),
        "goal_effort": ("raw",),
    }
)

# signals whose columns are axes, in the order that they have here
AXES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"gyro": ("x", "y", "z"), "acceleration": ("x", "y", "z"), "orientation": ("w", "x", "y", "z")}
)

TIME_UNITS: Mapping[str, int] = MappingProxyType({"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1})  # [ns]


def units_of(signal: str) -> list[str]:
    """The units that a signal may be declared in."""
    known = SIGNALS.get(signal)
    return [unit for unit, (si, _) in UNITS.items() if known is None or si in known]

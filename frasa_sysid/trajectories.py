"""The excitation trajectories of the pendulum bench, as Rhoban/bam defines them (6 s each).

All runs of a bench are simulated side by side, so everything here is vectorised over time.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from frasa_sysid.recording import FloatArray

DURATION = 6.0  # [s]
DROP_TIME = 2.0  # [s] when lift_and_drop turns the torque off


def _smooth_step(t: FloatArray, start: float, end: float, low: float, high: float) -> FloatArray:
    """Cubic from `low` at `start` to `high` at `end` with zero slope at both."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return low + (high - low) * s * s * (3.0 - 2.0 * s)


def _sin_time_square(t: FloatArray) -> FloatArray:
    return np.sin(t**2)


def _sin_sin(t: FloatArray) -> FloatArray:
    return np.sin(t) * (np.pi / 2) + 0.5 * np.sin(5.0 * t) * np.sin(2.0 * t)


def _up_and_down(t: FloatArray) -> FloatArray:
    top = np.pi / 2
    up = _smooth_step(t, 0.0, 3.0, 0.0, top)
    return np.where(t < 3.0, up, _smooth_step(t, 3.0, 6.0, top, 0.8 * top))


def _lift_and_drop(t: FloatArray) -> FloatArray:
    return _smooth_step(t, 0.0, DROP_TIME, 0.0, -np.pi / 2)


GOALS: Mapping[str, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {
        "lift_and_drop": _lift_and_drop,
        "sin_sin": _sin_sin,
        "sin_time_square": _sin_time_square,
        "up_and_down": _up_and_down,
    }
)


def goal(name: str, t: FloatArray) -> FloatArray:
    """Goal angle [rad] of a trajectory at times t [s], same shape."""
    return GOALS[name](t)


def torque_enabled(name: str, t: FloatArray) -> FloatArray:
    """1 while the trajectory keeps the motor powered, else 0; same shape as t [s]."""
    return np.where((name == "lift_and_drop") & (t >= DROP_TIME), 0.0, 1.0)

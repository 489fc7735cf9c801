"""A signal as one looks at it: on an even grid, as a spectrum, and a bench's motion as torque over speed."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal as filters

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.rig import load_of

_WINDOW = 0.09  # [s] of the cubic that slopes are read from: a count of the encoder must not count as a jerk
_FEWEST = 8  # samples


@dataclass(frozen=True)
class SpeedTorque:
    """What a load asked of its servo, while it moved.

    Attributes:
        t: on an even grid [s], shape (T,).
        speed: of the arm [rad/s], shape (T,).
        torque: at the horn, what carries and accelerates the load [N m], shape (T,). Without power it is the servo's
            friction and rotor alone; under power the motor's torque less these.
        powered: whether the motor was on, and had been all through the window that slopes are read from, shape (T,).
        free: the same of a motor that was off, shape (T,); neither is set near a switch.
    """

    t: FloatArray
    speed: FloatArray
    torque: FloatArray
    powered: npt.NDArray[np.bool_]
    free: npt.NDArray[np.bool_]


def even(one: Signal, column: str = "", period: float | None = None) -> tuple[FloatArray, FloatArray]:
    """A signal's times and values on an even grid, interpolated linearly.

    Args:
        one: with any clock.
        column: which joint or axis, where it has several.
        period: of the grid [s]; by default the median of the signal's own.

    Raises:
        LogError: fewer than 8 samples, or no such column.
    """
    if one.t.size < _FEWEST:
        raise LogError(f"signal '{one.name}' has {one.t.size} samples; expected {_FEWEST} or more")
    if (one.columns or ("",)).count(column) != 1:
        raise LogError(f"signal '{one.name}' has no column '{column}'; it has {', '.join(one.columns) or 'none'}")
    y = one.y[:, one.columns.index(column)] if one.columns else one.y
    step = float(np.median(np.diff(one.t))) if period is None else period
    t = np.arange(one.t[0], one.t[-1] + 1e-9, step)
    return t, np.interp(t, one.t, y)


def spectrum(one: Signal, column: str = "", seconds: float = 3.0) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz] and amplitude density (unit of the signal per root Hz), the mean left out (Welch).

    Args:
        one: with any clock.
        column: which joint or axis, where it has several.
        seconds: of the stretches that are averaged over: 1 / seconds is the finest frequency told apart.

    Raises:
        LogError: as `even`.
    """
    t, y = even(one, column)
    rate = 1.0 / (t[1] - t[0])
    f, power = filters.welch(y, rate, nperseg=min(t.size, round(seconds * rate)), detrend="constant")
    return f[1:], np.sqrt(power[1:])


def speed_torque(recording: Recording) -> SpeedTorque:
    """Torque of the load over the speed of the arm, in one run of a bench.

    Raises:
        LogError: too short, no position, or nobody says what hangs on the arm.
    """
    inertia, gravity = load_of(recording)
    position = recording.signal("position")
    t, q = even(position)
    step = float(t[1] - t[0])
    window = max(2 * round(_WINDOW / step / 2) + 1, 5)
    if t.size < window:
        raise LogError(f"{recording.name}: {t[-1] - t[0]:.2f} s of positions are too few for their slopes")
    angle, speed, acceleration = (
        filters.savgol_filter(q, window, 3, deriv=order, delta=step, mode="interp") for order in (0, 1, 2)
    )
    on = _enabled(recording, t)
    half = window // 2
    stay = np.convolve(np.pad(on.astype(float), half, mode="edge"), np.full(window, 1.0 / window), mode="valid")
    torque = inertia * acceleration + gravity * np.sin(angle)
    return SpeedTorque(t, speed, torque, stay > 1.0 - 0.5 / window, stay < 0.5 / window)


def _enabled(recording: Recording, t: FloatArray) -> npt.NDArray[np.bool_]:
    enable = recording.signals.get("torque_enable")
    if enable is None:
        return np.ones(t.size, dtype=bool)
    return np.asarray(enable.y[np.maximum(np.searchsorted(enable.t, t, side="right") - 1, 0)] > 0.5)

"""What is in a recording, in numbers: rates, quanta, extents. Pure functions, nothing is printed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.motion_detail import Detail, detail_of
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.servo import NOMINAL, Servo

GRAVITY = 9.81  # m/s^2
SMOOTHING = 7  # samples; a position's quantum must not count as motion
MOVING = 0.2  # rad/s
GRID = 1e-9  # closer together two readings are the same


@dataclass(frozen=True)
class SignalSummary:
    """One signal in numbers.

    Attributes:
        name: of the signal.
        unit: of the signal.
        samples: number of samples.
        columns: joints or axes; empty for one.
        period_median: of the sampling [s]; 0 for a single sample, likewise the next two.
        period_p99: 99th percentile [s].
        period_max: longest [s].
        low: smallest value.
        high: largest value.
        quantum: step of the readings, None where they are not on a grid.
    """

    name: str
    unit: str
    samples: int
    columns: tuple[str, ...]
    period_median: float
    period_p99: float
    period_max: float
    low: float
    high: float
    quantum: float | None


def summarise(signal: Signal) -> SignalSummary:
    """A signal in numbers."""
    dt = np.diff(signal.t) if signal.t.size > 1 else np.zeros(1)
    return SignalSummary(
        name=signal.name,
        unit=signal.unit,
        samples=int(signal.t.size),
        columns=signal.columns,
        period_median=float(np.median(dt)),
        period_p99=float(np.percentile(dt, 99)),
        period_max=float(dt.max()),
        low=float(signal.y.min()),
        high=float(signal.y.max()),
        quantum=quantum(signal.y),
    )


def quantum(y: FloatArray) -> float | None:
    """The step of a reading, or None where the values lie on no grid.

    On a grid the distances between neighbouring values are multiples of the smallest,
    but for a few odd samples (drivers that average after a missed read).
    """
    steps = np.diff(np.unique(y))
    steps = steps[steps > GRID]
    if steps.size < 5:
        return None
    small = np.percentile(steps, 5, method="lower")  # one of them, so that some lie near it
    step = float(np.median(steps[(steps > small / 1.5) & (steps < small * 1.5)]))
    multiples = steps / step
    on_grid = np.abs(multiples - np.round(multiples)) < 0.1
    return step if on_grid.mean() > 0.9 else None


@dataclass(frozen=True)
class Motion:
    """What one run of a bench did.

    Attributes:
        control: `position` or `voltage`.
        duration: of the run [s].
        period: median sampling period of the position [s].
        quantum: of the position [rad]; 0 where it has none.
        travel: of the position [rad].
        reversals: changes of direction of a moving arm.
        slow_share: share of the samples at less than a fifth of the top speed, yet moving.
        top_speed: [rad/s].
        top_acceleration: of the smoothed motion [rad/s^2].
        free_travel: with the motor off [rad].
        has_drive: there is a goal, or a voltage command.
        error_p95: of |goal - position| with the motor on [rad].
        saturated: share of the samples that ask for more duty than there is, as recorded or else by nominal
            numbers; None without servo and gain.
        goal_speed: 95th percentile, or what a step makes in one sample [rad/s].
        gravity: torque at the horizontal [N m]; None when not known.
        lift: largest |sin(position)|.
        inertia_known: the load's inertia is known.
        supply: measured supply (low, median, high) [V]; None when not measured.
        clock: whose stamps these are.
        detail: what laws and effects beyond Coulomb-viscous friction show in.
    """

    control: str
    duration: float
    period: float
    quantum: float
    travel: float
    reversals: int
    slow_share: float
    top_speed: float
    top_acceleration: float
    free_travel: float
    has_drive: bool
    error_p95: float
    saturated: float | None
    goal_speed: float
    gravity: float | None
    lift: float
    inertia_known: bool
    supply: tuple[float, float, float] | None
    clock: str
    detail: Detail


def is_bench(recording: Recording) -> bool:
    """Whether a recording is of one joint that turns, and long enough: what the rules of identification are about."""
    position = recording.signals.get("position")
    return position is not None and not position.columns and not recording.linear and position.t.size >= 4 * SMOOTHING


def motion(recording: Recording, servo: Servo | None = None) -> Motion:
    """What a bench run did; see `is_bench`.

    Args:
        recording: of the run.
        servo: its type; by default the one that comes with frasa by the name that the log gives.
    """
    position = recording.signal("position")
    t, q = position.t, position.y
    speed = np.gradient(_smooth(q), t)
    acceleration = np.gradient(_smooth(speed), t)[SMOOTHING:-SMOOTHING]
    speed = speed[SMOOTHING:-SMOOTHING]
    top = float(np.percentile(np.abs(speed), 99.5))
    slow = (np.abs(speed) > MOVING) & (np.abs(speed) < max(top / 5, 2 * MOVING))
    powered = _powered(recording, t)
    every_error, step = _error(recording, t, q), quantum(q) or 0.0
    error = every_error[powered]
    supply = recording.signals.get("supply_voltage")
    return Motion(
        control=recording.rig.control,
        duration=float(t[-1] - t[0]),
        period=float(np.median(np.diff(t))),
        quantum=step,
        travel=float(np.ptp(q)),
        reversals=_reversals(speed),
        slow_share=float(slow.mean()),
        top_speed=top,
        top_acceleration=float(np.percentile(np.abs(acceleration), 99)),
        free_travel=float(np.ptp(q[~powered])) if (~powered).sum() > 2 else 0.0,
        has_drive="goal" in recording.signals or "voltage_command" in recording.signals,
        error_p95=float(np.percentile(np.abs(error), 95)) if error.size else 0.0,
        saturated=_saturated(recording, error, servo),
        goal_speed=_goal_speed(recording),
        gravity=gravity_torque(recording),
        lift=float(np.abs(np.sin(q)).max()),
        inertia_known=recording.rig.inertia is not None or gravity_torque(recording) not in (None, 0.0),
        supply=None if supply is None else (float(supply.y.min()), float(np.median(supply.y)), float(supply.y.max())),
        clock=recording.clock,
        detail=detail_of(t, q, powered, every_error, step, recording.signals.get("goal"), supply),
    )


def gravity_torque(recording: Recording) -> float | None:
    """Torque that holds the arm horizontal [N m], as declared or from mass and length; None when not known."""
    rig = recording.rig
    if rig.gravity_torque is not None:
        return rig.gravity_torque
    if rig.mass is None or rig.length is None:
        return None
    return GRAVITY * rig.length * (rig.mass + (rig.arm_mass or 0.0) / 2)


def _smooth(y: FloatArray) -> FloatArray:
    padded = np.pad(y, SMOOTHING // 2, mode="edge")
    return np.convolve(padded, np.full(SMOOTHING, 1 / SMOOTHING), mode="valid")


def _powered(recording: Recording, t: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    enable = recording.signals.get("torque_enable")
    if enable is None:
        return np.ones(t.size, dtype=bool)
    last = np.clip(np.searchsorted(enable.t, t, side="right") - 1, 0, None)
    return np.asarray(enable.y[last] > 0.5, dtype=bool)


def _error(recording: Recording, t: FloatArray, q: FloatArray) -> FloatArray:
    goal = recording.signals.get("goal")
    if goal is None or goal.columns:
        return np.zeros(t.size)
    return np.asarray(np.interp(t, goal.t, goal.y) - q, dtype=np.float64)


def _saturated(recording: Recording, error: FloatArray, servo: Servo | None) -> float | None:
    rig = recording.rig
    known = servo or NOMINAL.get(rig.servo or "")
    if rig.firmware_gain is None or error.size == 0:
        return None
    if known is None:
        return None
    duty = recording.signals.get("duty")
    if duty is not None and not duty.columns:
        return float((np.abs(duty.y) > 0.99 * known.max_duty).mean())
    return float((known.error_gain * rig.firmware_gain * np.abs(error) > known.max_duty).mean())


def _goal_speed(recording: Recording) -> float:
    goal = recording.signals.get("goal", recording.signals.get("voltage_command"))
    if goal is None or goal.columns or goal.t.size < 3:
        return 0.0
    # A mean of the largest few, so that a single step counts as well as steady motion does.
    speed = np.sort(np.abs(np.diff(goal.y) / np.diff(goal.t)))
    return float(speed[-max(5, speed.size // 20) :].mean())


def _reversals(speed: FloatArray) -> int:
    signs = np.sign(speed[np.abs(speed) > MOVING])
    return int(np.count_nonzero(np.diff(signs)))


def motions(recordings: Sequence[Recording], servo: Servo | None = None) -> list[Motion]:
    """What each bench run did; recordings of robots are left out.

    Args:
        recordings: of benches and robots.
        servo: type of all, see `motion`.

    Raises:
        LogError: nothing to inspect.
    """
    if not recordings:
        raise LogError("no recording to inspect")
    return [motion(recording, servo) for recording in recordings if is_bench(recording)]

"""The pendulum bench: what drives it, what is compared, and when the motor is powered.

A `BenchRun` is one recording made ready for simulation on the grid of the bench model: goals
as the zero-order hold the servo saw, averaged over each physics step (so that the timing of a
write is kept finer than the step), and measurements at their own times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.servo import Servo

GRAVITY = 9.81  # [m/s^2] as in bench_pendulum.xml; a test holds the two together
_START_WINDOW = 0.03  # [s] of data at most for the speed at the start ...
_START_SAMPLES = 12  # ... and samples at most: at 1 kHz a step from rest is long on its way after 30 ms
_FROM_REST = 1.6  # speed at the end of that window over the one at its start that says: it began at rest
_STILL = 0.004  # [rad] spread within that window that still counts as standing
_SUPPLY_SMOOTHING = 0.1  # [s] readings of a sagging supply alias with the PWM; their mean does not
_REST = 0.2  # share of a run, that of the smallest errors, in which the supply counts as unloaded
_AGREES = 0.02  # relative difference within which a declared supply is believed
_SUPPLY_RATE = 5.0  # [Hz] below it a measured supply says nothing about sag within a run
_NO_LOAD_INERTIA = 1e-6  # [kg m^2] stands for a bare horn, far below any armature


@dataclass(frozen=True)
class BenchRun:
    """One recording on the simulation's time grid.

    Attributes:
        name: of the recording.
        group: rig and gain as text; ranges widen by what leaving one out changes.
        rig: load as text; runs of one rig share a mounting, so a zero offset.
        trajectory: name of the excitation, or empty.
        inertia: of the pendulum about the axis [kg m^2].
        gravity_torque: at the horizontal [N m].
        kp_scale: firmware gain times supply, relative to where the servo's kp is stated.
        force_scale: supply, relative to where the force limit is stated.
        control: `position`, `voltage` or `force`: what commands are.
        command: mean command over each physics step [rad, V, N m or N], shape (lead + steps,).
        lead: how many of the commands were given before the start; they are still under way.
        supply: measured supply in each step over its median, shape (steps,); ones where it is not measured often.
        switches: times [s] at which the torque flag turns, shape (m,).
        powered_first: whether the motor is powered at the start.
        q0, dq0: measured angle [rad] and speed [rad/s] at the start.
        t: measured times [s], shape (T,); zero is the first.
        y: measured angle [rad], shape (T,).
        rest: supply under the least load over the one that the scales are for.
        free_start: the start is fitted too (pieces of a longer run).
        step, weight: position of each measured time on the grid: between states `step` and
            `step` + 1, `weight` of the way, shape (T,).
    """

    name: str
    group: str
    rig: str
    trajectory: str
    inertia: float
    gravity_torque: float
    kp_scale: float
    force_scale: float
    control: str
    command: FloatArray
    lead: int
    supply: FloatArray
    switches: FloatArray
    powered_first: bool
    q0: float
    dq0: float
    t: FloatArray
    y: FloatArray
    step: FloatArray
    weight: FloatArray
    rest: float = 1.0
    free_start: bool = False

    @property
    def steps(self) -> int:
        """Physics steps to simulate."""
        return self.command.size - self.lead

    @property
    def absolute(self) -> bool:
        """Whether commands are volts or forces, which no zero offset shifts."""
        return self.control != "position"


def bench_run(recording: Recording, servo: Servo, timestep: float) -> BenchRun:
    """Prepare a recording of the pendulum bench.

    Args:
        recording: with a `position` and a `goal` (or `voltage_command`) signal.
        servo: supply and firmware gain at which kp and force limit are stated.
        timestep: of the bench model [s].

    Raises:
        LogError: a signal or fact is missing, with what to do about it.
    """
    rig = recording.rig
    position = recording.signal("position")
    drive = _drive(recording)
    _check_single(recording, position, drive)
    start = position.t[0]
    t = position.t - start
    if t.size < 3:
        raise LogError(f"{recording.name}: {t.size} position samples; expected at least 3")
    steps = int(np.ceil(t[-1] / timestep)) + 1
    inertia, gravity_torque = load_of(recording)
    switches, powered_first = _switches(recording, start)
    absolute = rig.control != "position"
    # A firmware that makes up for the supply is as good as one on the stated supply, which never moves.
    steady = servo.supply_compensated
    supply = 1.0 if absolute else servo.supply_voltage if steady else _supply(recording)
    share = supply / servo.supply_voltage
    cells = np.minimum(np.floor(t / timestep), steps - 1)
    return BenchRun(
        name=recording.name,
        group=f"{rig.mass}kg {rig.length}m P{rig.firmware_gain}" if not absolute else recording.name,
        rig=f"{rig.mass}kg {rig.length}m",
        trajectory=rig.trajectory or "",
        inertia=inertia,
        gravity_torque=gravity_torque,
        kp_scale=1.0 if absolute else _gain(recording) / servo.firmware_gain * share,
        force_scale=1.0 if absolute else share,
        control=rig.control,
        command=held_means(drive, start, steps, timestep),
        lead=0,
        supply=np.ones(steps) if steady else _supply_course(recording, start, steps, timestep),
        switches=switches,
        powered_first=powered_first,
        q0=float(position.y[0]),
        dq0=_starting_speed(t, position.y),
        t=t,
        y=position.y,
        step=cells,
        weight=t / timestep - cells,
        rest=1.0 if absolute or steady else _rest(recording, drive, position) / supply,
    )


_DRIVES = {
    "position": ("goal", "as positions on /joint_command"),
    "voltage": ("voltage_command", "as an interface of /dynamic_joint_states"),
    "force": ("force", "as an interface of /dynamic_joint_states"),
}


def _drive(recording: Recording) -> Signal:
    """What the servo was told; a fit without it would be a guess."""
    name, topic = _DRIVES[recording.rig.control]
    if name not in recording.signals:
        raise LogError(
            f"{recording.name} has no '{name}' signal; it has {', '.join(sorted(recording.signals))}; "
            f"record the commands too, {topic}"
        )
    return recording.signals[name]


def _check_single(recording: Recording, *signals: Signal) -> None:
    for signal in signals:
        if signal.y.ndim != 1:
            raise LogError(
                f"{recording.name}: '{signal.name}' holds {len(signal.columns)} joints ({', '.join(signal.columns)}); "
                "a bench fit expects one"
            )
        if signal.unit == "rad" and np.abs(signal.y).max() > 1e3:
            raise LogError(
                f"{recording.name}: '{signal.name}' reaches {np.abs(signal.y).max():.0f}, expected radians; "
                "if it is degrees, import it again with --unit deg"
            )


def load_of(recording: Recording) -> tuple[float, float]:
    """Inertia about the axis [kg m^2] and gravity torque at the horizontal [N m].

    Raises:
        LogError: nobody says what hangs on the arm.
    """
    rig = recording.rig
    if rig.inertia is not None and rig.gravity_torque is not None:
        return max(rig.inertia, _NO_LOAD_INERTIA), rig.gravity_torque
    if rig.mass is None or rig.length is None:
        if rig.control != "position":
            return _NO_LOAD_INERTIA, 0.0
        raise LogError(
            f"{recording.name}: the load is not known (mass and length, or inertia and gravity torque); "
            "give --mass KG --length M (0 for a bare horn)"
        )
    arm = rig.arm_mass or 0.0
    # A point mass at the end of a uniform rod.
    inertia = (rig.mass + arm / 3.0) * rig.length**2
    return max(inertia, _NO_LOAD_INERTIA), (rig.mass + arm / 2.0) * GRAVITY * rig.length


def _gain(recording: Recording) -> float:
    gain = recording.rig.firmware_gain
    if not gain:
        raise LogError(f"{recording.name}: the firmware P gain is not known; give --firmware-gain P")
    return gain


def _supply(recording: Recording) -> float:
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


def _switches(recording: Recording, start: float) -> tuple[FloatArray, bool]:
    """Times [s] after the start at which the torque flag turns, and its first state."""
    enable = recording.signals.get("torque_enable")
    if enable is None:
        return np.zeros(0), True
    on = enable.y > 0.5
    turns = np.flatnonzero(on[1:] != on[:-1]) + 1
    return enable.t[turns] - start, bool(on[0])


def held_means(drive: Signal, start: float, steps: int, timestep: float) -> FloatArray:
    """Mean over each physics step of the held command, shape (steps,)."""
    times = drive.t - start
    integral = np.concatenate([[0.0], np.cumsum(drive.y[:-1] * np.diff(times))])
    edges = np.arange(steps + 1) * timestep
    # Before the first command the first one is held, after the last one the last.
    total = np.interp(edges, times, integral)
    total += np.where(edges < times[0], (edges - times[0]) * drive.y[0], 0.0)
    total += np.where(edges > times[-1], (edges - times[-1]) * drive.y[-1], 0.0)
    return np.asarray(np.diff(total) / timestep)


def _rest(recording: Recording, drive: Signal, position: Signal) -> float:
    """Supply [V] while the servo pulls least: mean of what was measured at the smallest errors."""
    measured = recording.signals.get("supply_voltage")
    declared = recording.rig.supply_voltage
    if measured is None:
        return _declared_supply(recording)
    goal = drive.y[np.maximum(np.searchsorted(drive.t, measured.t, side="right") - 1, 0)]
    error = np.abs(goal - np.interp(measured.t, position.t, position.y))
    rest = float(np.mean(measured.y[error <= np.quantile(error, _REST)]))
    # A declared supply that agrees is the better number: a servo measures in steps of 0.1 V.
    return declared if declared and abs(declared - rest) < _AGREES * rest else rest


def _supply_course(recording: Recording, start: float, steps: int, timestep: float) -> FloatArray:
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
    return np.asarray((total[high] - total[low]) / (high - low) / _supply(recording))


def _starting_speed(t: FloatArray, y: FloatArray) -> float:
    """Speed at the first sample [rad/s] from a parabola through the first positions.

    The servo's own speed register is not used: it is filtered and late.
    """
    count = min(int(np.searchsorted(t, _START_WINDOW, side="right")), _START_SAMPLES)
    if count < 8 or np.ptp(y[:count]) < _STILL:
        return 0.0
    third = count // 3
    early, late = (
        (y[third] - y[0]) / (t[third] - t[0]),
        (y[count - 1] - y[-third + count - 1]) / (t[count - 1] - t[count - 1 - third]),
    )
    if late * early >= 0.0 and abs(late) > _FROM_REST * abs(early):
        # Nothing that moves already gets that much faster within milliseconds; what starts from rest does.
        return 0.0
    return float(np.polynomial.Polynomial.fit(t[:count], y[:count], 2).deriv()(0.0))


def segments(run: BenchRun, seconds: float, timestep: float, lead: float = 0.1) -> list[BenchRun]:
    """A run cut into pieces that start from measured states: multiple shooting for what diverges.

    Args:
        run: a whole recording.
        seconds: length of a piece [s], about: all pieces of a run are equally long.
        timestep: of the grid [s].
        lead: commands kept before each start [s], for those that are still under way.
    """
    count = max(round(run.t[-1] / seconds), 1)
    edges = [int(np.searchsorted(run.t, i * run.t[-1] / count)) for i in range(count)] + [run.t.size - 1]
    pieces = [_piece(run, i, a, b, timestep, lead) for i, (a, b) in enumerate(pairwise(edges))]
    return [piece for piece in pieces if piece.t.size >= 3]


def _piece(run: BenchRun, index: int, first: int, last: int, timestep: float, lead: float) -> BenchRun:
    """Samples `first` to `last` as a run of its own; its grid starts at its first sample."""
    cell = int(run.step[first])
    shift = float(run.t[first]) - cell * timestep  # the piece's grid is the run's, moved by less than a step
    t = run.t[first : last + 1] - run.t[first]
    steps = int(np.ceil(t[-1] / timestep)) + 1
    before = min(round(lead / timestep), cell)
    share = shift / timestep
    padded = np.append(run.command, [run.command[-1], run.command[-1]])
    at = run.lead + cell - before + np.arange(before + steps)
    at = np.minimum(at, padded.size - 2)
    cells = np.minimum(np.floor(t / timestep), steps - 1)
    turns = run.switches - run.t[first]
    # A turn is late by the command delay as well: one just before the start may still be under way.
    early = int(np.count_nonzero(turns <= -before * timestep))
    # The segment's own first sample carries an encoder step of noise: its neighbours share it out.
    around = slice(max(first - _START_SAMPLES // 2, 0), first + _START_SAMPLES // 2 + 1)
    q0, dq0 = _local_state(run.t[around] - run.t[first], run.y[around])
    return replace(
        run,
        name=f"{run.name}@{index}",
        command=(1.0 - share) * padded[at] + share * padded[at + 1],
        lead=before,
        supply=run.supply[np.minimum(cell + np.arange(steps), run.supply.size - 1)],
        switches=turns[early:],
        powered_first=run.powered_first ^ bool(early % 2),
        q0=run.q0 if first == 0 else q0,
        dq0=run.dq0 if first == 0 else dq0,
        t=t,
        y=run.y[first : last + 1],
        step=cells,
        weight=t / timestep - cells,
        free_start=True,
    )


def _local_state(t: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Angle [rad] and speed [rad/s] at t = 0 from a parabola through the samples around it."""
    fitted = np.polynomial.Polynomial.fit(t, y, min(2, t.size - 1))
    return float(fitted(0.0)), float(fitted.deriv()(0.0))


def runs_of(recordings: Sequence[Recording], servo: Servo, timestep: float) -> list[BenchRun]:
    """Every recording made ready for simulation; see `bench_run`."""
    return [bench_run(one, servo, timestep) for one in recordings]

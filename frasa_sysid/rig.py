"""The pendulum bench: what drives it, what is compared, and when the motor is powered.

A `BenchRun` is one recording made ready for simulation on the grid of the bench model: goals
as the zero-order hold the servo saw, averaged over each physics step (so that the timing of a
write is kept finer than the step), and measurements at their own times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.servo import Servo
from frasa_sysid.supply import rest_of, supply_course, supply_of

GRAVITY = 9.81  # [m/s^2] as in bench_pendulum.xml; a test holds the two together
_START_WINDOW = 0.03  # [s] of data at most for the speed at the start ...
START_SAMPLES = 12  # ... and samples at most: at 1 kHz a step from rest is long on its way after 30 ms
_FROM_REST = 1.6  # speed at the end of that window over the one at its start that says: it began at rest
_STILL = 0.004  # [rad] spread within that window that still counts as standing
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
        log: number of the log that a piece is of; -1 for a log that is whole, a number no other has.
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
    log: int = -1

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
    supply = 1.0 if absolute else servo.supply_voltage if steady else supply_of(recording)
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
        supply=np.ones(steps) if steady else supply_course(recording, start, steps, timestep),
        switches=switches,
        powered_first=powered_first,
        q0=float(position.y[0]),
        dq0=_starting_speed(t, position.y),
        t=t,
        y=position.y,
        step=cells,
        weight=t / timestep - cells,
        rest=1.0 if absolute or steady else rest_of(recording, drive, position) / supply,
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


def _starting_speed(t: FloatArray, y: FloatArray) -> float:
    """Speed at the first sample [rad/s] from a parabola through the first positions.

    The servo's own speed register is not used: it is filtered and late.
    """
    count = min(int(np.searchsorted(t, _START_WINDOW, side="right")), START_SAMPLES)
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


def runs_of(recordings: Sequence[Recording], servo: Servo, timestep: float) -> list[BenchRun]:
    """Every recording made ready for simulation; see `bench_run`."""
    return [bench_run(one, servo, timestep) for one in recordings]

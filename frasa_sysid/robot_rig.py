"""A robot's recording made ready for simulation: goals on the physics grid, channels at their own times.

Every channel keeps its stamps; simulations are interpolated to them (design law 8). What a channel of
age d says at its stamp t is the state at t - d.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.recording import FloatArray, Recording, Signal
from frasa_sysid.rig import held_means

Base = Literal["fixed", "floating"]
IntArray = npt.NDArray[np.int64]
_NEIGHBOURS = 4  # samples on either side that share out the noise of one, for a state to start from
_LONGEST_GAP = 0.5  # [s] without a position; beyond it a log is of two recordings
SLOWEST = 0.05  # [s] median between positions beyond which a motion of a servo is not seen


@dataclass(frozen=True)
class Channel:
    """One measured quantity on its own clock.

    Attributes:
        t: stamps [s] from the run's start, shape (T,).
        y: values, shape (T, c).
        joints: which joint of the run each column is of, shape (c,); empty for what is the trunk's.
    """

    t: FloatArray
    y: FloatArray
    joints: IntArray


@dataclass(frozen=True)
class RobotRun:
    """One recording of a whole robot on the grid of the simulation.

    Attributes:
        name: of the recording.
        base: `fixed` with the trunk hung or held, `floating` on the ground.
        joints: names, J of them, those that the model actuates, in the order of its actuators.
        goal: mean goal over each physics step [rad], shape (steps, J); row 0 begins at the run's start.
        supply: in each step [V], shape (steps,).
        firmware_gain: P of the servos' position loop, in the firmware's unit; None where nobody said.
        channels: by name: `position` [rad], `velocity` [rad/s], `gyro` [rad/s], `orientation` (w x y z).
    """

    name: str
    base: Base
    joints: tuple[str, ...]
    goal: FloatArray
    supply: FloatArray
    firmware_gain: float | None
    channels: dict[str, Channel]

    @property
    def steps(self) -> int:
        """Physics steps from start to end."""
        return len(self.goal)


def robot_run(recording: Recording, model: mujoco.MjModel, base: Base | None = None) -> RobotRun:
    """Prepare a recording of a robot.

    Args:
        recording: with `position` and `goal` of all joints that the model actuates.
        model: the robot, at whose physics step the grid is.
        base: where the log does not say.

    Raises:
        LogError: a signal or a joint is missing, or the log is too slow or has a hole.
        UsageError: nobody says whether the trunk was held.
    """
    joints = actuated_joints(model)
    position, goal = _joint_signal(recording, "position", joints), _joint_signal(recording, "goal", joints)
    start, timestep = float(position.t[0]), float(model.opt.timestep)
    _check_times(recording, position)
    steps = int(np.ceil((position.t[-1] - start) / timestep)) + 1
    columns = [list(goal.columns).index(name) for name in joints]
    goals = [held_means(Signal("goal", "rad", goal.t, goal.y[:, i]), start, steps, timestep) for i in columns]
    held = base or recording.rig.base
    if held is None:
        raise UsageError(f"{recording.name} does not say whether the trunk was held: give --base fixed or floating")
    channels = {
        name: found
        for name in ("position", "velocity", "gyro", "orientation")
        if (found := _channel(recording, name, joints, start)) is not None
    }
    return RobotRun(
        recording.name,
        held,
        joints,
        np.column_stack(goals),
        _supply(recording, model, start, steps, timestep),
        recording.rig.firmware_gain,
        channels,
    )


def is_robot(recording: Recording) -> bool:
    """Whether a recording is of many joints."""
    position = recording.signals.get("position")
    return position is not None and len(position.columns) > 1


def actuated_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints that the actuators turn, in their order."""
    return tuple(model.joint(int(joint)).name for joint in model.actuator_trnid[:, 0])


def local_states(channel: Channel, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values and rates at some times from parabolas through the samples around them, (N, c) each.

    Args:
        channel: with c columns.
        times: [s], shape (N,).
    """
    values, rates = np.empty((2, times.size, channel.y.shape[1]))
    for i, time in enumerate(times):
        centre = int(np.searchsorted(channel.t, time))
        low = min(max(centre - _NEIGHBOURS, 0), max(channel.t.size - 2 * _NEIGHBOURS, 0))
        rows = slice(low, low + 2 * _NEIGHBOURS)
        fitted = np.polynomial.polynomial.polyfit(channel.t[rows] - time, channel.y[rows], 2)
        values[i], rates[i] = fitted[0], fitted[1]
    return values, rates


def _joint_signal(recording: Recording, name: str, joints: Sequence[str]) -> Signal:
    if name not in recording.signals:
        raise LogError(
            f"{recording.name} has no '{name}' signal; it has {', '.join(sorted(recording.signals))}; a robot's log "
            "needs measured positions (/joint_states) and goals (/joint_command)"
        )
    signal = recording.signals[name]
    missing = [joint for joint in joints if joint not in signal.columns]
    if missing:
        raise LogError(
            f"{recording.name}: '{name}' lacks {', '.join(missing)}; it has {', '.join(signal.columns) or 'one joint'}"
        )
    return signal


def _check_times(recording: Recording, position: Signal) -> None:
    gaps = np.diff(position.t)
    if gaps.size < 2 * _NEIGHBOURS:
        raise LogError(f"{recording.name}: {position.t.size} positions; expected seconds of them")
    if np.median(gaps) > SLOWEST:
        raise LogError(
            f"{recording.name}: positions every {np.median(gaps) * 1e3:.0f} ms; no servo's motion is seen at that "
            "rate: record at 50 Hz or more"
        )
    if gaps.max() > _LONGEST_GAP:
        raise LogError(f"{recording.name}: no position for {gaps.max():.1f} s; cut the log there")


def _channel(recording: Recording, name: str, joints: tuple[str, ...], start: float) -> Channel | None:
    signal = recording.signals.get(name)
    if signal is None or not signal.columns:
        return None
    if name in ("gyro", "orientation"):
        y = signal.y - _gyro_bias(recording) if name == "gyro" else _continuous(signal.y)
        return Channel(signal.t - start, y, np.zeros(0, np.int64))
    known = [joint for joint in joints if joint in signal.columns]
    places = [signal.columns.index(joint) for joint in known]
    return Channel(signal.t - start, signal.y[:, places], np.array([joints.index(joint) for joint in known], np.int64))


def _continuous(quaternions: FloatArray) -> FloatArray:
    """The same orientations without jumps to the other of the two quaternions that mean each, shape (T, 4)."""
    turns = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(quaternions * np.cumprod(np.concatenate([[1.0], turns]))[:, None])


def _gyro_bias(recording: Recording) -> FloatArray:
    """Mean rate that the gyro tells beyond what the trunk turned from start to end [rad/s], shape (3,).

    Without an orientation the robot counts as having ended as it began.
    """
    told: FloatArray = recording.signals["gyro"].y.mean(axis=0)
    turned = recording.signals.get("orientation")
    if turned is None or turned.t.size < 2:
        return told
    w, v = turned.y[:, :1], turned.y[:, 1:]
    # Of q0* q1, about twice the vector is the angle; the short way round, whichever sign a reading has.
    real = w[:-1] * w[1:] + np.sum(v[:-1] * v[1:], axis=1, keepdims=True)
    steps = 2.0 * np.sign(real) * (w[:-1] * v[1:] - w[1:] * v[:-1] - np.cross(v[:-1], v[1:]))
    return np.asarray(told - steps.sum(axis=0) / (turned.t[-1] - turned.t[0]))


def _supply(recording: Recording, model: mujoco.MjModel, start: float, steps: int, timestep: float) -> FloatArray:
    """Supply in each step [V]: measured, else declared, else what the model is stated at, shape (steps,)."""
    signal = recording.signals.get("supply_voltage")
    if signal is None:
        return np.full(steps, recording.rig.supply_voltage or float(model.numeric("servo_supply_voltage").data[0]))
    values = signal.y if signal.y.ndim == 1 else signal.y.mean(axis=1)
    if not (values > 0.0).all():
        raise LogError(f"{recording.name}: 'supply_voltage' reads {values.min():g} V; no servo runs on that")
    return np.asarray(np.interp(start + (np.arange(steps) + 0.5) * timestep, signal.t, values))

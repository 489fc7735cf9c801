"""A log of the virtual robot, as its computer would record it: bus, IMU and battery, each with its faults.

The motion comes from `robot_physics`; here it is read late, in counts, on clocks that jitter.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from frasa_sysid.errors import QualityError
from frasa_sysid.excitation import Excitation
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.robot_body import Body, Joints, build
from frasa_sysid.robot_physics import ENCODER_COUNT, TIMESTEP, Traces, simulate
from frasa_sysid.robot_truth import RobotTruth, parameters_of

FloatArray = npt.NDArray[np.float64]
# Present Speed of the MX series with protocol 1 (whose P gain of 12 this robot has): about 0.114 rpm a count
# (ROBOTIS e-Manual, MX-64 and MX-106). Protocol 2 and the X series report 0.229 rpm.
SPEED_COUNT = 0.114 * 2.0 * np.pi / 60.0  # [rad/s]
GYRO_COUNT = np.radians(2000.0) / 2**15  # [rad/s] 16 bit at 2000 deg/s
VOLTAGE_COUNT = 0.1  # [V] Present Voltage
WRITE_AFTER = 0.001  # [s] from reading the joints to writing the goals of a cycle
UPRIGHT = 0.7  # cosine of the trunk's tilt
SETTLE = 1.5  # [s] at the first goal before the log begins


@dataclass(frozen=True)
class Wiring:
    """How the robot's computer reads its robot; `IDEAL` is without faults.

    Attributes:
        period: of the read-write loop [s].
        read_jitter: mean of the exponential delay that a cycle takes longer [s].
        stamp_jitter: standard deviation of a joint's stamp against the true time [s].
        lost: share of the joint readings that the bus loses.
        imu_period: [s], the IMU's own.
        imu_jitter: standard deviation of its stamps [s].
        battery_period: [s].
        gyro_noise: [rad/s], white.
        orientation_noise: [rad] of each axis, of the filter's slow error.
        orientation_memory: its time constant [s].
        quantized: readings come in counts.
    """

    period: float = 0.01
    read_jitter: float = 0.0003
    stamp_jitter: float = 0.0001
    lost: float = 0.02
    imu_period: float = 0.01004
    imu_jitter: float = 0.0003
    battery_period: float = 0.1
    gyro_noise: float = 0.005
    orientation_noise: float = 0.003
    orientation_memory: float = 0.5
    quantized: bool = True


IDEAL = Wiring(
    read_jitter=0.0, stamp_jitter=0.0, lost=0.0, imu_jitter=0.0, gyro_noise=0.0, orientation_noise=0.0, quantized=False
)


def simulate_robot(
    path: Path,
    joints: Joints,
    truth: RobotTruth,
    excitation: Excitation,
    seconds: float,
    source: str,
    wiring: Wiring = Wiring(),
    timestep: float = TIMESTEP,
    take: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Recording:
    """One log of a robot that follows an excitation.

    Args:
        path: model of the body.
        joints: of that model.
        truth: the robot.
        excitation: goals that are sent.
        seconds: length of the log.
        source: name of the recording.
        wiring: of its computer.
        timestep: of the physics [s].
        take: number of the log of this robot: another one has jitter and noise of its own.
        progress: called now and then with the share done.

    Raises:
        QualityError: a robot on its feet fell.
    """
    body = build(path, truth, joints, timestep)
    own = (take,) if take else ()
    rngs = [np.random.default_rng((truth.seed, 100 + i, *own)) for i in range(5)]
    reads = _cycle_times(rngs[0], wiring, seconds)
    written = reads + WRITE_AFTER
    goals = _counted(excitation.at(written), ENCODER_COUNT, wiring.quantized)
    traces = simulate(body, joints, truth, written, goals, seconds, wiring.quantized, progress)
    _check_upright(truth, traces, seconds)
    signals = {
        **_joint_signals(rngs[1], joints, truth, wiring, traces, reads),
        **_goal_signal(rngs[2], joints, wiring, written, goals),
        **_imu_signals(rngs[3], truth, wiring, traces, seconds),
        **_battery_signal(rngs[4], wiring, traces, seconds),
    }
    return _recording(source, path, joints, body, truth, excitation, signals)


def _check_upright(truth: RobotTruth, traces: Traces, seconds: float) -> None:
    x, y = traces.orientation[:, 1], traces.orientation[:, 2]
    fallen = np.flatnonzero(1.0 - 2.0 * (x**2 + y**2) < UPRIGHT)
    if fallen.size and truth.base == "floating":
        when = traces.t[fallen[0]]
        raise QualityError(f"the simulated robot (seed {truth.seed}) fell at {when:.2f} s of {seconds:g} s; no log")


def _recording(
    source: str,
    path: Path,
    joints: Joints,
    body: Body,
    truth: RobotTruth,
    excitation: Excitation,
    signals: Mapping[str, Signal],
) -> Recording:
    facts = RigFacts(
        firmware_gain=truth.firmware_gain, trajectory="+".join(part.name for part in excitation.parts), base=truth.base
    )
    extra = {
        "note": f"simulated by frasa-sysid simulate --robot, seed {truth.seed}; no robot was recorded",
        "model": path.name,
        "seed": truth.seed,
        "hold": excitation.hold,
        "parts": [[part.name, part.start, part.end, part.purpose] for part in excitation.parts],
    }
    known = parameters_of(truth, joints.classes, body.trunk_mass, body.trunk_com)
    return Recording(source, signals, facts, "simulated", source, "", "header", truth=known, extra=extra)


def _cycle_times(rng: Generator, wiring: Wiring, seconds: float) -> FloatArray:
    """True times at which joints are read [s], from before the log to its end."""
    count = int((SETTLE + seconds) / wiring.period)
    grid = -SETTLE + np.arange(count) * wiring.period
    return np.asarray(grid + _exponential(rng, wiring.read_jitter, count, most=0.8 * wiring.period))


def _exponential(rng: Generator, mean: float, count: int, most: float) -> FloatArray:
    return np.minimum(rng.exponential(1.0, count) * mean, most)


def _stamped(rng: Generator, times: FloatArray, jitter: float) -> FloatArray:
    """Stamps [s] to the microsecond, right on average, strictly increasing."""
    micro = np.round((times + rng.normal(0.0, 1.0, times.size) * jitter) * 1e6).astype(np.int64)
    micro = np.maximum.accumulate(micro - np.arange(micro.size)) + np.arange(micro.size)
    return np.asarray(micro * 1e-6)


def _counted(values: FloatArray, count: float, quantized: bool) -> FloatArray:
    return np.asarray(np.round(values / count) * count) if quantized else values


def _at(times: FloatArray, t: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns (T, k) over t, interpolated to other times (K,), shape (K, k)."""
    return np.stack([np.interp(times, t, column) for column in columns.T], axis=1)


def _joint_signals(
    rng: Generator, joints: Joints, truth: RobotTruth, wiring: Wiring, traces: Traces, reads: FloatArray
) -> dict[str, Signal]:
    stamps = _stamped(rng, reads, wiring.stamp_jitter)
    kept = (rng.uniform(0.0, 1.0, reads.size) >= wiring.lost) & (stamps >= 0.0)
    times, stamps = reads[kept], stamps[kept]
    zero = np.array([(truth.zeros or {}).get(name, 0.0) for name in joints.names])
    angle = _at(times - truth.position_delay, traces.t, traces.angle) + zero
    speed = _at(times - truth.velocity_delay, traces.t_speed, traces.speed)
    return {
        "position": Signal("position", "rad", stamps, _counted(angle, ENCODER_COUNT, wiring.quantized), joints.names),
        "velocity": Signal("velocity", "rad/s", stamps, _counted(speed, SPEED_COUNT, wiring.quantized), joints.names),
    }


def _goal_signal(
    rng: Generator, joints: Joints, wiring: Wiring, written: FloatArray, goals: FloatArray
) -> dict[str, Signal]:
    stamps = _stamped(rng, written, wiring.stamp_jitter)
    kept = stamps >= 0.0
    return {"goal": Signal("goal", "rad", stamps[kept], goals[kept], joints.names)}


def _imu_signals(
    rng: Generator, truth: RobotTruth, wiring: Wiring, traces: Traces, seconds: float
) -> dict[str, Signal]:
    phase = rng.uniform(0.0, wiring.imu_period)
    times = np.arange(phase, seconds, wiring.imu_period)
    stamps = _stamped(rng, times, wiring.imu_jitter)
    times, stamps = times[stamps >= 0.0], stamps[stamps >= 0.0]
    rate = _at(times - truth.gyro_delay, traces.t_speed, traces.rate) + np.array(truth.gyro_bias)
    rate = rate + wiring.gyro_noise * rng.normal(0.0, 1.0, rate.shape)
    true = _at(times - truth.orientation_delay, traces.t, traces.orientation)
    error = _wandering(rng, times.size, wiring) * wiring.orientation_noise
    turned = _turned(true / np.linalg.norm(true, axis=1, keepdims=True), error)
    return {
        "gyro": Signal("gyro", "rad/s", stamps, _counted(rate, GYRO_COUNT, wiring.quantized), ("x", "y", "z")),
        "orientation": Signal("orientation", "1", stamps, turned, ("w", "x", "y", "z")),
    }


def _wandering(rng: Generator, count: int, wiring: Wiring) -> FloatArray:
    """Noise of unit variance that forgets itself as a fusion filter's error does, shape (count, 3)."""
    keep = float(np.exp(-wiring.imu_period / wiring.orientation_memory))
    fresh = rng.normal(0.0, 1.0, (count, 3))
    noise = fresh.copy()
    for k in range(1, count):
        noise[k] = keep * noise[k - 1] + np.sqrt(1.0 - keep**2) * fresh[k]
    return noise


def _turned(q: FloatArray, by: FloatArray) -> FloatArray:
    """Quaternions (T, 4), each turned about its own axes by a small rotation vector (T, 3) [rad]."""
    w, v = q[:, :1], q[:, 1:]
    half = by / 2.0
    real = np.sqrt(1.0 - (half**2).sum(axis=1, keepdims=True))
    return np.hstack([w * real - (v * half).sum(axis=1, keepdims=True), w * half + real * v + np.cross(v, half)])


def _battery_signal(rng: Generator, wiring: Wiring, traces: Traces, seconds: float) -> dict[str, Signal]:
    times = np.arange(rng.uniform(0.0, wiring.battery_period), seconds, wiring.battery_period)
    stamps = _stamped(rng, times, wiring.stamp_jitter)
    times, stamps = times[stamps >= 0.0], stamps[stamps >= 0.0]
    volts = _counted(np.interp(times, traces.t, traces.volts), VOLTAGE_COUNT, wiring.quantized)
    # A BatteryState holds single precision.
    volts = volts.astype(np.float32).astype(np.float64)
    return {"supply_voltage": Signal("supply_voltage", "V", stamps, volts[:, None], ("battery",))}

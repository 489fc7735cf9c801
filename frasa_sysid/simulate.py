"""A bench log from known parameters: servo, firmware, supply, encoder and bus, each with its faults.

This is not the model that is fitted: friction is the law the servo was given (M4 for the stored
logs), the voltage law is written out with back-EMF and a sagging supply, the physics runs at 5 kHz and
the firmware at 1 kHz. So a fit of these logs meets model error, as it does with a real servo.
"""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from frasa_sysid import trajectories
from frasa_sysid.calibration.friction import Friction, law_of
from frasa_sysid.recording import FloatArray, Recording, RigFacts, Signal
from frasa_sysid.servo import Servo
from frasa_sysid.simulated_bench import GRAVITY, Bench

PHYSICS_DT = 0.0002  # [s]
FIRMWARE_STEPS = 5  # physics steps per firmware loop (1 kHz)
ENCODER_COUNT = 2.0 * np.pi / 4096  # [rad] 12-bit
DUTY_COUNT = 1.0 / 885.0  # as a Dynamixel X reports its PWM
VOLTAGE_COUNT = 0.1  # [V]


@dataclass(frozen=True)
class _Runs:
    """All runs of the bench side by side, each field of shape (n,) but `trajectory`."""

    mass: FloatArray
    length: FloatArray
    gain: FloatArray
    inertia: FloatArray
    gravity_torque: FloatArray
    trajectory: tuple[str, ...]


def simulate_bench(servo: Servo, bench: Bench, source: str) -> list[Recording]:
    """Every load, gain and trajectory of a bench, one recording each.

    Args:
        servo: the truth.
        bench: the rig.
        source: file name that the recordings will stand in.

    Returns:
        Recordings in the order loads, gains, trajectories; the truth stands in each.
    """
    runs = _runs_of(bench)
    clocks = _read_times(bench, len(runs.trajectory))
    position, voltage, duty = _integrate(servo, bench, runs, clocks)
    return [
        _record(servo, bench, runs, i, clocks[i], position[i], voltage[i], duty[i], source) for i in range(len(clocks))
    ]


def truth_of(servo: Servo, bench: Bench) -> dict[str, float]:
    """The true parameters, in the names and units of a Coulomb-viscous fit where these exist."""
    ages = (
        {} if bench.duty_age is None else {"bench.readout": _readout(bench), "bench.position_age": bench.position_age}
    )
    name, friction = servo.name, servo.friction
    return {
        f"{name}.kp": servo.kp(),
        f"{name}.forcerange": servo.force_limit(),
        f"{name}.damping": servo.damping(),
        f"{name}.damping_off": friction.viscous,
        f"{name}.armature": servo.armature,
        f"{name}.delay": bench.command_delay,
        "bench.offset": bench.zero_offset,
        "friction.viscous": friction.viscous,
        "friction.coulomb": friction.coulomb,
        "friction.stribeck": friction.stribeck,
        **_load_shares(friction),
        "friction.stribeck_speed": friction.stribeck_speed,
        "friction.stribeck_exponent": friction.stribeck_exponent,
        "servo.kt": servo.kt,
        "servo.R": servo.R,
        "supply.resistance": bench.supply_resistance,
        **ages,
    }


def _readout(bench: Bench) -> float:
    """Age of the angle behind a read duty over that of the position beside it [s], the mean; see `readout`."""
    age = bench.duty_age or 0.0
    clocks = np.concatenate(_read_times(bench, len(bench.loads) * len(bench.gains) * len(trajectories.GOALS)))
    # The register holds what the last tick made of the angle it found.
    since = np.round((clocks - age) / PHYSICS_DT) % FIRMWARE_STEPS * PHYSICS_DT
    return age + float(since.mean()) - bench.position_age


def _load_shares(friction: Friction) -> dict[str, float]:
    """One share where motor and load count alike (M3, M4), else each with its own name (M5, M6)."""
    if law_of(friction) in ("m5", "m6"):
        names = ("load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck")
        return {f"friction.{name}": getattr(friction, name) for name in (*names, "quad_motor", "quad_external")}
    return {"friction.load": friction.load_motor, "friction.load_stribeck": friction.load_motor_stribeck}


def _runs_of(bench: Bench) -> _Runs:
    cells = [
        (mass, length, gain, name)
        for mass, length in bench.loads
        for gain in bench.gains
        for name in trajectories.GOALS
    ]
    mass = np.array([cell[0] for cell in cells])
    length = np.array([cell[1] for cell in cells])
    # A point mass at the end of a uniform rod.
    inertia = (mass + bench.arm_mass / 3.0) * length**2
    gravity_torque = (mass + bench.arm_mass / 2.0) * GRAVITY * length
    gain = np.array([cell[2] for cell in cells])
    return _Runs(mass, length, gain, inertia, gravity_torque, tuple(cell[3] for cell in cells))


def _read_times(bench: Bench, count: int) -> list[FloatArray]:
    """True sampling times [s] of each run: a fixed period plus what each read happens to take."""
    samples = int(trajectories.DURATION / bench.period)
    rng = np.random.default_rng(bench.seed)
    late = rng.exponential(bench.read_jitter, (count, samples))
    grid = np.arange(samples) * bench.period
    # Kept on the physics grid so that a sample is a state of the simulation, not an interpolation.
    return [np.unique(np.round((grid + row) / PHYSICS_DT)) * PHYSICS_DT for row in late]


def _integrate(
    servo: Servo, bench: Bench, runs: _Runs, clocks: list[FloatArray]
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """True joint angle [rad], supply voltage [V] and duty of each run, each as old as its channel is when sampled."""
    n = len(clocks)
    steps = round(trajectories.DURATION / PHYSICS_DT)
    goals, enables = _delayed_commands(bench, runs, clocks, steps)
    q, dq = np.zeros(n), np.zeros(n)
    duty, volts, motor = np.zeros(n), np.full(n, bench.supply_voltage), np.zeros(n)
    angle, supply, duties = np.empty((3, steps, n))
    for k in range(steps):
        angle[k], supply[k] = q, volts
        tick, phase = divmod(k, FIRMWARE_STEPS)
        if phase == 0:
            error = goals[tick] - (q + bench.zero_offset)
            duty = np.clip(servo.error_gain * runs.gain * error, -servo.max_duty, servo.max_duty) * enables[tick]
        duties[k] = duty
        motor_volts = servo.supply_voltage if servo.supply_compensated else volts
        current = (duty * motor_volts - servo.kt * dq) / servo.R * enables[tick]
        volts = bench.supply_voltage - bench.supply_resistance * duty * current
        motor = servo.kt * current
        q, dq = _step(servo, runs, q, dq, motor)

    def sampled(values: FloatArray, age: float) -> list[FloatArray]:
        rows = [np.round((clock - age) / PHYSICS_DT).astype(int) for clock in clocks]
        return [values[np.maximum(one, 0), i] for i, one in enumerate(rows)]

    return sampled(angle, bench.position_age), sampled(supply, 0.0), sampled(duties, bench.duty_age or 0.0)


def _step(servo: Servo, runs: _Runs, q: FloatArray, dq: FloatArray, motor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One semi-implicit Euler step; friction stops the joint as far as its bound allows."""
    inertia = runs.inertia + servo.armature
    external = -runs.gravity_torque * np.sin(q)
    bound = servo.friction.bound(motor, external, dq)
    stopping = -(inertia * dq / PHYSICS_DT + motor + external)
    dq = dq + PHYSICS_DT * (motor + external + np.clip(stopping, -bound, bound)) / inertia
    return q + PHYSICS_DT * dq, dq


def _delayed_commands(bench: Bench, runs: _Runs, clocks: list[FloatArray], steps: int) -> tuple[FloatArray, FloatArray]:
    """Goal [rad] and torque flag that the firmware acts on at each of its ticks, shape (ticks, n)."""
    ticks = np.arange(steps // FIRMWARE_STEPS) * (FIRMWARE_STEPS * PHYSICS_DT)
    goals, enables = [], []
    for name, clock in zip(runs.trajectory, clocks, strict=True):
        # Zero-order hold: the last command written at least `command_delay` ago.
        last = np.searchsorted(clock + bench.command_delay, ticks + 1e-9, side="right") - 1
        held = clock[np.maximum(last, 0)]
        goals.append(trajectories.goal(name, held))
        enables.append(trajectories.torque_enabled(name, held))
    return np.array(goals).T, np.array(enables).T


def _record(
    servo: Servo,
    bench: Bench,
    runs: _Runs,
    i: int,
    clock: FloatArray,
    angle: FloatArray,
    volts: FloatArray,
    duty: FloatArray,
    source: str,
) -> Recording:
    rng = np.random.default_rng((bench.seed, i + 1))
    stamps = _stamps(rng, clock, bench.stamp_jitter)
    count = 2.0 * np.pi / servo.ticks_per_turn
    reading = np.round((angle + bench.zero_offset) / count) * count
    name = runs.trajectory[i]
    # The command of a cycle is written right after the read, so both carry one stamp.
    columns = {
        "position": ("rad", reading),
        "goal": ("rad", trajectories.goal(name, clock)),
        "torque_enable": ("1", trajectories.torque_enabled(name, clock)),
        "supply_voltage": ("V", np.round(volts / VOLTAGE_COUNT) * VOLTAGE_COUNT),
    }
    if bench.duty_age is not None:
        columns["duty"] = ("1", np.round(duty / DUTY_COUNT) * DUTY_COUNT)
    facts = RigFacts(
        servo=servo.name,
        mass=float(runs.mass[i]),
        length=float(runs.length[i]),
        arm_mass=bench.arm_mass,
        firmware_gain=float(runs.gain[i]),
        supply_voltage=bench.supply_voltage,
        trajectory=name,
    )
    signals = {key: Signal(key, unit, stamps, y) for key, (unit, y) in columns.items()}
    return Recording(
        f"{source}#{i:02d}", signals, facts, "simulated", source, "", "header", truth=truth_of(servo, bench)
    )


def _stamps(rng: Generator, clock: FloatArray, jitter: float) -> FloatArray:
    """Stamps [s] to the microsecond, starting at zero, strictly increasing."""
    stamps = np.maximum.accumulate(clock + np.abs(rng.normal(0.0, jitter, clock.shape)))
    micro = np.round(stamps * 1e6).astype(np.int64)
    micro = np.maximum.accumulate(micro - np.arange(micro.size)) + np.arange(micro.size)
    return np.asarray((micro - micro[0]) * 1e-6)

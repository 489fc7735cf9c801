"""BAM's identification simulator in plain numpy: every log one column, one numpy step over all of them.

Written from the published equations (Duclusaud et al., arXiv 2410.08650) and from what the field knows of the program:
5 ms steps, the firmware's P law and the motor at the same rate, friction that stops the joint as far as its bound
allows, speed kept within 100 rad/s, and an angle that advances by 0.5 a dt^2 on top of the already updated speed. Logs
are resampled to 5 ms and cut to the shortest. BAM itself simulates one candidate at a time; here several can share a
step, which makes numpy look better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frasa_sysid.calibration.friction import LAWS, Friction
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import ServoValues
from frasa_sysid.servo import Servo
from peers import Bench, Measured, timed

TIMESTEP = 0.005  # [s]
FASTEST = 100.0  # [rad/s]
_STRIBECK = ("m2", "m4", "m5", "m6")
_LOADED = ("m3", "m4", "m5", "m6")


@dataclass(frozen=True)
class BamLogs:
    """Logs on BAM's grid: (steps,) for the time, (logs,) for facts, (steps, logs) for signals.

    Attributes:
        t: [s].
        goal: held [rad].
        power: share of each step in which the motor is powered.
        switched: whether any motor is not powered, by step.
        y: measured [rad].
        inertia, gravity_torque: of the load [kg m^2], [N m].
        volts: supply [V].
        gain: firmware P.
        q0, dq0: at the start [rad], [rad/s].
    """

    t: FloatArray
    goal: FloatArray
    power: FloatArray
    switched: list[bool]
    y: FloatArray
    inertia: FloatArray
    gravity_torque: FloatArray
    volts: FloatArray
    gain: FloatArray
    q0: FloatArray
    dq0: FloatArray

    @property
    def log_steps(self) -> int:
        """Steps to simulate, summed over logs."""
        return (self.t.size - 1) * self.q0.size


def resample(runs: Sequence[BenchRun], servo: Servo, timestep: float) -> BamLogs:
    """Bring runs on the 5 ms grid of the shortest.

    Args:
        runs: commanded by goals.
        servo: supply and firmware gain to which the runs' scales refer.
        timestep: of the runs' commands [s].
    """
    t = np.arange(int(min(run.t[-1] for run in runs) / TIMESTEP) + 1) * TIMESTEP
    held = np.minimum((t / timestep + 1e-9).astype(np.intp), min(run.steps for run in runs) - 1)
    power = np.array([_power(run, t) for run in runs]).T.copy()
    force_scale = np.array([run.force_scale for run in runs])
    return BamLogs(
        t=t,
        goal=np.array([run.command[held] for run in runs]).T.copy(),
        power=power,
        switched=[bool(row.min() < 1.0) for row in power],
        y=np.array([np.interp(t, run.t, run.y) for run in runs]).T.copy(),
        inertia=np.array([run.inertia for run in runs]),
        gravity_torque=np.array([run.gravity_torque for run in runs]),
        volts=servo.supply_voltage * force_scale,
        gain=servo.firmware_gain * np.array([run.kp_scale for run in runs]) / force_scale,
        q0=np.array([run.q0 for run in runs]),
        dq0=np.array([run.dq0 for run in runs]),
    )


def _power(run: BenchRun, t: FloatArray) -> FloatArray:
    turns = np.searchsorted(run.switches, t, side="right")
    return ((turns % 2 == 0) == run.powered_first).astype(np.float64)


def simulate(logs: BamLogs, candidates: Sequence[Servo], law: str, offset: float = 0.0) -> FloatArray:
    """Encoder readings [rad] of candidates on logs, shape (candidates, steps, logs).

    Args:
        logs: on BAM's grid.
        candidates: what is read of each is error gain, duty limit, kt, R, armature and friction.
        law: `m1` to `m6`; terms that it has not are left out of the loop.
        offset: encoder reading with the arm hanging straight down [rad].
    """
    if law not in LAWS:
        raise ValueError(f"unknown friction law '{law}'")
    several = len(candidates) > 1

    def column(values: Sequence[float]) -> FloatArray | float:
        """A plain number for one candidate: numpy is faster without the broadcast."""
        return np.array(values)[:, None] if several else float(values[0])

    def friction(name: str) -> FloatArray | float:
        return column([getattr(one.friction, name) for one in candidates])

    per_volt = column([one.kt / one.R for one in candidates])
    emf = column([one.kt**2 / one.R for one in candidates])
    stiffness = column([one.error_gain for one in candidates]) * logs.gain * per_volt * logs.volts
    limit = column([one.max_duty for one in candidates]) * per_volt * logs.volts
    inertia = logs.inertia + column([one.armature for one in candidates])
    momentum, impulse = inertia / TIMESTEP, TIMESTEP / inertia
    viscous, coulomb = friction("viscous"), friction("coulomb")
    load_motor, load_external = friction("load_motor"), friction("load_external")
    stribeck, static_motor, static_external = (
        friction("stribeck"), friction("load_motor_stribeck"), friction("load_external_stribeck"),
    )  # fmt: skip
    quad_motor, quad_external = friction("quad_motor"), friction("quad_external")
    slowness, exponent = 1.0 / np.asarray(friction("stribeck_speed")), friction("stribeck_exponent")
    has_load, has_stribeck = law in _LOADED, law in _STRIBECK
    lower, heavy = -limit, -logs.gravity_torque

    shape = (len(candidates), logs.q0.size) if several else logs.q0.shape
    q, dq = np.empty(shape), np.empty(shape)
    q[:], dq[:] = logs.q0, logs.dq0
    motor, external, net, stop, bound, work, fade, static = np.empty((8, *shape))
    angle = np.empty((logs.t.size, *shape))
    angle[0] = q
    add, subtract, multiply, absolute = np.add, np.subtract, np.multiply, np.absolute
    minimum, maximum = np.minimum, np.maximum
    for k in range(logs.t.size - 1):
        # Motor: what the firmware's duty gives, less back-EMF.
        subtract(logs.goal[k], q, motor)
        multiply(motor, stiffness, motor)
        minimum(motor, limit, motor)
        maximum(motor, lower, motor)
        multiply(dq, emf, work)
        subtract(motor, work, motor)
        if logs.switched[k]:
            multiply(motor, logs.power[k], motor)
        if offset:
            subtract(q, offset, external)
            np.sin(external, external)
        else:
            np.sin(q, external)
        multiply(external, heavy, external)
        add(motor, external, net)
        # Friction: its bound by the law.
        absolute(dq, bound)
        if has_stribeck:
            multiply(bound, slowness, fade)
            np.power(fade, exponent, fade)
            np.negative(fade, fade)
            np.exp(fade, fade)
        multiply(bound, viscous, bound)
        add(bound, coulomb, bound)
        if has_load:
            multiply(external, load_external, work)
            multiply(motor, load_motor, stop)
            subtract(work, stop, work)
            absolute(work, work)
            add(bound, work, bound)
        if has_stribeck:
            if has_load:
                multiply(external, static_external, static)
                multiply(motor, static_motor, stop)
                subtract(static, stop, static)
                absolute(static, static)
                add(static, stribeck, static)
                if law == "m6":
                    driving = absolute(motor, work) > absolute(external, stop)
                    squared = np.where(driving, quad_external * external**2, quad_motor * motor**2)
                    static += squared * (multiply(motor, external, work) < 0.0)
                multiply(fade, static, fade)
            else:
                multiply(fade, stribeck, fade)
            add(bound, fade, bound)
        # It stops what moves, no more.
        multiply(dq, momentum, stop)
        add(stop, net, stop)
        minimum(stop, bound, stop)
        np.negative(bound, bound)
        maximum(stop, bound, stop)
        subtract(net, stop, net)
        multiply(net, impulse, net)
        add(dq, net, dq)
        minimum(dq, FASTEST, dq)
        maximum(dq, -FASTEST, dq)
        # The over-step: half of what the speed has just gained, added once more.
        multiply(net, 0.5, net)
        add(net, dq, net)
        multiply(net, TIMESTEP, net)
        add(q, net, q)
        angle[k + 1] = q
    return np.moveaxis(angle, 1, 0) if several else angle[None]


def error(logs: BamLogs, candidates: Sequence[Servo], law: str, offset: float = 0.0) -> FloatArray:
    """Mean absolute position error of each candidate [rad]: BAM's objective."""
    return np.abs(simulate(logs, candidates, law, offset) - logs.y).mean(axis=(1, 2))


def stated(servo: Servo, values: ServoValues) -> Servo:
    """The same M1 servo in BAM's terms; there is no delay in them."""
    per_volt = values.kp / (servo.error_gain * servo.firmware_gain * servo.supply_voltage)
    kt = (values.damping - values.damping_off) / per_volt
    return replace(
        servo,
        kt=kt,
        R=kt / per_volt,
        max_duty=values.forcerange / (servo.supply_voltage * per_volt),
        armature=values.armature,
        friction=Friction(values.damping_off, values.frictionloss),
    )


def measure(bench: Bench, law: str = "m1", candidates: int = 1) -> Measured:
    """Time BAM's objective.

    Args:
        bench: logs and servo.
        law: friction law.
        candidates: simulated together; the time is that of one of them.
    """
    logs = resample(bench.runs, bench.servo, bench.timestep)
    # An exponent that is no shortcut for the power; the terms it belongs to are zero in the nominal servo.
    friction = replace(bench.servo.friction, stribeck_speed=1.5, stribeck_exponent=1.3)
    servos = [replace(bench.servo, friction=friction)] * candidates

    def evaluate() -> float:
        return float(error(logs, servos, law)[0])

    return Measured(timed(evaluate).per(candidates), logs.log_steps, logs.t[-1] * len(bench.runs), evaluate)

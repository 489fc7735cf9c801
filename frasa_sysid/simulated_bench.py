"""Benches to simulate: the ones in the box, and one for a servo of a user."""

from dataclasses import dataclass, replace

from frasa_sysid.servo import Servo

GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True)
class Bench:
    """How a simulated bench is built and wired.

    Attributes:
        loads: (mass [kg], length [m]) of each load.
        gains: firmware gains.
        arm_mass: uniform arm [kg].
        supply_voltage: open-circuit supply [V].
        supply_resistance: of supply and cable [Ohm]; makes the voltage sag.
        command_delay: from writing a goal to the firmware using it [s].
        zero_offset: encoder reading when the arm hangs straight down [rad].
        period: of the read-write loop [s].
        read_jitter: mean of the exponential delay that each read adds to the loop [s].
        stamp_jitter: standard deviation of stamp against true sampling time [s].
        seed: of all random draws.
        position_age: of a position at its stamp [s].
        duty_age: of the duty register at its stamp [s]; None for a bench that does not read it.
    """

    loads: tuple[tuple[float, float], ...]
    gains: tuple[float, ...]
    arm_mass: float
    supply_voltage: float
    supply_resistance: float
    command_delay: float
    zero_offset: float
    period: float = 0.01
    read_jitter: float = 0.0004
    stamp_jitter: float = 0.0001
    seed: int = 0
    position_age: float = 0.0
    duty_age: float | None = None


# The benches of bench_logs/: loads up to about half of the stall torque, gains around those of the robot.
BENCHES: dict[str, Bench] = {
    "mx106": Bench(
        loads=((0.535, 0.15), (1.2, 0.15), (2.0, 0.2)),
        gains=(8.0, 16.0, 32.0),
        arm_mass=0.036,
        supply_voltage=15.0,
        supply_resistance=0.25,
        command_delay=0.0085,
        zero_offset=0.013,
        seed=106,
    ),
    "mx64": Bench(
        loads=((0.31, 0.1), (0.535, 0.15), (1.0, 0.15)),
        gains=(8.0, 16.0, 32.0),
        arm_mass=0.036,
        supply_voltage=15.0,
        supply_resistance=0.25,
        command_delay=0.0115,
        zero_offset=-0.021,
        seed=64,
    ),
}
# A bench for any other servo: loads as shares of its stall torque, gains as multiples of the stated one.
LOAD_SHARES = (0.07, 0.16, 0.3)
GAIN_SHARES = (0.67, 1.33, 2.67)
_ARMS = ((0.5, 0.05), (3.0, 0.1), (8.0, 0.15))  # stall torque [N m] below which an arm is so long [m]
_LONGEST_ARM = 0.2  # [m]


def bench_for(servo: Servo) -> Bench:
    """A bench whose loads and gains suit a servo: `BENCHES` has its own for those of the stored logs."""
    if servo.name in BENCHES:
        return BENCHES[servo.name]
    stall = servo.force_limit()
    length = next((arm for most, arm in _ARMS if stall < most), _LONGEST_ARM)
    masses = [share * stall / (GRAVITY * length) for share in LOAD_SHARES]
    return Bench(
        loads=tuple((float(f"{mass:.3g}"), length) for mass in masses),
        gains=tuple(float(f"{share * servo.firmware_gain:.3g}") for share in GAIN_SHARES),
        arm_mass=float(f"{0.1 * masses[0]:.3g}"),
        supply_voltage=servo.supply_voltage,
        supply_resistance=float(f"{0.01 * servo.R:.3g}"),
        command_delay=0.0105,
        zero_offset=0.008,
    )


def bench_of(servo: Servo, command_delay: float | None, seed: int | None) -> Bench:
    """The standard bench of a servo, with another delay [s] or seed when given."""
    bench = bench_for(servo)
    if command_delay is not None:
        bench = replace(bench, command_delay=command_delay)
    return bench if seed is None else replace(bench, seed=seed)

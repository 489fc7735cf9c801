"""What a real servo does beyond the Coulomb-viscous law: the table of effects that a fit can switch on.

A friction law is a set of coefficients (`calibration.friction.COEFFICIENTS`); an effect is a set of
numbers of `ServoValues`. Each stands here with bounds, a start and what it is, so that a fit,
the choice between them and the report speak of the same things.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from frasa_sysid.calibration.friction import COEFFICIENTS

Bounds = Callable[[float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Number:
    """One number of a law or an effect.

    Attributes:
        field: of `ServoValues`.
        owner: `servo` or `bench`: what of it stays true when the servo sits in the robot.
        unit: SI unit as text.
        bounds: lowest, highest and starting value, of the nominal torque limit F [N m] and the
            largest goal speed in the logs [rad/s].
    """

    field: str
    owner: str
    unit: str
    bounds: Bounds


@dataclass(frozen=True)
class Effect:
    """One thing that a servo or its bench may do.

    Attributes:
        name: as on the command line.
        meaning: one sentence.
        numbers: what it adds to the fit.
    """

    name: str
    meaning: str
    numbers: tuple[Number, ...]


def _flat(low: float, high: float, start: float) -> Bounds:
    return lambda force, speed: (low, high, start)


def _torque(high: float, start: float) -> Bounds:
    return lambda force, speed: (0.0, high * force, start * force)


_LAW_NUMBERS: Mapping[str, Number] = MappingProxyType(
    {
        one.field: one
        for one in (
            Number("stribeck", "servo", "N m", _torque(0.06, 0.005)),
            Number("stribeck_speed", "servo", "rad/s", _flat(0.01, 5.0, 0.5)),
            Number("stribeck_exponent", "servo", "1", _flat(0.3, 4.0, 1.3)),
            Number("load_motor", "servo", "1", _flat(0.0, 0.6, 0.05)),
            Number("load_external", "servo", "1", _flat(0.0, 0.6, 0.05)),
            Number("load_motor_stribeck", "servo", "1", _flat(0.0, 1.0, 0.05)),
            Number("load_external_stribeck", "servo", "1", _flat(0.0, 1.0, 0.05)),
            Number("quad_motor", "servo", "1/(N m)", lambda force, speed: (0.0, 6.0 / force, 0.1 / force)),
            Number("quad_external", "servo", "1/(N m)", lambda force, speed: (0.0, 6.0 / force, 0.1 / force)),
        )
    }
)

EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {
        one.name: one
        for one in (
            Effect(
                "profile",
                "the firmware limits the speed of the goal",
                (Number("goal_speed", "servo", "rad/s", lambda force, speed: (0.1 * speed, 1.3 * speed, 0.6 * speed)),),
            ),
            Effect(
                "sag",
                "the supply gives way under load (resistance of battery and leads)",
                (Number("sag", "bench", "1", _flat(0.0, 0.8, 0.1)),),
            ),
            Effect(
                "supply",
                "the motor follows the measured changes of the supply",
                (),
            ),
            Effect(
                "punch",
                "the firmware adds to any error (gain that falls with the error)",
                (Number("punch", "servo", "rad", _flat(0.0, 0.02, 0.003)),),
            ),
            Effect(
                "backlash",
                "small errors have no effect",
                (Number("dead_zone", "servo", "rad", _flat(0.0, 0.03, 0.003)),),
            ),
            Effect(
                "collapse",
                "the firmware holds back at large errors (overload protection)",
                (
                    Number("collapse_at", "servo", "rad", _flat(0.02, 1.0, 0.15)),
                    Number("collapse_to", "servo", "1", _flat(0.1, 1.0, 0.9)),
                ),
            ),
            Effect(
                "loop",
                "the firmware acts on an angle that is older than its loop says",
                (Number("loop_lag", "servo", "s", _flat(0.0, 0.01, 0.0005)),),
            ),
            Effect(
                "drag",
                "damping that changes with the speed (grease that thins out)",
                (Number("drag", "servo", "N m s^2/rad^2", lambda force, speed: (-0.003 * force, 0.003 * force, 0.0)),),
            ),
            Effect("offsets", "every rig has its own zero", ()),
            Effect(
                "bias",
                "a constant torque",
                (Number("bias", "bench", "N m", lambda force, speed: (-force, force, 0.0)),),
            ),
        )
    }
)

# Those the fit tries by itself, if the logs can show them at all (see `possible`).
AUTOMATIC = ("profile", "sag", "supply", "punch", "backlash", "collapse", "loop", "drag", "offsets")


def law_numbers(law: str) -> tuple[list[Number], dict[str, str]]:
    """Numbers that a friction law adds to M1, and the fields that follow another one.

    Returns:
        The numbers, and a mapping from each following field to the one it equals.
    """
    names = [name.partition("=")[::2] for name in COEFFICIENTS[law]]
    ties = {name: leader for name, leader in names if leader}
    return [_LAW_NUMBERS[name] for name, leader in names if not leader], ties


FIELDS_OF_EFFECTS = {number.field: effect.name for effect in EFFECTS.values() for number in effect.numbers}

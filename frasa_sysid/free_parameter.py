"""The numbers that a bench fit may move, and how far."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from frasa_sysid.rig import BenchRun
from frasa_sysid.servo import Servo

# Bounds as multiples of the nominal value: wide enough for another unit, supply or gear ratio
# of the same type, narrow enough that the search starts in the right world.
SPAN = {
    "kp": (0.2, 4.0),
    "forcerange": (0.2, 3.0),
    "damping": (0.05, 4.0),
    "damping_off": (0.0, 20.0),
    "frictionloss": (0.0, 6.0),
    "armature": (0.05, 4.0),
}
UNIT = {
    "kp": "N m/rad",
    "forcerange": "N m",
    "damping": "N m s/rad",
    "damping_off": "N m s/rad",
    "frictionloss": "N m",
    "armature": "kg m^2",
    "delay": "s",
    "offset": "rad",
}
_LONGEST_OFFSET = 0.15  # [rad]


@dataclass(frozen=True)
class FreeParameter:
    """One number the fit may move.

    Attributes:
        name: `mx106.damping` or `bench.offset`.
        unit: SI unit as text.
        low, high: bounds.
        nominal: what it is compared with, and its value while it is not fitted.
        start: where the search starts.
        rig: load it belongs to, for the zero offset of one rig; else empty.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    start: float
    rig: str = ""

    @property
    def field(self) -> str:
        """Field of `ServoValues`: the part of the name behind the owner."""
        return "offset" if self.rig else self.name.partition(".")[2]


def rig_offsets(runs: Sequence[BenchRun]) -> list[FreeParameter]:
    """One for every rig but the first, beside the offset that all share."""
    rigs = sorted({run.rig for run in runs})[1:]
    bound = _LONGEST_OFFSET
    return [FreeParameter(f"bench.offset[{rig}]", "rad", -bound, bound, 0.0, 0.0, rig) for rig in rigs]


def free_number(
    known: Servo, field: str, nominal: Mapping[str, float], delay_range: tuple[float, float]
) -> FreeParameter:
    """A field of the servo as a number that may move, within its table's bounds or multiples of nominal.

    Args:
        known: the servo.
        field: of `ServoValues`.
        nominal: value of every field.
        delay_range: shortest and longest delay [s].
    """
    value, owner = nominal[field], known.name
    if field == "offset":
        return FreeParameter("bench.offset", "rad", -_LONGEST_OFFSET, _LONGEST_OFFSET, value, value)
    if field == "delay":
        return FreeParameter(f"{owner}.delay", "s", *delay_range, value, value)
    low, high = known.span(field) or (SPAN[field][0] * value, SPAN[field][1] * value)
    return FreeParameter(f"{owner}.{field}", UNIT[field], low, high, value, value)

"""What a fit of a whole robot has free, and what that makes of the numbers of the table.

A scale of a servo class multiplies several numbers of what it stands on (the frozen bench fit, or the
nominal model), one command delay is that of every servo, and the trunk is scaled and shifted. Such names
are kept for the record beside the numbers they make, which are those of `calibration.parameters`.

================================  =====================================================  ====
free                              makes                                                  unit
================================  =====================================================  ====
`<servo>.gain_scale`              kp, forcerange                                         1
`<servo>.damping_scale`           damping, damping_off                                   1
`<servo>.friction_scale`          frictionloss and all shares and extras of a law        1
`command.delay`                   `<servo>.delay` of every servo class                   s
`trunk.mass_scale`                `trunk.mass`                                           1
`trunk.com_shift_x` (`_y`, `_z`)  `trunk.com_x` (`_y`, `_z`), added                      m
================================  =====================================================  ====
"""

from collections.abc import Iterable, Mapping

from frasa_sysid.calibration import parameter
from frasa_sysid.errors import CalibrationError

SCALES: Mapping[str, tuple[str, ...]] = {
    "gain_scale": ("kp", "forcerange"),
    "damping_scale": ("damping", "damping_off"),
    "friction_scale": (
        "frictionloss",
        "stribeck",
        "load_motor",
        "load_external",
        "load_motor_stribeck",
        "load_external_stribeck",
        "quad_motor",
        "quad_external",
    ),
}
COMMAND_DELAY, MASS_SCALE = "command.delay", "trunk.mass_scale"
SHIFTS: Mapping[str, str] = {f"trunk.com_shift_{axis}": f"trunk.com_{axis}" for axis in "xyz"}


def for_the_record(name: str) -> bool:
    """Whether a name is of what was free only, and has no place in a model itself."""
    return name in (COMMAND_DELAY, MASS_SCALE, *SHIFTS) or name.rpartition(".")[2] in SCALES


def unit_of(name: str) -> str:
    """Unit of a number of a robot fit.

    Raises:
        CalibrationError: a robot fit has no such number.
    """
    if name in (COMMAND_DELAY, *SHIFTS):
        return "s" if name == COMMAND_DELAY else "m"
    if name == MASS_SCALE:
        return "1"
    owner, _, field = name.rpartition(".")
    if field in SCALES:
        parameter(f"{owner}.kp")  # the owner can be a servo class
        return "1"
    one = parameter(name)
    if one.owner == "robot":
        raise CalibrationError(f"{name} is no fitted number; it stands in 'from_logs'")
    return one.unit


def is_signed(name: str) -> bool:
    """Whether a number of a robot fit may be negative."""
    return name in SHIFTS or (not for_the_record(name) and parameter(name).signed)


def makes(name: str, known: Iterable[str]) -> list[str]:
    """The numbers of the table, among those known, that what was free makes; none for one of the table."""
    if name == COMMAND_DELAY:
        return [one for one in known if one.endswith(".delay") and not for_the_record(one)]
    if name == MASS_SCALE:
        return [one for one in known if one == "trunk.mass"]
    if name in SHIFTS:
        return [one for one in known if one == SHIFTS[name]]
    owner, _, field = name.rpartition(".")
    wanted = [f"{owner}.{one}" for one in SCALES.get(field, ())]
    present = set(known)
    return [one for one in wanted if one in present]


def made(name: str, value: float, base: float) -> float:
    """What a free number makes of a number it speaks of, `base`."""
    if name == COMMAND_DELAY:
        return value
    return base + value if name in SHIFTS else base * value

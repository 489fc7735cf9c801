"""A servo as a table: one small TOML file with its firmware law and where each number comes from.

    schema = "frasa.servo/1"
    name = "my_servo"                     # what logs and models call it
    source = "its data sheet"             # of all numbers that name no other

    [firmware]                            # duty = error_gain * P * error [rad], at most max_duty
    position_gain = 16                    # P at which the rest is stated, in the firmware's own unit
    error_gain = { value = 0.166, unit = "1/rad" }
    # or, as manuals say it: duty = P * error [ticks] / gain_divisor / full_duty
    # gain_divisor = 256                  # or gain_shift = 8
    # full_duty = 885
    max_duty = 0.97
    ticks_per_turn = 4096
    supply_compensated = false            # true: the firmware makes up for the supply

    [supply]
    voltage = { value = 12.0, unit = "V" }

    [motor]                               # at the output; or stall_torque and no_load_speed at that voltage
    kt = { value = 1.2, unit = "N m/A", low = 0.8, high = 1.8 }
    resistance = { value = 2.7, unit = "Ohm" }

    [joint]                               # optional: where the search starts; with low and high it stays between them
    armature = { value = 0.028, unit = "kg m^2" }
    viscous = { value = 0.06, unit = "N m s/rad" }
    coulomb = { value = 0.05, unit = "N m" }

    [simulated]                           # optional: a richer friction law, the truth of simulated benches
    law = "m4"

The servos that come with frasa are such files too, in the folder `servos` of this package.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import LAWS, Friction
from frasa_sysid.calibration.plain_toml import parse_toml
from frasa_sysid.errors import InputError
from frasa_sysid.readers.signal_entry import check_keys
from frasa_sysid.servo_quantity import Quantity, above_zero, quantity
from frasa_sysid.servo_type import Servo

SCHEMA = "frasa.servo/1"
TOP = ("schema", "name", "title", "source", "axis", "firmware", "supply", "motor", "joint", "simulated")
FIRMWARE = (
    "position_gain", "error_gain", "gain_divisor", "gain_shift", "full_duty", "max_duty", "ticks_per_turn",
    "supply_compensated",
)  # fmt: skip
MOTOR = ("kt", "resistance", "stall_torque", "no_load_speed")
JOINT = ("armature", "viscous", "coulomb")
SIMULATED = ("source", "law", "kt", "resistance", "armature", "viscous", *FRICTION_FIELDS)
GUESS = "a guess from the servos known here; the search goes a long way from it"
NAME = re.compile(r"[a-z][a-z0-9_]*")
RESERVED = ("sensor", "trunk", "robot", "bench", "command", "friction", "supply", "imu")  # owners of other parameters


@dataclass(frozen=True)
class ServoTable:
    """A table that was read and checked.

    Attributes:
        title: what people call it.
        servo: with the Coulomb-viscous numbers that fits start from.
        simulated: with the numbers of a richer law, where somebody published some.
        sources: of single numbers, by `section.key`.
        linear: an axis that slides: metres and newtons.
    """

    title: str
    servo: Servo
    simulated: Servo | None
    sources: Mapping[str, str]
    linear: bool = False


def parse_servo(name: str, content: bytes) -> ServoTable:
    """A table from the bytes of its file.

    Raises:
        InputError: not TOML, an unknown or missing key, a number without unit or that no servo has; in one line.
    """
    where = f"servo table {name}"
    try:
        table = parse_toml(content)
    except ValueError as error:
        raise InputError(f"{where} is not TOML: {error}") from error
    check_keys(where, table, TOP)
    if table.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema = {str(table.get('schema'))[:30]!r}, expected '{SCHEMA}'")
    said, source = _name(where, table), _text(where, table, "source", "where the numbers come from")
    linear = table.get("axis", "turning")
    if linear not in ("turning", "linear"):
        raise InputError(f"{where}: axis = {str(linear)[:20]!r}, expected 'turning' or 'linear'")
    reader = _Reader(where, table, linear == "linear")
    servo = reader.servo(said, source)
    title = _text(where, table, "title", "what people call it") if "title" in table else said
    return ServoTable(title, servo, reader.simulated(servo), reader.sources, reader.linear)


class _Reader:
    """Reads the sections of one table and keeps the sources of its numbers."""

    def __init__(self, where: str, table: Mapping[str, Any], linear: bool) -> None:
        self.where, self.table, self.linear = where, table, linear
        self.sources: dict[str, str] = {}

    def servo(self, name: str, source: str) -> Servo:
        firmware = self._section("firmware", FIRMWARE)
        supply = self._number("supply", self._section("supply", ("voltage",)), "voltage")
        ticks = above_zero(f"{self.where}: [firmware] ticks_per_turn", firmware.get("ticks_per_turn", 4096))
        kt, resistance = self._motor(supply.value)
        joint = self._section("joint", JOINT) if "joint" in self.table else {}
        guesses = _guesses(kt.value, resistance.value, supply.value)
        armature, viscous, coulomb = (
            self._number("joint", joint, one) if one in joint else self._guess(one, guesses[one]) for one in JOINT
        )
        found = {"kt": kt, "R": resistance, "armature": armature, "viscous": viscous, "coulomb": coulomb}
        compensated = firmware.get("supply_compensated", False)
        if not isinstance(compensated, bool):
            raise InputError(
                f"{self.where}: [firmware] supply_compensated = {str(compensated)[:20]!r}, expected true or false"
            )
        one = Servo(
            name,
            self._error_gain(firmware, ticks),
            above_zero(f"{self.where}: [firmware] max_duty", firmware.get("max_duty", 1.0)),
            kt.value,
            resistance.value,
            armature.value,
            Friction(viscous.value, coulomb.value),
            supply.value,
            above_zero(f"{self.where}: [firmware] position_gain", firmware.get("position_gain")),
            source,
            ticks,
            compensated,
            tuple((key, value.limits) for key, value in found.items() if value.limits is not None),
        )
        if wrong := one.problems():
            raise InputError(f"{self.where}: {wrong}")
        return one

    def simulated(self, one: Servo) -> Servo | None:
        if "simulated" not in self.table:
            return None
        section = self._section("simulated", SIMULATED)
        where = f"{self.where}: [simulated]"
        law = section.get("law")
        if law not in LAWS:
            raise InputError(f"{where} law = {str(law)[:20]!r}, expected one of {', '.join(LAWS)}")
        numbers = {}
        for name in ("kt", "resistance", "armature", "viscous", *FRICTION_FIELDS):
            value = section.get(name)
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e6:
                raise InputError(f"{where} {name} = {str(value)[:30]!r}, expected a number in SI units, 0 or more")
            numbers[name] = float(value)
        parts = {name: value for name, value in numbers.items() if name in ("viscous", *FRICTION_FIELDS)}
        friction = Friction(**{"viscous": one.friction.viscous, "coulomb": one.friction.coulomb, **parts})
        source = section.get("source", one.source)
        found = replace(
            one,
            kt=numbers.get("kt", one.kt),
            R=numbers.get("resistance", one.R),
            armature=numbers.get("armature", one.armature),
            friction=friction,
            source=str(source),
        )
        if wrong := found.problems():
            raise InputError(f"{where} {wrong}")
        return found

    def _section(self, name: str, keys: tuple[str, ...]) -> Mapping[str, Any]:
        section = self.table.get(name)
        if not isinstance(section, dict):
            raise InputError(f"{self.where}: no section [{name}]; expected one with {', '.join(keys)}")
        check_keys(f"{self.where}: [{name}]", section, keys)
        return section

    def _number(self, section: str, data: Mapping[str, Any], key: str) -> Quantity:
        where = f"{self.where}: [{section}] {key}"
        if key not in data:
            raise InputError(f"{where} is missing")
        found = quantity(where, key, data[key], self.linear)
        if found.source:
            self.sources[f"{section}.{key}"] = found.source
        return found

    def _guess(self, key: str, value: float) -> Quantity:
        self.sources[f"joint.{key}"] = GUESS
        return Quantity(value)

    def _motor(self, supply: float) -> tuple[Quantity, Quantity]:
        """Torque constant and resistance, as given or as stall torque and no-load speed at the supply mean them."""
        section = self._section("motor", MOTOR)
        given = [name for name in MOTOR if name in section]
        if given == ["kt", "resistance"]:
            return self._number("motor", section, "kt"), self._number("motor", section, "resistance")
        if given != ["stall_torque", "no_load_speed"]:
            raise InputError(
                f"{self.where}: [motor] has {', '.join(given) or 'nothing'}: expected kt and resistance, or "
                "stall_torque and no_load_speed"
            )
        stall, speed = (self._number("motor", section, name) for name in given)
        # kt w = V without load, kt V / R at stall.
        kt_limits = None if speed.limits is None else (supply / speed.limits[1], supply / speed.limits[0])
        kt = Quantity(supply / speed.value, kt_limits)
        r_limits = None
        if stall.limits is not None or kt_limits is not None:
            (low, high), (kt_low, kt_high) = stall.limits or (stall.value,) * 2, kt_limits or (kt.value,) * 2
            r_limits = kt_low * supply / high, kt_high * supply / low
        return kt, Quantity(kt.value * supply / stall.value, r_limits)

    def _error_gain(self, firmware: Mapping[str, Any], ticks: float) -> float:
        counted = [name for name in ("gain_divisor", "gain_shift", "full_duty") if name in firmware]
        where = f"{self.where}: [firmware]"
        if "error_gain" in firmware:
            if counted:
                raise InputError(f"{where} has error_gain and {', '.join(counted)}: expected one way to say it")
            return self._number("firmware", firmware, "error_gain").value
        if "full_duty" not in counted or len(counted) != 2:
            raise InputError(
                f"{where} has {', '.join(counted) or 'no error gain'}: expected error_gain, or full_duty with "
                "gain_divisor or gain_shift"
            )
        full = above_zero(f"{where} full_duty", firmware["full_duty"])
        if "gain_shift" in firmware:
            shift = firmware["gain_shift"]
            if isinstance(shift, bool) or not isinstance(shift, int) or not 0 <= shift <= 32:
                raise InputError(f"{where} gain_shift = {str(shift)[:20]!r}, expected a whole number of bits, 0 to 32")
            divisor = float(2**shift)
        else:
            divisor = above_zero(f"{where} gain_divisor", firmware["gain_divisor"])
        return ticks / (2.0 * math.pi) / divisor / full


def _guesses(kt: float, resistance: float, supply: float) -> dict[str, float]:
    """What servos of that stall torque and speed have about, for a search that goes a long way from there.

    Of MX-106, MX-64, XL330 and STS3215: Coulomb friction is 1.0 to 1.8 % of the stall torque, viscous friction
    2 to 11 % of the slope from stall to no load, the rotor takes 16 to 52 ms against that slope.
    """
    stall, slope = kt / resistance * supply, kt**2 / resistance
    return {"armature": 0.03 * slope, "viscous": 0.05 * slope, "coulomb": 0.013 * stall}


def _name(where: str, table: Mapping[str, Any]) -> str:
    name = table.get("name")
    if not isinstance(name, str) or not NAME.fullmatch(name) or name in RESERVED:
        raise InputError(
            f"{where}: name = {str(name)[:30]!r}, expected lower-case letters, digits and underscores"
            + (", and none of " + ", ".join(RESERVED) if name in RESERVED else "")
        )
    return name


def _text(where: str, table: Mapping[str, Any], key: str, meaning: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or value.strip() in ("", "..."):
        raise InputError(f"{where}: {key} = {str(value)[:30]!r}, expected text: {meaning}")
    return value

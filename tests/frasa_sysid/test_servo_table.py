import tomllib
from dataclasses import replace
from math import pi

import pytest

from frasa_sysid.errors import InputError, UsageError
from frasa_sysid.servo import NOMINAL, TABLES, find_table
from frasa_sysid.servo_table import parse_servo
from frasa_sysid.servo_text import new_table

DATASHEET = """
schema = "frasa.servo/1"
name = "xl430"
source = "ROBOTIS e-Manual XL430-W250"
[firmware]
position_gain = 800
gain_divisor = 128
full_duty = 885
ticks_per_turn = 4096
[supply]
voltage = { value = 12.0, unit = "V" }
[motor]
stall_torque = { value = 1.5, unit = "N m", low = 1.0, high = 2.0 }
no_load_speed = { value = 61, unit = "rpm" }
"""


def parsed(text: str = DATASHEET):
    return parse_servo("t.toml", text.encode())


def test_a_data_sheet_is_enough():
    """Stall torque, speed, supply and the firmware's counts make a servo; the rest are guesses that say so."""
    table = parsed()
    one = table.servo
    assert one.supply_voltage / one.kt == pytest.approx(61 * 2 * pi / 60)
    assert one.force_limit() == pytest.approx(1.5)
    assert one.error_gain == pytest.approx(4096 / (2 * pi) / 128 / 885)
    assert {"joint.armature", "joint.viscous", "joint.coulomb"} <= table.sources.keys()
    assert all("guess" in table.sources[f"joint.{name}"] for name in ("armature", "viscous", "coulomb"))
    shifted = parsed(DATASHEET.replace("gain_divisor = 128", "gain_shift = 7")).servo
    assert shifted.error_gain == one.error_gain


@pytest.mark.parametrize(
    ("unit", "value", "newton_metres"),
    [("N m", 2.0, 2.0), ("mN m", 2000, 2.0), ("kg cm", 10, 0.980665), ("oz in", 100, 0.70615518)],
)
def test_units_of_torque(unit, value, newton_metres):
    """Data sheets give torque in their own units; the factor is the unit's."""
    text = DATASHEET.replace('value = 1.5, unit = "N m", low = 1.0, high = 2.0', f'value = {value}, unit = "{unit}"')
    assert parsed(text).servo.force_limit() == pytest.approx(newton_metres)


def test_speed_as_hobby_servos_have_it():
    """0.16 s for 60 degrees is pi / 3 / 0.16 rad/s; bounds in a falling unit come out in order."""
    text = DATASHEET.replace('value = 61, unit = "rpm"', 'value = 0.16, unit = "s/60deg", low = 0.15, high = 0.2')
    one = parsed(text).servo
    assert 12.0 / one.kt == pytest.approx(pi / 3 / 0.16)
    low, high = dict(one.limits)["kt"]
    assert (low, high) == pytest.approx((12.0 * 0.15 / (pi / 3), 12.0 * 0.2 / (pi / 3)))


def test_bounds_hold_whatever_the_table_allows():
    """The bounds of gain, force limit and damping are those that every kt and R within the table's bounds give."""
    one = parsed().servo
    for stall in (1.0, 1.4, 2.0):
        other = replace(one, R=one.kt * 12.0 / stall)
        for name, value in (("kp", other.kp()), ("forcerange", other.force_limit()), ("damping", other.damping())):
            low, high = one.span(name)
            assert low * (1 - 1e-9) <= value <= high * (1 + 1e-9)
    assert one.span("forcerange") == pytest.approx((1.0, 2.0))
    assert one.span("armature") is None  # nobody knows bounds of it
    assert NOMINAL["mx106"].span("kp") is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "xl430"', 'name = "XL-430"', "name = 'XL-430', expected lower-case letters"),
        ('name = "xl430"', 'name = "bench"', "none of sensor, trunk"),
        ('source = "ROBOTIS e-Manual XL430-W250"', 'source = "..."', "source = '...', expected text: where"),
        ("frasa.servo/1", "frasa.servo/9", "schema = 'frasa.servo/9', expected 'frasa.servo/1'"),
        ("position_gain", "positon_gain", "unknown key 'positon_gain'; did you mean 'position_gain'?"),
        ("position_gain = 800", "position_gain = 0", r"\[firmware\] position_gain = 0, expected a number above 0"),
        ("position_gain = 800", "", "position_gain is missing"),
        ("gain_divisor = 128", "gain_divisor = -128", "gain_divisor = -128, expected a number above 0"),
        ("gain_divisor = 128", "gain_shift = 40", "gain_shift = '40', expected a whole number of bits"),
        ("gain_divisor = 128", "", "has full_duty: expected error_gain, or full_duty with"),
        ("full_duty = 885", 'error_gain = { value = 0.1, unit = "1/rad" }', "expected one way to say it"),
        ("full_duty = 885", "full_duty = 885\nmax_duty = 1.2", "max_duty = 1.2, expected a share of the full PWM"),
        ("full_duty = 885", "full_duty = 885\nsupply_compensated = 1", "supply_compensated = '1', expected true"),
        ('{ value = 12.0, unit = "V" }', "12.0", "voltage = 12 has no unit: write { value = ..."),
        ('{ value = 12.0, unit = "V" }', "{ value = 12.0 }", "voltage has no unit: expected one of V, mV"),
        ('value = 12.0, unit = "V"', 'value = 12.0, unit = "kV"', "unit = 'kV', expected one of V, mV"),
        ('value = 12.0, unit = "V"', 'value = 12.0, unit = {}', "unit = '{}', expected one of V, mV"),
        ('value = 12.0, unit = "V"', 'value = -12.0, unit = "V"', "value = -12, expected a number above 0"),
        ('value = 12.0, unit = "V"', 'value = nan, unit = "V"', "value = nan, expected a number above 0"),
        ('value = 12.0, unit = "V"', 'value = 1e308, unit = "V"', r"value = 1e\+308, expected a number from"),
        ("position_gain = 800", "position_gain = inf", "position_gain = inf, expected a number above 0"),
        ("position_gain = 800", "position_gain = 1e-300", "position_gain = 1e-300, expected a number from 1e-12"),
        ('value = 61, unit = "rpm"', 'value = "61", unit = "rpm"', "value = '61', expected a number"),
        ("low = 1.0, high = 2.0", "low = 1.0", "has 'low' alone: expected both low and high"),
        ("low = 1.0, high = 2.0", "low = 2.0, high = 1.0", "low = 2, value = 1.5, high = 1: expected low below high"),
        ("low = 1.0, high = 2.0", "low = 1.6, high = 2.0", "the value between them"),
        ("no_load_speed", "resistance", r"\[motor\] has resistance, stall_torque: expected kt and resistance, or"),
        ("[supply]", "[power]", "unknown key 'power'; known are"),
        ('voltage = { value = 12.0, unit = "V" }', "", r"\[supply\] voltage is missing"),
        ("[motor]", '[simulated]\nlaw = "m9"\n[motor]', "law = 'm9', expected one of m1"),
        ("[motor]", '[simulated]\nlaw = "m2"\nstribeck = -1\n[motor]', "stribeck = '-1', expected a number in SI"),
        ("[motor]", "[motor", "is not TOML"),
    ],
)  # fmt: skip
def test_a_bad_table_is_one_line(old, new, message):
    """What is wrong, where, and what is expected: one line that names the file."""
    assert old in DATASHEET
    with pytest.raises(InputError, match=message) as caught:
        parsed(DATASHEET.replace(old, new, 1))
    assert "\n" not in str(caught.value)
    assert "t.toml" in str(caught.value)


def test_tables_that_come_with_frasa_are_as_any_other():
    """Each is read by the same reader, is filed under its name, and names its source."""
    assert {"mx106", "mx64", "xl330", "sts3215", "sts3250", "miuzei", "emps"} == TABLES.keys()
    for name, table in TABLES.items():
        assert table.servo.name == name
        assert table.servo.source
        assert table.linear == (name == "emps")


def test_where_a_servo_is_looked_for(tmp_path):
    """A file by its path; a name beside the model first, then among those of frasa; else the known ones are listed."""
    model = tmp_path / "nominal.xml"
    assert find_table("mx64", model) is TABLES["mx64"]
    (tmp_path / "servos").mkdir()
    own = tmp_path / "servos" / "mx64.toml"
    own.write_text(DATASHEET.replace("xl430", "mx64"))
    assert find_table("mx64", model).servo.force_limit() == pytest.approx(1.5)
    assert find_table(str(own)).servo == find_table("mx64", model).servo
    own.write_text(DATASHEET)
    with pytest.raises(InputError, match="name = 'xl430', expected that of the file"):
        find_table("mx64", model)
    with pytest.raises(UsageError, match=r"known are emps, .*frasa-sysid servos --new"):
        find_table("mx28", model)
    with pytest.raises(InputError, match=r"no servo table at .*nowhere\.toml"):
        find_table(str(tmp_path / "nowhere.toml"))


def test_an_empty_table_asks_for_its_numbers():
    """The template is TOML, and refuses to be used before every number in it is filled in."""
    text = new_table("mx28")
    assert tomllib.loads(text)["name"] == "mx28"
    wanted = [
        ('source = "..."', 'source = "its data sheet"', "source = '...'"),
        ("voltage = { value = 0", "voltage = { value = 12", "voltage: value = 0"),
        ("stall_torque = { value = 0", "stall_torque = { value = 2.5", "stall_torque: value = 0"),
        ("no_load_speed = { value = 0", "no_load_speed = { value = 7", "no_load_speed: value = 0"),
        ("error_gain = { value = 0", "error_gain = { value = 0.158", "error_gain: value = 0"),
        ("position_gain = 0", "position_gain = 32", "position_gain = 0"),
    ]
    for old, new, message in wanted:
        with pytest.raises(InputError, match=message):
            parsed(text)
        text = text.replace(old, new, 1)
    assert parsed(text).servo.force_limit() == pytest.approx(2.5)
    with pytest.raises(UsageError, match="--new MX 28"):
        new_table("MX 28")


def test_a_table_like_another():
    """It starts from that one's numbers under its own name, and claims nobody's identified friction as its truth."""
    table = parsed(new_table("mx28", like="mx106"))
    assert table.servo == replace(NOMINAL["mx106"], name="mx28")
    assert table.simulated is None
    with pytest.raises(UsageError, match="--like mx12: known are emps"):
        new_table("mx28", like="mx12")

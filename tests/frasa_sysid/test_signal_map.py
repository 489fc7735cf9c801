import numpy as np
import pytest

from frasa_sysid.errors import InputError
from frasa_sysid.readers.signal_map import builtin_maps, load_map, parse_map
from frasa_sysid.readers.units import SIGNALS, UNITS, units_of

TIME = '[time]\ncolumn = "t"\nunit = "ms"\n'


def entry(**keys):
    lines = [f"{key} = {value}" for key, value in ({"column": '"q"', "signal": '"position"'} | keys).items()]
    return "\n".join(["[[signal]]", *(line for line in lines if not line.endswith("None"))]) + "\n"


def parse(*parts):
    return parse_map("m.toml", "".join(parts).encode(), builtin=False)


@pytest.mark.parametrize("name", builtin_maps())
def test_maps_that_come_with_frasa(name):
    """Each is read without a fault, and takes no effort for a torque."""
    mapping = load_map(name)
    assert mapping.builtin
    assert {"position", "goal"} <= {one.signal for one in mapping.of("topic")}
    assert {one.unit for one in mapping.entries if one.signal == "effort"} == {"raw"}
    assert not any(one.signal == "torque" for one in mapping.entries)


@pytest.mark.parametrize(
    ("keys", "value", "si"),
    [
        ({"unit": '"deg"'}, 180.0, np.pi),
        ({"unit": '"deg"', "scale": -1.0}, 90.0, -np.pi / 2),
        ({"unit": '"turn"'}, 0.5, np.pi),
        ({"unit": '"tick"', "ticks_per_turn": 4096, "zero": 2048}, 3072, np.pi / 2),
        ({"unit": '"rpm"', "signal": '"velocity"', "scale": 0.229}, 100, 0.229 * 100 * 2 * np.pi / 60),
        ({"unit": '"tick/s"', "signal": '"velocity"', "ticks_per_turn": 4096}, 4096, 2 * np.pi),
        ({"unit": '"mA"', "signal": '"current"', "scale": 2.69}, 100, 0.269),
        ({"unit": '"%"', "signal": '"duty"'}, 50, 0.5),
        ({"unit": '"mV"', "signal": '"supply_voltage"'}, 12000, 12.0),
    ],
)
def test_units(keys, value, si):
    """A reading becomes SI by the unit that was declared, with its zero and scale."""
    assert parse(entry(**keys)).entries[0].convert(np.array([value]))[0] == pytest.approx(si)


def test_every_known_signal_has_a_unit():
    """What a signal may be in can be declared, and becomes that."""
    for signal, known in SIGNALS.items():
        assert {UNITS[unit][0] for unit in units_of(signal)} == set(known)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x = ", "is not TOML"),
        ("", "expected entries '[[signal]]'"),
        ("signal = 3", "found something else"),
        (entry(), "[[signal]] 1: no unit of 'position'; declare one of rad, deg, turn, tick, m, mm"),
        (entry(unit='"degree"'), "unit = 'degree' of 'position' is not known; expected one of rad, deg"),
        (entry(unit='"V"'), "'position' in V, expected rad, deg"),
        (entry(unit='"tick"'), "needs ticks_per_turn"),
        (entry(unit='"tick"', ticks_per_turn=4096), "needs zero"),
        (entry(unit='"rad"', ticks_per_turn=4096), "ticks_per_turn belongs to unit"),
        (entry(unit='"rad"', scale=0), "scale = 0"),
        (entry(unit='"rad"', scale='"x"'), "scale = 'x', expected a number"),
        (entry(unit='"rad"', scale="true"), "expected a number"),
        (entry(unit='"rad"', colum='"x"'), "unknown key 'colum'; did you mean 'column'?"),
        (entry(unit='"rad"', column=None), "either a 'topic' (messages) or a 'column'"),
        (entry(unit='"rad"', topic='"/a"'), "either a 'topic' (messages) or a 'column'"),
        (entry(unit='"rad"', topic='"/a"', column=None), "no 'field' of /a"),
        (entry(unit='"rad"', field='"a"'), "'field' belongs to a 'topic'"),
        (entry(unit='"rad"', column='"*_*"'), "more than one *"),
        (entry(unit='"rad"', signal='"a@b"'), "expected a name"),
        (entry(unit='"rad"', joint='"a"', joints='["b"]'), "found both"),
        (entry(unit='"rad"', joints='["a", "a"]'), "names one twice"),
        (entry(unit='"rad"', joints='"name"'), "joints = 'name', expected names"),
        (entry(unit='"1"', signal='"orientation"', joints='["x", "y"]'), "has the axes w, x, y, z"),
        (entry(unit='"N m"', signal='"effort"'), "an effort in N m is the signal 'torque'"),
        (entry(unit='"mA"', signal='"effort"'), "an effort in mA is the signal 'current'"),
        (entry(unit='"raw"', signal='"torque"'), "'torque' in raw, expected N m, mN m"),
        ('[time]\ncolumn = "t"\n' + entry(unit='"rad"'), "[time]: no unit of 't'; declare s, ms, us, ns or iso"),
        ('[time]\ncolumn = "t"\nunit = "h"\n' + entry(unit='"rad"'), "unit = 'h', expected one of s, ms, us, ns, iso"),
        ("[time]\nrate = 0\n" + entry(unit='"rad"'), "rate = 0"),
        ("[time]\n" + entry(unit='"rad"'), "expected a 'column' (or 'rate')"),
        (entry(unit='"rad"') + '[joints]\na = "k"\nb = "k"\n', "would become 'k'"),
        (entry(unit='"rad"') + "[joints]\na = 3\n", "expected lines such as"),
    ],
)
def test_maps_that_cannot_be_used(text, complaint):
    """One line says where, what was found and what was expected."""
    with pytest.raises(InputError) as error:
        parse(text)
    assert complaint in str(error.value)
    assert str(error.value).startswith("map m.toml")
    assert "\n" not in str(error.value) or "is not TOML" in complaint


def test_unknown_name():
    """A name that is neither a file nor a map lists those that there are."""
    with pytest.raises(InputError, match="built in are robocup, robotis, ros2_control"):
        load_map("ros2-control")


def test_star_stands_for_the_joint():
    """One * in a column is the joint; the whole name has to match."""
    found = parse(TIME, entry(column='"q_*"', unit='"rad"')).entries[0]
    assert [found.match(name) for name in ("q_left.knee", "q_", "xq_a", "q_a_b")] == ["left.knee", None, None, "a_b"]

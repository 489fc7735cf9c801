"""Fit files by hand: what is read from both schemas, and that nothing wrong in them gets through."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from frasa_sysid.calibration.friction import Friction
from frasa_sysid.errors import CalibrationError, InputError
from frasa_sysid.fit_json import SCHEMA, SCHEMA_M1
from frasa_sysid.published_as import as_m1, price
from frasa_sysid.stored_fit import load, model_parameters

M4 = Friction(0.12, 0.05, 0.08, 0.06, 0.06, 0.1, 0.1, stribeck_speed=0.4, stribeck_exponent=1.2)
VALUES = {
    "mx106.kp": (24.9, "N m/rad"),
    "mx106.forcerange": (7.77, "N m"),
    "mx106.damping": (1.1, "N m s/rad"),
    "mx106.damping_off": (0.12, "N m s/rad"),
    "mx106.frictionloss": (0.05, "N m"),
    "mx106.armature": (0.03, "kg m^2"),
    "mx106.stribeck": (0.08, "N m"),
    "mx106.load_motor": (0.06, "1"),
    "mx106.load_motor_stribeck": (0.1, "1"),
    "mx106.stribeck_speed": (0.4, "rad/s"),
    "mx106.stribeck_exponent": (1.2, "1"),
    "mx106.goal_speed": (5.0, "rad/s"),
    "bench.offset": (-0.01, "rad"),
    "bench.offset[0.5 kg, 0.15 m]": (0.02, "rad"),
    "bench.sag": (0.1, "1"),
    "bench.bias": (-0.1, "N m"),
}
STAND_IN = {"kp": 24.9, "damping": 1.3, "frictionloss": 0.21, "armature": 0.031, "forcerange": 7.77, "delay": 0.002}


def m4_file():
    """A fit with law M4, as the fitter writes it."""
    names = list(VALUES)
    return {
        "schema": SCHEMA,
        "servo": "mx106",
        "friction": "m4",
        "origin": "real",
        "stated_at": {"supply_voltage": 15.0, "firmware_gain": 12.0},
        "parameters": {
            name: {
                "value": value,
                "unit": unit,
                "low": value - 0.01,
                "high": value + 0.01,
                "spread_low": value - 0.02,
                "spread_high": value,
                "verdict": "identified",
                "nominal": 1.0,
                "record_next": "",
            }
            for name, (value, unit) in VALUES.items()
        },
        "law": asdict(M4),
        "as_m1": {"mujoco": dict(STAND_IN), "penalty_rad": 0.004, "loads": [0.7, 2.5], "speed": 6.0},
        "not_in_model": ["profile: the firmware limits the speed of the goal"],
        "from_logs": {"supply_voltage": [13.9, 14.2], "delay_jitter": [-0.0004, 0.0011]},
        "correlation": {"names": names, "matrix": (0.5 * np.ones((16, 16)) + 0.5 * np.eye(16)).tolist()},
        "inputs": {"a.mcap": "0" * 64},
    }


def m1_file():
    """The same fit as the first schema would have held it."""
    data = m4_file()
    known = ("kp", "forcerange", "damping", "damping_off", "frictionloss", "armature", "offset")
    for key in ("law", "as_m1", "not_in_model", "from_logs"):
        del data[key]
    parameters = {name: one for name, one in data["parameters"].items() if name.partition(".")[2] in known}
    return data | {
        "schema": SCHEMA_M1,
        "friction": "m1",
        "parameters": parameters,
        "correlation": {"names": [], "matrix": []},
    }


def stored(folder, data):
    path = folder / "fit.json"
    path.write_text(json.dumps(data))
    return load(path)


def test_a_law_is_read_whole(tmp_path):
    """Law, stand-in, effects and what the logs say are read; bench and firmware have no place in a model."""
    one = stored(tmp_path, m4_file())
    assert (one.friction, one.law, one.model_law) == ("m4", M4, M4)
    assert one.stand_in.values == STAND_IN
    assert (one.stand_in.penalty_rad, one.stand_in.loads, one.stand_in.speed) == (0.004, (0.7, 2.5), 6.0)
    assert one.not_in_model == ("profile: the firmware limits the speed of the goal",)
    assert (one.supply_seen, one.delay_jitter) == ((13.9, 14.2), (-0.0004, 0.0011))
    outside = {name for name in VALUES if name.startswith("bench.")} | {"mx106.goal_speed"}
    assert set(model_parameters(one)) == set(VALUES) - outside


def test_the_first_schema_is_coulomb_viscous(tmp_path):
    """A file of the first schema reads as M1 without a law; its unpowered damping has no place in a model."""
    one = stored(tmp_path, m1_file())
    assert (one.friction, one.law, one.model_law, one.stand_in, one.supply_seen) == ("m1", None, None, None, None)
    assert "mx106.damping_off" in one.parameters
    assert "mx106.damping_off" not in model_parameters(one)
    assert as_m1(one) is one
    assert price(one) == ""


def test_an_m1_fit_of_the_second_schema(tmp_path):
    """M1 tells its law too, but a model does not carry it."""
    law = asdict(Friction(0.12, 0.05))
    one = stored(tmp_path, m1_file() | {"schema": SCHEMA, "law": law})
    assert one.law == Friction(0.12, 0.05)
    assert one.model_law is None


def test_the_stand_in_takes_the_place_of_the_law(tmp_path):
    """Values are the stand-in's, intervals keep their widths, what was not fitted tells none; correlation follows."""
    one = as_m1(stored(tmp_path, m4_file()))
    assert (one.friction, one.model_law, one.stands_for) == ("m1", None, "m4")
    assert {name.partition(".")[2]: p["value"] for name, p in one.parameters.items()} == STAND_IN
    loss = one.parameters["mx106.frictionloss"]
    assert [loss[key] for key in ("low", "high", "spread_low", "spread_high")] == pytest.approx([0.2, 0.22, 0.19, 0.21])
    assert one.parameters["mx106.delay"]["verdict"] == "not excited"
    assert one.correlated == tuple(f"mx106.{f}" for f in ("kp", "forcerange", "damping", "frictionloss", "armature"))
    assert one.correlation.shape == (5, 5)
    assert "m4" in price(one)
    assert "4.00 mrad" in price(one)


def test_a_law_without_a_stand_in(tmp_path):
    """Asking for what the file does not hold is an error that says what to do."""
    data = m4_file()
    del data["as_m1"]
    with pytest.raises(CalibrationError, match="fit again"):
        as_m1(stored(tmp_path, data))


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("schema",), "frasa.fit/3"),
        (("schema",), ["frasa.fit/2"]),
        (("servo",), 7),
        (("servo",), "mx64"),
        (("servo",), "mx106\n"),
        (("origin",), "x" * 501),
        (("friction",), None),
        (("friction",), "m7"),
        (("friction",), ["m4"]),
        (("friction",), "m1"),
        (("friction",), "m2"),
        (("friction",), "m3"),
        (("law",), None),
        (("law", "coulomb"), None),
        (("law", "coulomb"), 0.06),
        (("law", "viscous"), 0.11),
        (("law", "load_external"), 0.07),
        (("law", "quad_motor"), 0.1),
        (("law", "stribeck"), NAN),
        (("law", "stribeck"), -0.08),
        (("law", "stribeck"), 10**400),
        (("law", "stribeck_speed"), 0.0),
        (("as_m1", "mujoco"), None),
        (("as_m1", "mujoco", "damping"), None),
        (("as_m1", "mujoco", "damping"), NAN),
        (("as_m1", "mujoco", "damping"), -1.0),
        (("as_m1", "penalty_rad"), INF),
        (("as_m1", "loads"), None),
        (("as_m1", "loads"), [2.0, 1.0]),
        (("as_m1", "loads"), [1.0, 2.0, 3.0]),
        (("as_m1", "loads"), [NAN, 1.0]),
        (("as_m1", "speed"), "fast"),
        (("not_in_model",), 3),
        (("not_in_model",), [["profile"]]),
        (("not_in_model",), ["a\x00b"]),
        (("from_logs", "supply_voltage"), [-0.1, 12.0]),
        (("from_logs", "supply_voltage"), [13.0, 12.0]),
        (("from_logs", "supply_voltage"), [12.0, INF]),
        (("from_logs", "supply_voltage"), "12"),
        (("from_logs", "delay_jitter"), [NAN, 0.0]),
        (("parameters", "mx106.stribeck", "unit"), "1"),
        (("parameters", "mx106.stribeck", "value"), -0.5),
        (("parameters", "mx106.stribeck", "low"), 0.09),
        (("parameters", "mx106.stribeck", "high"), INF),
        (("parameters", "mx106.stribeck", "verdict"), 1),
        (("parameters", "mx106.goal_speed", "unit"), "rad"),
        (("parameters", "bench.sag", "value"), -0.1),
        (("parameters", "mx106.load_external"), dict(m4_file()["parameters"]["mx106.load_motor"])),
        (("parameters", "mx106.sag"), dict(m4_file()["parameters"]["bench.sag"])),
        (("parameters", "bench.kp"), dict(m4_file()["parameters"]["mx106.kp"])),
        (("parameters", "supply_voltage"), dict(m4_file()["parameters"]["mx106.kp"])),
        (("stated_at", "supply_voltage"), -15.0),
        (("correlation", "names"), ["nobody.kp"] * 16),
        (("correlation", "matrix"), [[1.0]]),
        (("inputs",), None),
    ],
)
def test_a_wrong_field_is_one_error(tmp_path, keys, value):
    """Every field that is missing, of the wrong kind, not finite or against the others is an input error."""
    data = m4_file()
    place = data
    for key in keys[:-1]:
        place = place[key]
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    with pytest.raises(InputError):
        stored(tmp_path, data)


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000, b'{"schema": "frasa.fit/2"}'])
def test_what_is_no_fit_file(tmp_path, content):
    """Bytes that are no fit file, and a missing file, are input errors."""
    path = tmp_path / "fit.json"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load(path)
    with pytest.raises(InputError, match="no fit at"):
        load(tmp_path / "none.json")


def test_more_parameters_than_any_fit_has(tmp_path):
    """A file with thousands of names is refused before anything is done with them."""
    data = m4_file()
    offset = data["parameters"]["bench.offset"]
    data["parameters"] |= {f"bench.offset[{i}]": offset for i in range(1000)}
    with pytest.raises(InputError, match="more than 1000"):
        stored(tmp_path, data)

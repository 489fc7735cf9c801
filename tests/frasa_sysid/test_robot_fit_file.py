"""Fits of a whole robot as files: what is written is read back, and nothing wrong in them gets through."""

import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid import stored_fit
from frasa_sysid.errors import InputError
from frasa_sysid.robot_fit_record import RobotEstimate, with_products
from frasa_sysid.robot_numbers import SCALES, unit_of
from frasa_sysid.stored_robot_fit import load

NAN, INF = float("nan"), float("inf")
ONE = {"value": 1.0, "low": 1.0, "high": 1.0, "verdict": "identified", "nominal": 1.0}


def test_what_is_saved_is_read_back(robot_record, tmp_path):
    """Every number, its unit, and what the logs say come back as they were; the spread joins all that is told."""
    record = robot_record(frozen=("a" * 64,), more={"misfit": {"fitted": 1.5}, "seed": 3})
    path = tmp_path / "robot.json"
    record.save(path)
    stored = load(path)
    assert json.loads(path.read_text())["seed"] == 3
    for one in record.estimates:
        found = stored.parameters[one.name]
        assert (found["value"], found["low"], found["high"]) == (one.value, one.low, one.high)
        assert (found["nominal"], found["verdict"], found["unit"]) == (one.nominal, one.verdict, unit_of(one.name))
        bounds = (one.low, one.high, *one.spread, *one.bootstrap)
        assert (found["spread_low"], found["spread_high"]) == (min(bounds), max(bounds))
    assert (stored.frozen, stored.base, stored.model) == (("a" * 64,), "fixed", record.model)
    assert (stored.supply_seen, stored.delay_jitter) == ((13.9, 16.1), (-0.0003, 0.0005))
    np.testing.assert_array_equal(stored.correlation, record.correlation)
    assert set(stored.parameters) - set(stored.published) == {f"mx106.{one}" for one in SCALES}


def test_saving_twice_gives_the_same_bytes(robot_record, tmp_path):
    """A file says what was found and nothing of when."""
    for name in ("a.json", "b.json"):
        robot_record().save(tmp_path / name)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_what_was_free_makes_numbers_of_the_table():
    """Scales multiply, one command delay is every servo's, the trunk is scaled and shifted; widths go with them."""
    base = {"mx106.kp": 20.0, "mx106.forcerange": 8.0, "mx64.kp": 12.0, "mx106.delay": 0.0, "mx64.delay": 0.01,
            "trunk.mass": 3.0, "trunk.com_x": 0.01}  # fmt: skip
    scale = RobotEstimate("mx106.gain_scale", 0.9, 0.8, 1.1, "known roughly", 1.0, (0.7, 1.2))
    first, kp, limit = with_products([scale], base)
    assert first is scale
    assert (kp.name, kp.value, kp.low, kp.high, kp.nominal) == ("mx106.kp", 18.0, 16.0, 22.0, 20.0)
    assert (kp.spread, kp.bootstrap, kp.verdict) == ((14.0, 24.0), None, "known roughly")
    assert (limit.name, limit.value) == ("mx106.forcerange", 7.2)

    def of(name, value):
        return {one.name: one.value for one in with_products([RobotEstimate(name, value, 0, 1, "", 0)], base)[1:]}

    assert of("command.delay", 0.004) == {"mx106.delay": 0.004, "mx64.delay": 0.004}
    assert of("trunk.mass_scale", 1.1) == {"trunk.mass": pytest.approx(3.3)}
    assert of("trunk.com_shift_x", -0.004) == {"trunk.com_x": pytest.approx(0.006)}
    assert of("trunk.com_shift_y", -0.004) == of("left_knee.zero", 0.1) == of("sensor.gyro_delay", 0.1) == {}


def test_a_record_that_could_not_be_published_is_not_saved(robot_record, tmp_path):
    """The writer checks what the reader will check, and leaves an older file as it was."""
    path = tmp_path / "robot.json"
    path.write_text("older")
    record = robot_record()
    bad = [
        RobotEstimate("left_knee.zero", NAN, 0.0, 0.0, "identified", 0.0),
        RobotEstimate("left_knee.zero", 0.1, 0.2, 0.3, "identified", 0.0),
        RobotEstimate("supply_voltage", 15.0, 14.0, 16.0, "identified", 15.0),
    ]
    for one in bad:
        with pytest.raises(InputError):
            replace(record, estimates=(*record.estimates, one)).save(path)
    assert path.read_text() == "older"


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("schema",), "frasa.fit/1"),
        (("schema",), 2),
        (("kind",), "servo"),
        (("kind",), None),
        (("servo",), "mx106"),
        (("base",), "hanging"),
        (("base",), None),
        (("origin",), "x" * 501),
        (("origin",), "a\nb"),
        (("model",), None),
        (("model",), "sigmaban"),
        (("model", "fingerprint"), None),
        (("model", "fingerprint"), 7),
        (("stated_at", "supply_voltage"), None),
        (("stated_at", "supply_voltage"), 0.0),
        (("stated_at", "firmware_gain"), NAN),
        (("frozen",), None),
        (("frozen",), ["mx106.json"]),
        (("frozen",), [3]),
        (("inputs",), None),
        (("inputs",), {"a.mcap": 3}),
        (("parameters",), {}),
        (("parameters",), []),
        (("parameters", "left_knee.zero"), None),
        (("parameters", "left_knee.zero", "value"), None),
        (("parameters", "left_knee.zero", "value"), NAN),
        (("parameters", "left_knee.zero", "value"), "little"),
        (("parameters", "left_knee.zero", "value"), 10**400),
        (("parameters", "left_knee.zero", "low"), -INF),
        (("parameters", "left_knee.zero", "low"), 0.1),
        (("parameters", "left_knee.zero", "high"), 1.5),
        (("parameters", "left_knee.zero", "unit"), "deg"),
        (("parameters", "left_knee.zero", "verdict"), None),
        (("parameters", "left_knee.zero", "nominal"), NAN),
        (("parameters", "sensor.gyro_delay", "unit"), "ms"),
        (("parameters", "sensor.gyro_delay", "value"), -0.001),
        (("parameters", "sensor.gyro_delay", "high"), 30.0),
        (("parameters", "trunk.mass", "value"), 0.0),
        (("parameters", "trunk.com_x", "high"), 2.0),
        (("parameters", "mx106.kp", "value"), -1.0),
        (("parameters", "mx106.gain_scale", "unit"), "N m/rad"),
        (("parameters", "mx106.gain_scale", "value"), -0.9),
        (("parameters", "sensor.gain_scale"), {**ONE, "unit": "1"}),
        (("parameters", "trunk.colour"), {**ONE, "unit": "kg"}),
        (("parameters", "supply_voltage"), {**ONE, "unit": "V"}),
        (("spread",), [1, 2]),
        (("spread", "trunk.mass"), [4.0, 3.0]),
        (("spread", "trunk.mass"), [3.0]),
        (("spread", "trunk.mass"), [NAN, 4.0]),
        (("bootstrap", "trunk.mass"), [3.0, INF]),
        (("from_logs", "supply_voltage"), [16.0, 13.0]),
        (("from_logs", "delay_jitter"), [NAN, 0.0]),
        (("not_in_model",), ["a\x00b"]),
        (("correlation",), None),
        (("correlation", "names"), ["nobody.zero"] * 16),
        (("correlation", "matrix"), [[1.0]]),
        (("correlation", "matrix"), [[NAN] * 16] * 16),
    ],
)  # fmt: skip
def test_a_wrong_field_is_one_line(robot_record, tmp_path, keys, value):
    """Every field that is missing, of the wrong kind, unit or size, or not finite is an input error of one line."""
    data = robot_record().to_json()
    place = data
    for key in keys[:-1]:
        place = place[key]
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=str(path)) as error:
        load(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000, b'{"schema": "frasa.fit/2"}'])
def test_what_is_no_fit_of_a_robot(tmp_path, content):
    """Bytes that are no such file, and a missing file, are input errors."""
    path = tmp_path / "robot.json"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load(path)
    with pytest.raises(InputError, match="no fit at"):
        load(tmp_path / "none.json")


def test_a_fit_of_a_robot_is_no_fit_of_a_servo(robot_record, tmp_path, robot_model_dir):
    """Either reader names what it was given."""
    robot_record().save(tmp_path / "robot.json")
    with pytest.raises(InputError, match="kind 'robot'"):
        stored_fit.load(tmp_path / "robot.json")
    with pytest.raises(InputError, match="not a fit of a robot"):
        load(robot_model_dir / "fits" / "mx106.json")

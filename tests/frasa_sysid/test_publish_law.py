"""Fits with a friction law beyond Coulomb-viscous, into models: the law itself, or its stand-in."""

import argparse
import copy
import json
from dataclasses import asdict, replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import (
    LAW_FIELDS,
    CalibrationError,
    ModelError,
    QualityError,
    actuators_of,
    apply,
    dofs_of,
    load_calibration,
    load_model,
    parameter,
    read,
    servo_law,
)
from frasa_sysid.calibration.friction import COEFFICIENTS, LAWS, Friction
from frasa_sysid.calibration.parameters import LAW_COEFFICIENTS
from frasa_sysid.fit_json import SCHEMA
from frasa_sysid.publish import publish, write
from frasa_sysid.published_as import as_m1
from frasa_sysid.stored_fit import load, model_parameters

NATIVE = {"kp": 24.9, "forcerange": 7.77, "damping": 1.1, "armature": 0.03, "delay": 0.0071}
STAND_IN = {"kp": 24.9, "damping": 1.3, "frictionloss": 0.21, "armature": 0.031, "forcerange": 7.77, "delay": 0.0071}
M5 = Friction(0.12, 0.05, 0.08, 0.06, 0.03, 0.1, 0.2, stribeck_speed=0.4, stribeck_exponent=1 / 3)
BY_LAW = {
    "m1": Friction(0.12, 0.05),
    "m2": Friction(0.12, 0.05, stribeck=0.08, stribeck_speed=0.4, stribeck_exponent=1 / 3),
    "m3": Friction(0.12, 0.05, load_motor=0.06, load_external=0.06),
    "m4": replace(M5, load_external=0.06, load_external_stribeck=0.1),
    "m5": M5,
    "m6": replace(M5, quad_motor=0.01, quad_external=0.02),
}


pytestmark = pytest.mark.usefixtures("law_as_before")


def fit_of(folder, law="m4", servo="mx106", friction=None, **more):
    """A fit with a law; every number of it has been fitted."""
    friction = friction or BY_LAW[law]
    own = ["damping_off", *(name for name in COEFFICIENTS[law] if "=" not in name)]
    values = NATIVE | {"frictionloss": friction.coulomb}
    values |= {field: getattr(friction, LAW_COEFFICIENTS[field]) for field in own}
    parameters = {
        f"{servo}.{field}": {
            "value": value,
            "unit": parameter(f"{servo}.{field}").unit,
            "low": 0.9 * value,
            "high": 1.1 * value,
            "spread_low": value,
            "spread_high": 1.2 * value,
            "verdict": "identified",
        }
        for field, value in values.items()
    }
    names = list(parameters)
    matrix = 0.4 * np.ones((len(names),) * 2) + 0.6 * np.eye(len(names))
    data = {
        "schema": SCHEMA,
        "servo": servo,
        "friction": law,
        "origin": "real",
        "stated_at": {"supply_voltage": 15.0, "firmware_gain": 12.0},
        "parameters": parameters,
        "law": asdict(friction),
        "as_m1": {"mujoco": STAND_IN, "penalty_rad": 0.004, "loads": [0.7, 2.5], "speed": 6.0},
        "not_in_model": ["punch: the firmware adds to any error"],
        "correlation": {
            "names": names,
            "matrix": matrix.tolist(),
        },
        "inputs": {"a.mcap": "0" * 64},
        **more,
    }
    path = folder / f"{servo}.json"
    path.write_text(json.dumps(data))
    return load(path)


def published(fits, folder):
    """Publish and write; returns what was made and the model file."""
    nominal, out = folder / "nominal.xml", folder / "calibrated.xml"
    made = publish(fits, nominal, out)
    write(made, nominal, out)
    return made, out


@pytest.mark.parametrize("law", LAWS)
def test_the_model_carries_the_law(model_dir, tmp_path, law):
    """All eleven coefficients of M2 to M6 stand in the model to the last bit, and act; M1 needs none of them."""
    stored = fit_of(tmp_path, law)
    _, out = published([stored], model_dir)
    model = load_model(out)
    assert servo_law.law(model, "mx106") == (None if law == "m1" else BY_LAW[law])
    assert servo_law.law(model, "mx64") is None
    assert servo_law.has_law(model) == (law != "m1")
    assert servo_law.installed() or law == "m1"
    for name, one in model_parameters(stored).items():
        assert read(model, name) == one["value"]
    np.testing.assert_array_equal(model.dof_frictionloss[dofs_of(model, actuators_of(model, "mx106"))], 0.05)
    assert ("friction law" in out.read_text()) == (law != "m1")
    assert "not in this model: punch" in out.read_text()


def test_a_law_without_coulomb_friction_still_has_its_row(model_dir, tmp_path):
    """MuJoCo makes no friction row at zero, so the joint holds a millionth; the law itself holds the zero."""
    _, out = published([fit_of(tmp_path, friction=replace(BY_LAW["m4"], coulomb=0.0))], model_dir)
    model = load_model(out)
    assert model.dof_frictionloss[dofs_of(model, actuators_of(model, "mx106"))[0]] == 1e-6
    assert read(model, "mx106.frictionloss") == 0.0


def test_ranges_of_a_law_are_drawn_and_applied_to_copies(model_dir, tmp_path):
    """Every coefficient has a range, correlated as fitted; copies of the model take draws of their own."""
    made, out = published([fit_of(tmp_path), fit_of(tmp_path, "m3", "mx64")], model_dir)
    calibration = load_calibration(out)
    assert calibration.to_dict() == made.calibration.to_dict()
    laws = {name for name in calibration.ranges if parameter(name).field in LAW_FIELDS}
    assert laws == {f"mx106.{field}" for field in LAW_FIELDS if "external" not in field and "quad" not in field} | {
        "mx64.damping_off",
        "mx64.load_motor",
    }
    i, j, k = (calibration.correlated.index(n) for n in ("mx106.stribeck", "mx106.kp", "mx64.load_motor"))
    assert calibration.correlation[i, j] == pytest.approx(0.4)
    assert calibration.correlation[i, k] == 0.0
    original, rng = load_model(out), np.random.default_rng(0)
    ends = []
    for _ in range(3):
        model, drawn = copy.copy(original), calibration.sample(rng)
        apply(model, drawn)
        for name, value in drawn.items():
            assert read(model, name) == pytest.approx(value, rel=1e-12)
        for servo in ("mx106", "mx64"):
            law = servo_law.law(model, servo)
            assert law.load_external == law.load_motor
            assert law.load_external_stribeck == law.load_motor_stribeck
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data, 200)
        ends.append(data.qpos.copy())
    assert np.isfinite(ends).all()
    assert not np.array_equal(ends[0], ends[1])
    assert servo_law.law(original, "mx106") == BY_LAW["m4"]


def test_published_as_m1(model_dir, tmp_path):
    """The stand-in's numbers, ranges around them, no law, its price in the model's comment, and another id."""
    stored = fit_of(tmp_path)
    made, out = published([as_m1(stored)], model_dir)
    model = load_model(out)
    assert not servo_law.has_law(model)
    assert {field: read(model, f"mx106.{field}") for field in STAND_IN} == STAND_IN
    assert set(made.calibration.ranges) == {f"mx106.{field}" for field in STAND_IN}
    loss = made.calibration.ranges["mx106.frictionloss"]
    assert (loss.low, loss.value, loss.high) == pytest.approx((0.205, 0.21, 0.22))
    assert "stands in for friction law m4" in loss.origin
    assert "4.00 mrad" in out.read_text()
    assert made.calibration.id != publish([stored], model_dir / "nominal.xml", out).calibration.id


def test_the_command_line_publishes_the_law_or_its_stand_in(model_dir, tmp_path, capsys):
    """`publish` writes the law, `publish --as m1` the stand-in, and nothing else is a choice."""
    publishing = pytest.importorskip("frasa_sysid.commands.publish")
    parser = argparse.ArgumentParser()
    publishing.add_parser(parser.add_subparsers())
    fit_of(tmp_path)
    words = ["publish", str(tmp_path / "mx106.json"), "--model", str(model_dir / "nominal.xml")]
    for more, carried in (([], True), (["--as", "m1"], False)):
        args = parser.parse_args([*words, *more])
        made = args.run(args)["outputs"]
        assert servo_law.has_law(load_model(made["model"])) == carried
        assert ("stands in for friction law m4" in capsys.readouterr().err) != carried
    with pytest.raises(SystemExit):
        parser.parse_args([*words, "--as", "m2"])


def test_a_coefficient_that_was_altered(model_dir, tmp_path):
    """A model with another law than the fit's is not published; nor one whose joint lost its friction row."""
    fits, nominal, out = [fit_of(tmp_path)], model_dir / "nominal.xml", model_dir / "calibrated.xml"
    made = publish(fits, nominal, out)
    for old, new, error in (
        ("0.12 0.05 0.08", "0.12 0.05 0.081", QualityError),
        ("0.12 0.05 0.08", "0.12 0.05 0.08 0.0", ModelError),
        ("mx106_friction", "mx999_friction", ModelError),
        ('frictionloss="0.05"', 'frictionloss="0.06"', QualityError),
        ('frictionloss="0.05"', 'frictionloss="0"', ModelError),
    ):
        assert old in made.xml
        with pytest.raises(error):
            write(replace(made, xml=made.xml.replace(old, new)), nominal, out)
        assert not out.exists()


def test_a_nominal_model_with_a_law_is_none(model_dir, tmp_path):
    """A law of unknown origin in the nominal model is refused, not replaced in silence."""
    nominal = model_dir / "nominal.xml"
    number = '<custom><numeric name="mx64_friction" data="0 0.1 0 0 0 0 0 0 0 1 1"/></custom></mujoco>'
    nominal.write_text(nominal.read_text().replace("</mujoco>", number))
    with pytest.raises(ModelError, match="carries a friction law"):
        publish([fit_of(tmp_path)], nominal, model_dir / "calibrated.xml")


def test_supply_and_jitter_come_from_the_logs(model_dir, tmp_path):
    """One supply range over all fits, joined with the stated supply, scales gain and limit of every servo jointly."""
    fits = [
        fit_of(tmp_path, from_logs={"supply_voltage": [13.9, 14.2], "delay_jitter": [-0.0004, 0.0011]}),
        fit_of(tmp_path, "m1", "mx64", from_logs={"supply_voltage": [11.0, 15.1], "delay_jitter": None}),
    ]
    made, out = published(fits, model_dir)
    supply = made.calibration.ranges["supply_voltage"]
    assert (supply.low, supply.value, supply.high) == pytest.approx((11.0, 15.0, 15.3))
    assert "quantiles" in supply.origin
    one, other = (made.calibration.ranges[f"{servo}.delay"] for servo in ("mx106", "mx64"))
    assert (one.low, one.high) == pytest.approx((0.9 * 0.0071 - 0.0004, 1.2 * 0.0071 + 0.0011))
    assert (other.low, other.high) == pytest.approx((0.9 * 0.0071, 1.2 * 0.0071))
    assert "jitter" in one.origin
    assert "jitter" not in other.origin
    model = load_model(out)
    assert read(model, "supply_voltage") == 15.0
    assert read(model, "mx64.kp") == 24.9
    drawn = load_calibration(out).sample(np.random.default_rng(1))
    apply(model, drawn)
    ratio = drawn["supply_voltage"] / 15.0
    for servo in ("mx106", "mx64"):
        gains = model.actuator_gainprm[actuators_of(model, servo), 0]
        np.testing.assert_allclose(gains, drawn[f"{servo}.kp"] * ratio)


def test_a_supply_of_zero_is_a_gap_of_the_sensor(model_dir, tmp_path):
    """Readings that no servo runs on do not become robots without torque."""
    made, _ = published([fit_of(tmp_path, from_logs={"supply_voltage": [0.0, 14.0]})], model_dir)
    assert made.calibration.ranges["supply_voltage"].low == 7.5


def test_no_drawn_delay_is_longer_than_the_history(model_dir, tmp_path):
    """Jitter widens the range of a delay as far as the model's buffer of 32 ms goes."""
    stored = fit_of(tmp_path, from_logs={"delay_jitter": [-0.1, 0.1]})
    made, _ = published([stored], model_dir)
    delay = made.calibration.ranges["mx106.delay"]
    assert (delay.low, delay.high) == (0.0, 0.032)


def test_a_law_is_never_divided_by_a_speed_of_zero(model_dir, tmp_path):
    """However wide its interval, a drawn Stribeck speed stays above zero."""
    stored = fit_of(tmp_path)
    stored.parameters["mx106.stribeck_speed"].update(low=-1.0, spread_low=-1.0)
    made, _ = published([stored], model_dir)
    assert made.calibration.ranges["mx106.stribeck_speed"].low == 0.01


def test_a_fit_that_claims_another_servo(model_dir, tmp_path):
    """Two fits of one law are refused like two fits of anything."""
    with pytest.raises(CalibrationError, match="two fits claim"):
        publish([fit_of(tmp_path), fit_of(tmp_path, "m2")], model_dir / "nominal.xml", model_dir / "calibrated.xml")

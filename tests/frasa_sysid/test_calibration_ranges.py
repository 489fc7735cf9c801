import numpy as np
import pytest
import yaml

from frasa_sysid.calibration import Calibration, CalibrationError, Range, load_calibration, read_calibration

NAMES = ("mx64.kp", "mx64.damping", "mx64.delay")
MATRIX = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, -0.3], [0.0, -0.3, 1.0]])
MODEL = '<mujoco><custom><text name="calibration_id" data="{}"/></custom></mujoco>'


def calibration(**changes):
    ranges = {
        "mx64.kp": Range(10.0, 12.0, 15.0, "N m/rad", "here"),
        "mx64.damping": Range(0.5, 0.5, 0.7, "N m s/rad", "here"),
        "mx64.delay": Range(0.0, 0.004, 0.005, "s", "here"),
        "mx64.armature": Range(0.01, 0.01, 0.01, "kg m^2", "here"),
        "mx64.load_motor_stribeck": Range(0.0, 0.1, 0.2, "1", "here"),
        "supply_voltage": Range(11.0, 12.0, 12.6, "V", "here"),
    }
    return Calibration(**{"id": "0123", "ranges": ranges, "correlated": NAMES, "correlation": MATRIX} | changes)


def test_samples_stay_in_range_and_move_together():
    """Draws fill each range evenly, never leave it, and have the rank correlation of the Gaussian copula."""
    rng = np.random.default_rng(0)
    one = calibration()
    draws = [one.sample(rng) for _ in range(4000)]
    for name, bounds in one.ranges.items():
        values = np.array([draw[name] for draw in draws])
        assert values.min() >= bounds.low
        assert values.max() <= bounds.high
        if bounds.high > bounds.low:
            share = (values - bounds.low) / (bounds.high - bounds.low)
            np.testing.assert_allclose(np.quantile(share, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)
    ranks = np.argsort(np.argsort([[draw[name] for draw in draws] for name in NAMES], axis=1), axis=1)
    np.testing.assert_allclose(np.corrcoef(ranks), 6 / np.pi * np.arcsin(MATRIX / 2), atol=0.04)


def test_samples_repeat_with_the_seed():
    """The same generator state gives the same robot."""
    one, two = (calibration().sample(np.random.default_rng(5)) for _ in range(2))
    assert one == two


def test_a_singular_correlation_still_samples():
    """Two numbers that only move together do so exactly, also after rounding in a file."""
    one = calibration(correlated=NAMES[:2], correlation=np.ones((2, 2)))
    draw = one.sample(np.random.default_rng(0))
    shares = [(draw[n] - one.ranges[n].low) / (one.ranges[n].high - one.ranges[n].low) for n in NAMES[:2]]
    assert shares[0] == pytest.approx(shares[1])


def test_round_trip_through_yaml(tmp_path):
    """What is written is read back, exactly."""
    path = tmp_path / "r.yaml"
    path.write_text(yaml.safe_dump(calibration().to_dict()))
    back = read_calibration(path)
    assert back.to_dict() == calibration().to_dict()
    assert back.values() == {name: one.value for name, one in calibration().ranges.items()}


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("schema",), "frasa.randomization/9"),
        (("schema",), None),
        (("calibration_id",), None),
        (("parameters",), None),
        (("parameters",), []),
        (("parameters",), 3),
        (("parameters", "mx64.kp"), None),
        (("parameters", "mx64.kp"), 12.0),
        (("parameters", "mx64.kp", "low"), None),
        (("parameters", "mx64.kp", "low"), "little"),
        (("parameters", "mx64.kp", "low"), [1]),
        (("parameters", "mx64.kp", "low"), 13.0),
        (("parameters", "mx64.kp", "low"), -1.0),
        (("parameters", "mx64.kp", "value"), float("nan")),
        (("parameters", "mx64.kp", "high"), float("inf")),
        (("parameters", "mx64.kp", "high"), 10**400),
        (("parameters", "mx64.kp", "unit"), "N m/deg"),
        (("parameters", "mx64.load_motor_stribeck", "unit"), "N m"),
        (("parameters", "supply_voltage", "unit"), "mV"),
        (("parameters", "mx64.kp", "unit"), None),
        (("parameters", "mx64.kp", "origin"), None),
        (("parameters", "mx64.colour"), {"low": 0, "value": 0, "high": 0, "unit": "1", "origin": ""}),
        (("parameters", 7), {"low": 0, "value": 0, "high": 0, "unit": "1", "origin": ""}),
        (("correlation",), 5),
        (("correlation", "names"), None),
        (("correlation", "names"), ["mx64.kp"]),
        (("correlation", "names"), ["mx64.kp", "mx64.damping", "nobody.kp"]),
        (("correlation", "names"), ["mx64.kp", "mx64.kp", "mx64.delay"]),
        (("correlation", "matrix"), [[1.0, 0.0]]),
        (("correlation", "matrix"), [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (("correlation", "matrix"), [[1.0, 0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (("correlation", "matrix"), [[4.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (("correlation", "matrix"), [[float("nan")] * 3] * 3),
        (("correlation", "matrix"), "x"),
    ],
)
def test_a_wrong_field_is_one_error(tmp_path, keys, value):
    """Every field that is missing, of the wrong kind, out of order or not finite is a calibration error."""
    data = calibration().to_dict()
    place = data
    for key in keys[:-1]:
        place = place[key]
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    path = tmp_path / "r.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(CalibrationError):
        read_calibration(path)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"3", b"a: [", b"\xff\xfe\x00", b"\x00", b"a: 2001-99-99", b"!!python/object:os.x {}"]
)
def test_what_is_no_ranges_file(tmp_path, content):
    """Bytes that are no ranges file, and a missing file, are calibration errors; nothing in them is executed."""
    path = tmp_path / "r.yaml"
    path.write_bytes(content)
    with pytest.raises(CalibrationError):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="no ranges file"):
        read_calibration(tmp_path / "none.yaml")


def test_model_and_ranges_belong_together(tmp_path):
    """A calibrated model loads its own ranges; those of another, or none, are an error; a nominal model has none."""
    model, ranges = tmp_path / "m.xml", tmp_path / "randomization.yaml"
    model.write_text(MODEL.format("0123"))
    with pytest.raises(CalibrationError, match="no ranges file"):
        load_calibration(model)
    ranges.write_text(yaml.safe_dump(calibration().to_dict()))
    assert load_calibration(model).id == "0123"
    model.write_text(MODEL.format("4567"))
    with pytest.raises(CalibrationError, match=r"0123.*4567"):
        load_calibration(model)
    model.write_text("<mujoco/>")
    assert load_calibration(model) is None
    with pytest.raises(CalibrationError, match="carries None"):
        load_calibration(model, ranges)

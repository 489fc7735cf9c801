import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid import fit_json, stored_fit
from frasa_sysid.calibration import (
    CalibrationError,
    calibration_id,
    load_calibration,
    load_model,
    parameter,
    read,
    run_command,
)
from frasa_sysid.cli import build_parser
from frasa_sysid.errors import InputError, ModelError, QualityError, UsageError
from frasa_sysid.publish import check_replay, find_fits, publish, replay_tolerance, write

FITTED = {
    "mx106": {"kp": 24.9, "forcerange": 7.77, "damping": 1.1, "frictionloss": 1e-5, "armature": 0.03, "delay": 0.0071},
    "mx64": {"kp": 1 / 3, "forcerange": 4.25, "damping": 0.5, "frictionloss": 0.1, "armature": 0.0125, "delay": 0.0},
}


def fit_of(servo, folder, **changes):
    """A fit file with fitted numbers, intervals of 10 % and some correlation."""
    values = FITTED[servo] | changes
    parameters = {
        f"{servo}.{field}": {
            "value": value,
            "unit": parameter(f"{servo}.{field}").unit,
            "low": 0.9 * value,
            "high": 1.1 * value,
            "spread_low": 0.95 * value,
            "spread_high": 1.3 * value,
            "verdict": "identified",
        }
        for field, value in values.items()
    }
    parameters["bench.offset"] = dict(parameters[f"{servo}.kp"], value=-0.01, low=-0.02, high=0.0, unit="rad")
    names = list(parameters)
    matrix = 0.5 * np.ones((len(names),) * 2) + 0.5 * np.eye(len(names))
    data = {
        "schema": fit_json.SCHEMA_M1,
        "servo": servo,
        "origin": "simulated",
        "stated_at": {"supply_voltage": 15.0, "firmware_gain": 12.0},
        "parameters": parameters,
        "correlation": {"names": names, "matrix": matrix.tolist()},
        "inputs": {f"{servo}.mcap": "0" * 64},
    }
    path = folder / f"{servo}.json"
    path.write_text(json.dumps(data))
    return stored_fit.load(path)


@pytest.fixture
def fits(tmp_path):
    """Fits of both servos."""
    return [fit_of(servo, tmp_path) for servo in ("mx106", "mx64")]


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_compiled_numbers_are_the_fitted_ones(model_dir, fits):
    """Every actuator of a class holds its fit's numbers to the last bit; everything else is as in the nominal model."""
    out = model_dir / "calibrated.xml"
    write(publish(fits, model_dir / "nominal.xml", out), model_dir / "nominal.xml", out)
    model, nominal = load_model(out), load_model(model_dir / "nominal.xml")
    for stored in fits:
        for name, one in stored_fit.model_parameters(stored).items():
            assert read(model, name) == one["value"]
    assert calibration_id(model) is not None
    for field in ("nq", "nu", "nsensor", "ngeom", "nkey"):
        assert getattr(model, field) == getattr(nominal, field)
    for field in ("body_mass", "geom_size", "jnt_range", "key_qpos", "actuator_history", "sensor_delay"):
        np.testing.assert_array_equal(getattr(model, field), getattr(nominal, field))
    assert model.opt.timestep == nominal.opt.timestep


def test_same_input_same_bytes(model_dir, fits):
    """Publishing twice, in any order of the fits, gives the same bytes, and leaves the nominal files as they were."""
    before, made = contents(model_dir), []
    out = model_dir / "calibrated.xml"
    for order in (fits, fits[::-1]):
        write(publish(order, model_dir / "nominal.xml", out), model_dir / "nominal.xml", out)
        after = contents(model_dir)
        made.append({name: after.pop(name) for name in ("calibrated.xml", "randomization.yaml")})
        assert after == before
    assert made[0] == made[1]


def test_another_fit_is_another_id(model_dir, fits, tmp_path):
    """The id changes with any number; model and ranges carry the same one."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    ids = {publish(fits, nominal, out).calibration.id, publish(fits[:1], nominal, out).calibration.id}
    ids.add(publish([fit_of("mx106", tmp_path, kp=24.9000001), fits[1]], nominal, out).calibration.id)
    assert len(ids) == 3
    write(publish(fits, nominal, out), nominal, out)
    assert load_calibration(out).id == calibration_id(load_model(out)) in ids


def test_ranges_hold_interval_spread_and_floor(model_dir, fits):
    """A range is the union of interval, leave-one-out spread and floor; the bench's own numbers have none."""
    calibration = publish(fits, model_dir / "nominal.xml", model_dir / "calibrated.xml").calibration
    assert set(calibration.ranges) == {f"{servo}.{field}" for servo in FITTED for field in FITTED[servo]}
    one = calibration.ranges["mx106.kp"]
    assert (one.low, one.value, one.high) == (0.9 * 24.9, 24.9, 1.3 * 24.9)
    assert "simulated" in one.origin
    delay = calibration.ranges["mx64.delay"]
    assert (delay.low, delay.value, delay.high) == (0.0, 0.0, 0.0005)
    names = list(calibration.correlated)
    i, j, k = names.index("mx106.kp"), names.index("mx106.damping"), names.index("mx64.kp")
    assert calibration.correlation[i, j] == 0.5
    assert calibration.correlation[i, k] == 0.0


def test_unexcited_numbers_get_no_range(model_dir, fits):
    """What the logs do not speak of has no measured range, but keeps its place in the model."""
    first = fits[0]
    parameters = {name: dict(one) for name, one in first.parameters.items()}
    parameters["mx106.forcerange"]["verdict"] = "not excited"
    published = publish(
        [replace(first, parameters=parameters)], model_dir / "nominal.xml", model_dir / "calibrated.xml"
    )
    assert "mx106.forcerange" not in published.calibration.ranges
    assert "mx106.forcerange" not in published.calibration.correlated
    assert 'forcerange="-7.77 7.77"' in published.xml


def unexcited(path, names):
    """A fit file of which the logs say nothing of some numbers."""
    data = json.loads(path.read_text())
    for name in names:
        data["parameters"][name]["verdict"] = "not excited"
    path.write_text(json.dumps(data))


def test_a_servo_that_the_logs_tell_nothing_of_is_no_model(model_dir, fits, tmp_path, capsys):
    """Exit 4 and one line with the remedy, though the bench's own zero was told; nothing is written."""
    unexcited(tmp_path / "mx64.json", [f"mx64.{field}" for field in FITTED["mx64"]])
    before = contents(model_dir)
    words = ["publish", tmp_path / "mx106.json", tmp_path / "mx64.json", "--model", model_dir / "nominal.xml"]
    assert run_command(build_parser(), [str(word) for word in words]) == 4
    err = capsys.readouterr().err
    assert "of mx64: all 6 numbers of its actuator are not excited" in err
    assert "record what frasa-sysid inspect LOG asks for, and fit again" in err
    assert err.count("\n") == 1
    assert contents(model_dir) == before


def test_what_stands_without_evidence_is_named(model_dir, fits, tmp_path, capsys):
    """One line for a servo with some such numbers, none for one without."""
    unexcited(tmp_path / "mx64.json", ["mx64.delay", "mx64.forcerange"])
    words = ["publish", tmp_path / "mx106.json", tmp_path / "mx64.json", "--model", model_dir / "nominal.xml"]
    assert run_command(build_parser(), [str(word) for word in words]) == 0
    said = [one for one in capsys.readouterr().err.splitlines() if "without evidence" in one]
    assert [one.partition("): ")[2] for one in said] == ["mx64.forcerange, mx64.delay"]


def test_another_folder_still_compiles(model_dir, fits, tmp_path):
    """A model published elsewhere finds the nominal parts from there."""
    out = tmp_path / "else" / "where" / "robot.xml"
    write(publish(fits, model_dir / "nominal.xml", out), model_dir / "nominal.xml", out)
    assert load_model(out).nu == load_model(model_dir / "nominal.xml").nu
    assert load_calibration(out).values()["mx64.forcerange"] == 4.25
    assert [path.name for path in sorted(out.parent.iterdir())] == ["randomization.yaml", "robot.xml"]


def test_another_folder_finds_meshes(model_dir, fits, tmp_path, monkeypatch):
    """Meshes and pictures stay where they are; where the new place may not read them, nothing is written."""
    nominal, out = model_dir / "nominal.xml", model_dir / "variant" / "calibrated.xml"
    (model_dir / "meshes").mkdir()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (model_dir / "meshes" / "shell.obj").write_text("\n".join(lines) + "\n")
    text = nominal.read_text()
    for compiler, name in (("", "meshes/shell.obj"), ('<compiler meshdir="meshes"/>', "shell.obj")):
        nominal.write_text(text.replace("</mujoco>", f'{compiler}<asset><mesh file="{name}"/></asset></mujoco>'))
        monkeypatch.chdir(model_dir)
        write(publish(fits, nominal, out), nominal, out)
        assert load_model(out).mesh("shell").vertnum == 4
        assert load_calibration(out).values()["mx64.forcerange"] == 4.25
        before = contents(out.parent)
        monkeypatch.chdir(tmp_path.parent / tmp_path.name / "robot_model" / "meshes")
        with pytest.raises(ModelError, match=r"variant/calibrated\.xml: <mesh> names .*outside"):
            write(publish(fits[:1], nominal, out), nominal, out)
        assert contents(out.parent) == before


def test_the_ranges_of_another_model_are_not_taken(model_dir, fits):
    """A second model beside a published one is refused before anything is written."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    write(publish(fits, nominal, out), nominal, out)
    before = contents(model_dir)
    with pytest.raises(UsageError, match=r"would take the ranges of calibrated\.xml.*--out FOLDER"):
        publish(fits[:1], nominal, model_dir / "variant.xml")
    # Published by another process between the two, under another name: seen before it is written.
    out.rename(model_dir / "away")
    late = publish(fits[:1], nominal, model_dir / "variant.xml")
    (model_dir / "away").rename(out)
    with pytest.raises(UsageError, match="ranges of calibrated"):
        write(late, nominal, model_dir / "variant.xml")
    assert contents(model_dir) == before
    assert load_calibration(out).id == calibration_id(load_model(out))


def test_ranges_that_may_be_replaced(model_dir, fits):
    """Those of the same model, of a copy of it, of the same calibration, broken ones, and those of nobody."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    write(publish(fits, nominal, out), nominal, out)
    write(publish(fits, nominal, model_dir / "same.xml"), nominal, model_dir / "same.xml")
    assert load_calibration(out).id == load_calibration(model_dir / "same.xml").id
    (model_dir / "same.xml").rename(model_dir / "before.xml")
    write(publish(fits[:1], nominal, out), nominal, out)
    assert load_calibration(out).id == calibration_id(load_model(out))
    (model_dir / "randomization.yaml").write_text("no ranges")
    write(publish(fits, nominal, model_dir / "other.xml"), nominal, model_dir / "other.xml")
    assert load_calibration(model_dir / "other.xml").id == calibration_id(load_model(model_dir / "other.xml"))
    (model_dir / "other.xml").unlink()
    (model_dir / "before.xml").write_text("no model")
    write(publish(fits[1:], nominal, out), nominal, out)
    assert "mx106.kp" not in load_calibration(out).values()


def test_two_fits_of_one_parameter(model_dir, fits, tmp_path):
    """Two fits that claim the same number are an error, and so is no fit at all."""
    other = fit_of("mx106", tmp_path, kp=20.0)
    for bad, complaint in ([[fits[0], other], "two fits claim mx106"], [[], "no parameter"]):
        with pytest.raises(CalibrationError, match=complaint):
            publish(bad, model_dir / "nominal.xml", model_dir / "calibrated.xml")


@pytest.mark.parametrize("key", ["supply_voltage", "firmware_gain"])
def test_stated_elsewhere(model_dir, fits, key):
    """A fit whose gain holds at another supply or firmware gain is refused, not scaled in silence."""
    other = replace(fits[0], stated={**fits[0].stated, key: 11.0})
    with pytest.raises(CalibrationError, match=key):
        publish([other], model_dir / "nominal.xml", model_dir / "calibrated.xml")


@pytest.mark.parametrize("name", ["nominal.xml", "servos_nominal.xml", "sigmaban.xml", "../robot_model/floor.xml"])
def test_the_nominal_model_is_never_overwritten(model_dir, fits, name):
    """No file of the nominal model can be the output, whatever it is called on the command line."""
    with pytest.raises(ModelError, match="part of the nominal model"):
        publish(fits, model_dir / "nominal.xml", model_dir / name)


def test_only_nominal_models_are_published_from(model_dir, fits, tmp_path):
    """A calibrated model, one without the class, one without its supply, and no model are refused."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    write(publish(fits, nominal, out), nominal, out)
    with pytest.raises(ModelError, match="calibrated already"):
        publish(fits, out, tmp_path / "twice.xml")
    with pytest.raises(ModelError, match="no servo class 'mx64'"):
        publish(fits, model_dir / "bench_pendulum.xml", out)
    with pytest.raises(ModelError, match="no model at"):
        publish(fits, tmp_path / "none.xml", out)
    text = (model_dir / "servos_nominal.xml").read_text().replace("servo_supply_voltage", "volts")
    (model_dir / "servos_nominal.xml").write_text(text)
    with pytest.raises(ModelError, match="servo_supply_voltage"):
        publish(fits, nominal, out)


def test_a_number_that_was_altered(model_dir, fits):
    """Text that does not compile to the fitted numbers is not published; the old files stay."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    published = publish(fits, nominal, out)
    write(published, nominal, out)
    before = contents(model_dir)
    for old, new in (('kp="24.9"', 'kp="24.90001"'), (published.calibration.id, "0" * 16)):
        with pytest.raises(QualityError, match="nothing was published"):
            write(replace(published, xml=published.xml.replace(old, new)), nominal, out)
        assert contents(model_dir) == before

    def refuse(model, path):
        assert isinstance(model, mujoco.MjModel)
        assert path.is_file()
        assert path != out
        raise QualityError("no")

    with pytest.raises(QualityError, match="no"):
        write(publish(fits[:1], nominal, out), nominal, out, refuse)
    assert contents(model_dir) == before


def test_a_delay_longer_than_the_history(model_dir, tmp_path):
    """A delay that MuJoCo would cut in silence is refused."""
    long = [fit_of("mx106", tmp_path, delay=0.04)]
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    with pytest.raises(ModelError, match="does not fit"):
        write(publish(long, nominal, out), nominal, out)
    assert not out.exists()


def test_words_of_a_stranger(model_dir, fits):
    """Text in a fit file cannot break out of the comment it is quoted in."""
    odd = replace(fits[0], origin="--><worldbody/><!-- real --")
    published = publish([odd], model_dir / "nominal.xml", model_dir / "calibrated.xml")
    write(published, model_dir / "nominal.xml", model_dir / "calibrated.xml")
    assert "<worldbody/>" not in published.xml.replace("- -><worldbody/>", "")


def test_replay_check():
    """A tenth of a milliradian passes, more does not, and neither does a run that diverged, wherever it stands."""
    fitted = [np.zeros(3), np.zeros(2)]
    assert check_replay(fitted, [np.full(3, 9e-5), np.zeros(2)]) == pytest.approx(9e-5)
    for bad in (1.1e-4, np.nan):
        for i in (0, 1):
            other = [one.copy() for one in fitted]
            other[i][-1] = bad
            with pytest.raises(QualityError, match="away from the fit"):
                check_replay(fitted, other)
    assert replay_tolerance("m1") == 1e-4
    looser = replay_tolerance("m4")
    assert check_replay(fitted, [np.full(3, 9e-4), np.zeros(2)], looser) == pytest.approx(9e-4)
    with pytest.raises(QualityError, match=r"allowed is 1\.0 mrad"):
        check_replay(fitted, [np.full(3, 1.1e-3), np.zeros(2)], looser)


def test_fits_of_a_folder(tmp_path):
    """Fit files are found in order of name, checkpoints of running fits are not; none is an error."""
    with pytest.raises(InputError, match="no fit files"):
        find_fits(tmp_path)
    for name in ("b.json", "a.json", "c.partial.json", "a.html"):
        (tmp_path / name).touch()
    assert [path.name for path in find_fits(tmp_path)] == ["a.json", "b.json"]

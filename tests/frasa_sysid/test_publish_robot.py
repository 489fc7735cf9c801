"""A fit of the whole robot, alone and on bench fits, into the model and its ranges."""

import json
import re
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.calibration import apply, load_calibration, load_model, number, read, run_command, servo_law
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.publish import load_fits
from frasa_sysid.errors import CalibrationError, ModelError, QualityError
from frasa_sysid.model_mark import mark_of
from frasa_sysid.publish import publish, write
from frasa_sysid.published_as import as_m1

pytestmark = pytest.mark.usefixtures("law_as_before")


@pytest.fixture
def fits(robot_model_dir):
    """The bench fits of this repository, which have friction law M4."""
    return [stored_fit.load(robot_model_dir / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]


def robot_of(record, folder, name="robot.json"):
    path = folder / name
    record.save(path)
    return stored_robot_fit.load(path)


def base_of(stored):
    return {name: one["value"] for name, one in stored.parameters.items()}


@pytest.fixture
def on_benches(robot_record, fits, tmp_path):
    """A robot's fit that stood on both bench fits and scales one of them."""
    return robot_of(robot_record(fits), tmp_path)


def published(fits, folder, robot):
    """Publish and write; returns what was made and the model file."""
    nominal, out = folder / "nominal.xml", folder / "calibrated.xml"
    made = publish(fits, nominal, out, robot)
    write(made, nominal, out)
    return made, out


def test_every_number_comes_back(model_dir, fits, on_benches):
    """Publish, load, read: the robot's numbers to the last bit, the bench's where the robot's fit is silent."""
    made, out = published(fits, model_dir, on_benches)
    model, calibration = load_model(out), load_calibration(out)
    exact = {name for name in on_benches.published if name != "trunk.mass"}
    for name, one in on_benches.published.items():
        assert read(model, name) == (one["value"] if name in exact else pytest.approx(one["value"], rel=1e-15))
    for stored in fits:
        for name, one in stored_fit.model_parameters(stored).items():
            if name not in on_benches.published:
                assert read(model, name) == one["value"]
    assert calibration.to_dict() == made.calibration.to_dict()
    assert set(calibration.ranges) >= set(on_benches.published) - {"head_pitch.zero"}
    assert read(model, "supply_voltage") == number(model, "servo_supply_voltage") == 15.0


def test_nothing_else_changes(model_dir, robot_record, tmp_path):
    """Geometry, inertia of all other bodies, contacts, commands and solver are the nominal model's."""
    robot = robot_of(robot_record(), tmp_path)
    _, out = published([], model_dir, robot)
    model, nominal = load_model(out), load_model(model_dir / "nominal.xml")
    for field in ("body_pos", "body_quat", "geom_pos", "geom_size", "jnt_axis", "key_qpos", "actuator_ctrlrange"):
        np.testing.assert_array_equal(getattr(model, field), getattr(nominal, field))
    others = np.arange(model.nbody) != nominal.body("trunk").id
    np.testing.assert_array_equal(model.body_mass[others], nominal.body_mass[others])
    ratio = 3.41 / nominal.body("trunk").mass[0]
    np.testing.assert_allclose(model.body("trunk").inertia, ratio * nominal.body("trunk").inertia, rtol=1e-14)
    np.testing.assert_array_equal(model.body("trunk").ipos, [-0.0021, nominal.body("trunk").ipos[1], 0.0733])


def test_same_input_same_bytes(model_dir, fits, on_benches):
    """Publishing twice, in any order of the fits, gives the same bytes, and leaves the nominal files as they were."""
    before = {path.name: path.read_bytes() for path in model_dir.iterdir()}
    made = []
    for order in (fits, fits[::-1]):
        _, out = published(order, model_dir, on_benches)
        made.append((out.read_bytes(), out.with_name("randomization.yaml").read_bytes()))
        assert {name: (model_dir / name).read_bytes() for name in before} == before
    assert made[0] == made[1]


def test_only_what_changes_is_written_out(model_dir, robot_record, tmp_path, fits):
    """Without zeros and trunk the bodies stay an include; without sensors the measurements do."""
    record = robot_record()
    for keep, included in (
        ("sensor.", {"sigmaban.xml", "floor.xml"}),
        ("zero", {"measurements_nominal.xml", "floor.xml"}),
        ("trunk.", {"measurements_nominal.xml", "floor.xml"}),
        ("delay", {"sigmaban.xml", "floor.xml"}),
    ):
        some = tuple(one for one in record.estimates if keep in one.name)
        part = replace(record, estimates=some, correlated=(), correlation=np.zeros((0, 0)))
        _, out = published([], model_dir, robot_of(part, tmp_path))
        assert set(re.findall(r'include file="([^"]*)"', out.read_text())) == included


def test_another_folder_still_compiles(model_dir, fits, on_benches, tmp_path):
    """A model published elsewhere finds the nominal parts from there."""
    out = tmp_path / "else" / "where" / "robot.xml"
    write(publish(fits, model_dir / "nominal.xml", out, on_benches), model_dir / "nominal.xml", out)
    assert read(load_model(out), "left_knee.zero") == -0.0213


def test_the_robot_replaces_the_bench_it_stood_on(model_dir, fits, on_benches):
    """Its numbers are in the model, the law and the ranges, and the head of the model says in place of what."""
    made, out = published(fits, model_dir, on_benches)
    bench = base_of(fits[0])
    assert read(load_model(out), "mx106.kp") == 0.93 * bench["mx106.kp"]
    law = servo_law.law(load_model(out), "mx106")
    assert law.coulomb == 1.25 * fits[0].law.coulomb
    assert law.load_external == law.load_motor == 1.25 * fits[0].law.load_motor
    assert law.stribeck_speed == fits[0].law.stribeck_speed
    assert law.viscous == 1.08 * fits[0].law.viscous
    assert servo_law.law(load_model(out), "mx64") == fits[1].law
    assert f"in place of {bench['mx106.kp']:.6g} N m/rad of bench fit {fits[0].sha256[:12]}" in made.xml
    assert f"in place of {bench['mx106.delay']:.6g} s of bench fit" in made.xml
    assert "robot fit" in made.calibration.ranges["mx106.kp"].origin
    assert "robot fit" not in made.calibration.ranges["mx106.armature"].origin
    assert "mx106.gain_scale = 0.93" in made.xml
    assert "not in this model: position delay" in made.xml


def test_without_having_stood_on_it_two_fits_claim_one_number(model_dir, fits, robot_record, tmp_path):
    """A robot's fit that does not name a bench fit cannot replace it, and one that does cannot go without it."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    alone = robot_of(robot_record(), tmp_path)
    with pytest.raises(CalibrationError, match=r"two fits claim mx64\.delay"):
        publish(fits[1:], nominal, out, alone)
    named = robot_of(robot_record(fits[:1]), tmp_path)
    with pytest.raises(CalibrationError, match="did not stand"):
        publish(fits, nominal, out, named)
    with pytest.raises(CalibrationError, match=rf"stood on the bench fit {fits[0].sha256[:12]}.*not among"):
        publish(fits[1:], nominal, out, named)


def test_a_product_must_be_one(model_dir, fits, robot_record, tmp_path):
    """A gain that is not the bench's times the scale is not published: one of the three is of another fit."""
    record = robot_record(frozen=tuple(one.sha256 for one in fits))  # scaled the nominal numbers
    made = re.escape(f"{0.93 * base_of(fits[0])['mx106.kp']:.6g}")
    with pytest.raises(CalibrationError, match=rf"mx106\.kp = 19\.53, but mx106\.gain_scale = 0\.93 makes {made}"):
        publish(fits, model_dir / "nominal.xml", model_dir / "calibrated.xml", robot_of(record, tmp_path))


def test_a_law_needs_its_bench(model_dir, robot_record, tmp_path, fits):
    """Coefficients of a law without the bench fit that has it, or with its stand-in in its place, are refused."""
    nominal, out = model_dir / "nominal.xml", model_dir / "calibrated.xml"
    robot = robot_of(robot_record(fits, frozen=()), tmp_path)
    with pytest.raises(CalibrationError, match=r"claims mx106\.(damping_off|stribeck), which no bench fit"):
        publish([], nominal, out, robot)
    robot = robot_of(robot_record(fits), tmp_path)
    with pytest.raises(CalibrationError, match="stand-in as m1"):
        publish([as_m1(one) for one in fits], nominal, out, robot)


def test_another_robot(model_dir, robot_record, tmp_path):
    """A fit made with another body, or stated at another supply, is refused; a comment in the model changes nothing."""
    robot, nominal = robot_of(robot_record(), tmp_path), model_dir / "nominal.xml"
    bodies = model_dir / "sigmaban.xml"
    text = bodies.read_text()
    bodies.write_text(text.replace("</mujoco>", "<!-- a word --></mujoco>"))
    publish([], nominal, model_dir / "calibrated.xml", robot)
    bodies.write_text(text.replace('mass="0.257265"', 'mass="0.3"'))
    with pytest.raises(CalibrationError, match="made with another model"):
        publish([], nominal, model_dir / "calibrated.xml", robot)
    bodies.write_text(text)
    with pytest.raises(CalibrationError, match="fit of the robot states supply_voltage"):
        publish([], nominal, nominal.with_name("x.xml"), replace(robot, stated={"supply_voltage": 12.0}))


def test_histories_hold_every_delay_of_a_range(model_dir, robot_record, tmp_path):
    """Sensors and servos keep samples for the upper end of each range and some more; the others as before."""
    measured = model_dir / "measurements_nominal.xml"
    measured.write_text(measured.read_text().replace(' interp="linear"', ""))
    robot = robot_of(robot_record(), tmp_path)
    made, out = published([], model_dir, robot)
    model = load_model(out)
    kept = model.sensor_history[model.sensor("measured_orientation").id]
    high = made.calibration.ranges["sensor.orientation_delay"].high
    assert kept[0] * model.opt.timestep > 1.1 * high > 1.1 * 0.0911
    assert kept[1] == 1
    assert model.sensor_history[model.sensor("measured_gyro").id, 0] == 40
    assert model.actuator_history[model.actuator("left_knee").id, 0] * model.opt.timestep > 0.0371
    assert model.actuator_history[model.actuator("head_yaw").id, 0] == 16
    assert not model.sensor_history[model.sensor("gyro").id].any()


def test_ranges_have_floors_and_words(model_dir, robot_record, tmp_path):
    """Interval, spread, bootstrap and a stated floor; zeros may be negative; jitter widens commands only."""
    ranges = published([], model_dir, robot_of(robot_record(), tmp_path))[0].calibration.ranges
    zero = ranges["left_knee.zero"]
    floor = np.radians(0.2)
    assert (zero.low, zero.value, zero.high) == pytest.approx((-0.0213 - floor, -0.0213, -0.0213 + floor))
    assert "0.2 deg" in zero.origin
    gyro = ranges["sensor.gyro_delay"]
    assert (gyro.low, gyro.high) == pytest.approx((0.0529 - 0.0008, 0.0529 + 0.0005))
    assert "0.5 ms" in gyro.origin
    command = ranges["mx64.delay"]
    assert (command.low, command.high) == pytest.approx((0.0057 - 0.0008 - 0.0003, 0.0057 + 0.0005 + 0.0005))
    assert "jitter" in command.origin
    assert "jitter" not in gyro.origin
    assert ranges["trunk.com_x"].low == pytest.approx(-0.0041)
    assert ranges["mx106.frictionloss"].high == pytest.approx(1.28 * 0.1)
    assert "head_pitch.zero" not in ranges
    assert (ranges["supply_voltage"].low, ranges["supply_voltage"].high) == (13.9, 16.1)
    assert "robot fit" in ranges["supply_voltage"].origin


def test_what_was_scaled_is_known_no_better_than_its_base(model_dir, fits, on_benches):
    """A narrow scale of a number that the bench knew roughly leaves it roughly known; a delay is found anew."""
    ranges = published(fits, model_dir, on_benches)[0].calibration.ranges
    for name in ("mx106.stribeck", "mx106.load_motor"):
        one, bench = ranges[name], fits[0].parameters[name]
        assert one.low <= 1.25 * min(bench["low"], bench["spread_low"]) < one.value
        assert one.high >= 1.25 * max(bench["high"], bench["spread_high"]) > one.value
        assert "scaled by 1.25" in one.origin
    assert ranges["mx106.delay"].low > 0.035
    assert "bench fit" not in ranges["mx106.delay"].origin


def test_a_declared_delay_has_no_range(model_dir, robot_record, tmp_path):
    """What was not fitted but fixed stands in the model and is not drawn."""
    record = robot_record()
    some = [replace(one, verdict="fixed at its declared value") if "position" in one.name else one
            for one in record.estimates]  # fmt: skip
    made, out = published([], model_dir, robot_of(replace(record, estimates=some), tmp_path))
    assert "sensor.position_delay" not in made.calibration.ranges
    assert "sensor.position_delay" not in made.calibration.correlated
    assert read(load_model(out), "sensor.position_delay") == 0.0043


def test_what_the_robots_logs_do_not_speak_of_stays_the_benchs(model_dir, fits, robot_record, tmp_path):
    """A scale that was not excited replaces neither value nor range of the bench fit it stood on."""
    record = robot_record(fits)
    some = [replace(one, verdict="not excited") if one.name in ("mx106.gain_scale", "mx106.kp") else one
            for one in record.estimates]  # fmt: skip
    made, out = published(fits, model_dir, robot_of(replace(record, estimates=some), tmp_path))
    assert read(load_model(out), "mx106.kp") == base_of(fits[0])["mx106.kp"]
    assert "robot fit" not in made.calibration.ranges["mx106.kp"].origin
    assert "mx106.kp: its logs do not speak of it" in made.xml
    assert read(load_model(out), "mx106.damping") == 1.08 * base_of(fits[0])["mx106.damping"]


def test_a_command_delay_below_a_step_is_named(model_dir, robot_record, tmp_path):
    """MuJoCo acts on it as on a whole step, and the head of the model says so."""
    record = robot_record()
    some = [replace(one, value=0.0007, low=0.0, high=0.001) if one.name == "mx64.delay" else one
            for one in record.estimates]  # fmt: skip
    made, _ = published([], model_dir, robot_of(replace(record, estimates=some), tmp_path))
    assert "mx64.delay = 0.7 ms: MuJoCo acts on it as on 2 ms" in made.xml
    assert "mx106.delay = 37.1 ms: MuJoCo" not in made.xml


def test_draws_move_together(model_dir, robot_record, tmp_path):
    """Correlated delays are drawn together, and all that one scale multiplies as one."""
    calibration = published([], model_dir, robot_of(robot_record(), tmp_path))[0].calibration
    rng = np.random.default_rng(0)
    draws = [calibration.sample(rng) for _ in range(2000)]

    def share(name):
        one = calibration.ranges[name]
        return (np.array([draw[name] for draw in draws]) - one.low) / (one.high - one.low)

    np.testing.assert_allclose(share("mx106.kp"), share("mx106.forcerange"), atol=1e-6)
    assert np.corrcoef(share("sensor.gyro_delay"), share("sensor.orientation_delay"))[0, 1] > 0.7
    assert np.corrcoef(share("mx106.kp"), share("mx106.damping"))[0, 1] < -0.5
    assert abs(np.corrcoef(share("mx106.kp"), share("left_knee.zero"))[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('ref="-0.0213"', 'ref="-0.0212"'),
        ('delay="0.0529"', 'delay="0.053"'),
        ('delay="0.0371"', 'delay="0.0372"'),
        ('mass="3.41"', 'mass="3.4"'),
        ('name="left_knee.velocity" joint="left_knee" delay="0.0317" nsample="40"',
         'name="left_knee.velocity" joint="left_knee" delay="0.0317" nsample="16"'),
        ('kp="19.53"', 'kp="19.5"'),
        ('mass="0.257265"', 'mass="0.26"'),
        ('noslip_iterations="1"', 'noslip_iterations="0"'),
        ('data="15.0"', 'data="14.0"'),
        ('"servo_firmware_gain" data="12"', '"servo_firmware_gain" data="16"'),
        ('size="0.0308 0.0235 0.0015"', 'size="0.0308 0.0235 0.0016"'),
    ],
)  # fmt: skip
def test_a_number_that_was_altered(model_dir, robot_record, tmp_path, old, new):
    """Text that does not compile to the fitted numbers on the nominal robot is not published, whatever was altered."""
    robot, out = robot_of(robot_record(), tmp_path), model_dir / "calibrated.xml"
    made = publish([], model_dir / "nominal.xml", out, robot)
    assert old in made.xml
    with pytest.raises(QualityError, match="nothing was published"):
        write(replace(made, xml=made.xml.replace(old, new, 1)), model_dir / "nominal.xml", out)
    assert not out.exists()


def test_what_a_model_has_no_place_for(model_dir, robot_record, tmp_path):
    """Sensors without a history, and a joint that has a reference already, are named."""
    record, nominal, out = robot_record(), model_dir / "nominal.xml", model_dir / "calibrated.xml"
    measured = model_dir / "measurements_nominal.xml"
    text = measured.read_text()
    measured.write_text(re.sub(r'(<gyro [^>]*) nsample="40"', r'\1 nsample="0"', text).replace('delay="0.05"', ""))
    with pytest.raises(ModelError, match="no gyro sensor has a history"):
        publish([], nominal, out, robot_of(record, tmp_path))
    measured.write_text(text)
    bodies = model_dir / "sigmaban.xml"
    bodies.write_text(bodies.read_text().replace('<joint name="left_knee"', '<joint ref="0.1" name="left_knee"'))
    other = replace(record, model=mark_of(load_model(nominal)))
    with pytest.raises(ModelError, match=r"left_knee.*without ref"):
        publish([], nominal, out, robot_of(other, tmp_path))


def test_angles_in_degrees(model_dir, robot_record, tmp_path):
    """A model that is written in degrees gets its zeros in degrees."""
    bodies, nominal = model_dir / "sigmaban.xml", model_dir / "nominal.xml"
    bodies.write_text(re.sub(r'angle="radian" ', "", bodies.read_text()))
    text = re.sub(r' range="[^"]*"| ctrlrange="[^"]*"', "", bodies.read_text())
    bodies.write_text(text)
    robot = robot_of(robot_record(model=mark_of(load_model(nominal))), tmp_path)
    _, out = published([], model_dir, robot)
    assert read(load_model(out), "left_knee.zero") == pytest.approx(-0.0213, rel=1e-12)
    assert f'ref="{float(np.degrees(-0.0213))!r}"' in out.read_text()


def test_applying_what_was_published_changes_nothing(model_dir, fits, on_benches):
    """The model's own values, drawn or not, applied a hundred times leave every field as it was."""
    _, out = published(fits, model_dir, on_benches)
    model, fresh, calibration = load_model(out), load_model(out), load_calibration(out)
    rng = np.random.default_rng(0)
    for _ in range(100):
        apply(model, calibration.sample(rng))
    values = {name: read(fresh, name) for name in on_benches.published}
    apply(model, {**calibration.values(), **values})
    mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
    for field in ("qpos0", "body_mass", "body_inertia", "body_ipos", "sensor_delay", "actuator_delay", "numeric_data",
                  "dof_invweight0", "actuator_gainprm", "actuator_forcerange", "dof_damping"):  # fmt: skip
        np.testing.assert_allclose(getattr(model, field), getattr(fresh, field), rtol=1e-12, err_msg=field)


def run(capsys, *words):
    """Exit status, and what was said to people."""
    status = run_command(build_parser(), ["publish", *map(str, words)])
    return status, capsys.readouterr().err


def test_the_command(model_dir, robot_model_dir, fits, robot_record, tmp_path, capsys):
    """Bench fits and the robot's on one command line; what was replaced is said."""
    record = robot_record(fits)
    record.save(tmp_path / "robot.json")
    files = [robot_model_dir / "fits" / f"{servo}.json" for servo in ("mx106", "mx64")]
    out = model_dir / "calibrated.xml"
    status, text = run(capsys, *files, tmp_path / "robot.json", "--model", model_dir / "nominal.xml", "--out", out)
    assert status == 0, text
    kp = base_of(fits[0])["mx106.kp"]
    assert f"mx106.kp: the robot's fit in place of {kp:.6g} N m/rad of bench fit" in text
    assert "robot, not in this model: position delay" in text
    assert load_fits([*files, tmp_path / "robot.json"])[1].base == "fixed"
    assert read(load_model(out), "sensor.orientation_delay") == 0.0911


def test_hostile_files_are_one_line_and_status_3(model_dir, robot_record, tmp_path, capsys):
    """Not a number, a missing field, a wrong unit, another model, two robots: one clear line each, nothing written."""
    data = robot_record().to_json()
    model = ("--model", model_dir / "nominal.xml")

    def changed(name, change):
        other = json.loads(json.dumps(data))
        change(other)
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(other))
        return path

    good = changed("good", lambda one: None)
    bad = {
        "finite": [changed("nan", lambda one: one["parameters"]["trunk.mass"].update(nominal=float("nan")))],
        "frozen": [changed("missing", lambda one: one.pop("frozen"))],
        "expected \\[s\\]": [changed("unit", lambda one: one["parameters"]["sensor.gyro_delay"].update(unit="ms"))],
        "another model": [changed("model", lambda one: one["model"].update(fingerprint="0" * 16))],
        "two fits of a robot": [good, changed("second", lambda one: one.update(origin="real"))],
    }
    before = sorted(path.name for path in model_dir.iterdir())
    for words, files in bad.items():
        status, text = run(capsys, *files, *model)
        assert status == 3
        assert re.search(words, text), text
        assert text.count("\n") == 1
        assert sorted(path.name for path in model_dir.iterdir()) == before
    shutil.copy(good, tmp_path / "again.json")
    assert run(capsys, good, tmp_path / "again.json", *model)[0] == 3

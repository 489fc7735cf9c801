"""Parameter files of Rhoban/bam: read, compared, and written from fits."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from frasa_sysid import bam_parameters
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import run_command
from frasa_sysid.calibration.friction import COEFFICIENTS, LAWS, Friction, law_of
from frasa_sysid.cli import build_parser
from frasa_sysid.cost import misfit
from frasa_sysid.errors import InputError
from frasa_sysid.fit_json import SCHEMA
from frasa_sysid.problem import stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.rig import runs_of
from frasa_sysid.servo import NOMINAL, PUBLISHED_M4, servo
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stored_fit import StoredFit
from frasa_sysid.writer import write_mcap

# As Rhoban/bam publishes it (Apache-2.0), for the numbers that `PUBLISHED_M4` was copied from.
MX106_M4 = {
    "kt": 2.23138890457851, "R": 2.3717487904639545, "armature": 0.02457397334336701,
    "friction_base": 6.653380436533205e-13, "friction_stribeck": 0.10491060771568866,
    "load_friction_base": 0.009150334028953775, "load_friction_stribeck": 0.22235912179095094,
    "dtheta_stribeck": 1.6232949773728853, "alpha": 1.323485668999259, "friction_viscous": 0.05096082506010955,
    "model": "m4", "actuator": "mx106",
}  # fmt: skip
KNOWN = {
    "load_friction_motor": "load_motor", "load_friction_external": "load_external",
    "load_friction_motor_stribeck": "load_motor_stribeck", "load_friction_external_stribeck": "load_external_stribeck",
    "load_friction_motor_quad": "quad_motor", "load_friction_external_quad": "quad_external",
    "friction_base": "coulomb", "friction_stribeck": "stribeck", "friction_viscous": "viscous",
    "dtheta_stribeck": "stribeck_speed", "alpha": "stribeck_exponent",
}  # fmt: skip
RICH = Friction(0.05, 0.11, 0.07, 0.03, 0.04, 0.13, 0.17, 0.006, 0.009, 1.5, 1.3)


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def written(path, data):
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


def friction_of(law):
    """The rich coefficients, those that a law does not have at zero, those that follow another one alike."""
    own = [name.partition("=") for name in COEFFICIENTS[law]]
    return replace(Friction(RICH.viscous, RICH.coulomb), **{n: getattr(RICH, lead or n) for n, _, lead in own})


def fit_of(law="m4", name="mx106", drop=(), **change):
    """A fit of a servo whose kt is 1.9 and R 2.4, stated at 12.5 V and gain 20, before `change`."""
    known = replace(servo(name), supply_voltage=12.5, firmware_gain=20.0, kt=1.9, R=2.4, friction=friction_of(law))
    values = {
        f"{name}.kp": known.kp(), f"{name}.forcerange": known.force_limit(), f"{name}.damping": known.damping(),
        f"{name}.damping_off": RICH.viscous, f"{name}.frictionloss": RICH.coulomb, f"{name}.armature": 0.021,
        f"{name}.delay": 0.008, "bench.offset": 0.014, **{f"{name}.{key}": value for key, value in change.items()},
    }  # fmt: skip
    parameters = {one: {"value": value} for one, value in values.items() if one.partition(".")[2] not in drop}
    stated = {"supply_voltage": 12.5, "firmware_gain": 20.0}
    return StoredFit(name, parameters, (), np.zeros((0, 0)), stated, {}, "real", "", law, known.friction)


def test_the_published_file_is_the_published_servo(tmp_path):
    found = bam_parameters.read(written(tmp_path / "m4.json", MX106_M4))
    assert found.law == law_of(found.servo.friction) == "m4"
    published = PUBLISHED_M4["mx106"]
    assert asdict(found.servo.friction) == pytest.approx(asdict(published.friction), rel=1e-12)
    assert replace(found.servo, friction=published.friction, source=published.source) == published
    assert (found.offset, found.goal_speed) == (0.0, None)


@pytest.mark.parametrize("key", sorted(KNOWN))
def test_each_coefficient_has_its_place(tmp_path, key):
    """Of M6, where every coefficient has a key of its own: the quadratic ones are not crossed."""
    data = {"kt": 1.0, "R": 2.0, "armature": 0.01, "model": "m6", "actuator": "mx64", **dict.fromkeys(KNOWN, 0.5)}
    friction = bam_parameters.read(written(tmp_path / "a.json", {**data, key: 0.75})).servo.friction
    changed = {name for name, value in asdict(friction).items() if value == 0.75}
    assert changed == {KNOWN[key]}
    # The load's square counts while the motor is the stronger, as BAM's key says it with the other name.
    only = replace(Friction(0.0, 0.0), quad_external=0.01)
    assert only.bound(np.array(3.0), np.array(-2.0), np.array(0.0)) == pytest.approx(0.04)
    assert only.bound(np.array(2.0), np.array(-3.0), np.array(0.0)) == 0.0


@pytest.mark.parametrize("law", LAWS)
def test_a_fit_comes_back_as_it_was(tmp_path, law):
    exported = bam_parameters.export(fit_of(law))
    found = bam_parameters.read(written(tmp_path / "a.json", exported.data))
    assert (found.servo.kt, found.servo.R) == pytest.approx((1.9, 2.4), rel=1e-12)
    assert (found.law, found.servo.armature, found.offset) == (law, 0.021, 0.014)
    assert found.servo.friction == friction_of(law)
    assert [note for note in exported.notes if "8 ms" in note] == list(exported.notes)
    unknown = set(exported.data) - {"kt", "R", "armature", "q_offset", "model", "actuator"}
    assert all(key.startswith(("friction_", "load_friction_", "dtheta_", "alpha")) for key in unknown)


def test_gain_and_limit_that_disagree():
    """The mx of BAM has one kt/R, and the gain is the one that is kept; the sts has a factor for it."""
    whole = fit_of(kp=1.1 * fit_of().parameters["mx106.kp"]["value"])
    exported = bam_parameters.export(whole)
    assert exported.data["kt"] / exported.data["R"] == pytest.approx(1.1 * 1.9 / 2.4, rel=1e-12)
    assert exported.data["kt"] ** 2 / exported.data["R"] == pytest.approx(1.9**2 / 2.4, rel=1e-12)
    assert "error_gain_ratio" not in exported.data
    limit = whole.parameters["mx106.forcerange"]["value"]
    assert any(f"{limit:.4g} N m becomes {1.1 * limit:.4g} N m" in note for note in exported.notes)


@pytest.mark.parametrize("name", ["sts3215", "sts3250"])
def test_the_factor_of_the_sts(tmp_path, name):
    whole = fit_of("m2", name, kp=1.3 * fit_of("m2", name).parameters[f"{name}.kp"]["value"], goal_speed=4.5)
    whole = replace(whole, not_in_model=("profile: the firmware limits the speed of the goal", "sag: the supply"))
    exported = bam_parameters.export(whole)
    assert exported.data["error_gain_ratio"] == pytest.approx(1.3, rel=1e-12)
    assert exported.data["actuator"] == "sts3215"
    assert [note.partition(":")[0] for note in exported.notes] == ["delay", "sag"]
    given = replace(servo(name), supply_voltage=12.5, firmware_gain=20.0)
    found = bam_parameters.read(written(tmp_path / "a.json", exported.data), given)
    assert found.servo.kp() == pytest.approx(whole.parameters[f"{name}.kp"]["value"], rel=1e-12)
    assert found.servo.force_limit() == pytest.approx(whole.parameters[f"{name}.forcerange"]["value"], rel=1e-12)
    assert found.goal_speed == 4.5


def test_a_goal_speed_that_the_sts_file_leaves_out(tmp_path):
    """BAM then takes 3400 counts a second; a fit without a limit must say so."""
    exported = bam_parameters.export(fit_of("m1", "sts3215"))
    assert bam_parameters.read(written(tmp_path / "a.json", exported.data)).goal_speed is None
    del exported.data["max_velocity"]
    assert bam_parameters.read(written(tmp_path / "a.json", exported.data)).goal_speed == pytest.approx(
        5.2155, rel=1e-4
    )


@pytest.mark.parametrize("gone", ["kp", "forcerange"])
def test_one_of_gain_and_limit_is_enough(gone):
    exported = bam_parameters.export(fit_of(drop=(gone,)))
    assert (exported.data["kt"], exported.data["R"]) == pytest.approx((1.9, 2.4), rel=1e-12)


def test_the_first_schema_has_no_law():
    """Its friction is K_c and, where the torque was never off, the published K_v."""
    old = replace(fit_of("m1", drop=("damping_off",)), law=None)
    assert bam_parameters.export(old).data["friction_viscous"] == NOMINAL["mx106"].friction.viscous
    assert bam_parameters.export(replace(fit_of("m1"), law=None)).data["friction_viscous"] == RICH.viscous


@pytest.mark.parametrize(
    ("fit", "words"),
    [
        (fit_of(name="miuzei"), "no actuator for 'miuzei'"),
        (fit_of(drop=("kp", "forcerange")), "kp and forcerange"),
        (fit_of(drop=("armature",)), "lacks armature"),
        (fit_of(damping=RICH.viscous), "no kt and R"),
        (fit_of(kp=0.0, forcerange=0.0), "no kt and R"),
        (fit_of("m1", "sts3215", forcerange=0.0), "no kt and R"),
    ],
)
def test_fits_without_words_in_bam(fit, words):
    with pytest.raises(InputError, match=words):
        bam_parameters.export(fit)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"model": "m7"}, "model = 'm7', expected m1"),
        ({"model": ["m1"]}, "expected m1"),
        ({"model": None}, "expected m1"),
        ({"actuator": "hal9000"}, "unknown actuator 'hal9000', expected mx106"),
        ({"actuator": ["x"] * 1000}, r"unknown actuator .*\.\.\., expected"),
        ({"actuator": "xl330i"}, "not driven by a voltage"),
        ({"actuator": "erob80_50"}, "not driven by a voltage"),
        ({"kt": None}, "'kt' is missing"),
        ({"R": 0.0}, "R = 0.0"),
        ({"R": True}, "R = True"),
        ({"kt": math.nan}, "kt = nan"),
        ({"kt": math.inf}, "kt = inf"),
        ({"kt": 10**400}, "kt = 1000"),
        ({"friction_base": "0.1"}, "friction_base = '0.1'"),
        ({"friction_viscous": -1e-3}, "friction_viscous = -0.001"),
        ({"dtheta_stribeck": 0.0}, "dtheta_stribeck = 0.0"),
        ({"load_friction_stribeck": None}, "'load_friction_stribeck' is missing; the law 'm4'"),
        ({"armature": -1.0}, "armature = -1.0"),
        ({"error_gain_ratio": 0.0}, "error_gain_ratio = 0.0"),
        ({"q_offset": -9.0}, "q_offset = -9.0"),
    ],
)
def test_files_that_cannot_be(tmp_path, change, words):
    data = {key: value for key, value in {**MX106_M4, **change}.items() if value is not None}
    with pytest.raises(InputError, match=words) as caught:
        bam_parameters.read(written(tmp_path / "a.json", data))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    "content", ["", "[1]", "{", '{"kt": 1' + "0" * 5000 + "}", "[" * 100_000, "\xff", " " * 1_000_001]
)
def test_files_that_are_none(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=r"not a BAM|larger"):
        bam_parameters.read(tmp_path / "a.json")
    with pytest.raises(InputError, match="no BAM parameter file"):
        bam_parameters.read(tmp_path / "b.json")


@pytest.fixture(scope="module")
def log(robot_model_dir, tmp_path_factory):
    path = tmp_path_factory.mktemp("bam") / "log.mcap"
    write_mcap(path, read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[1::12])
    return path


def test_compare_simulates_it(log, robot_model_dir, tmp_path, capsys):
    """Beside nominal, at the bench's own supply and gain, without a delay: as told here by hand."""
    known, _ = stated_servo("mx106", robot_model_dir / "nominal.xml")
    one = replace(PUBLISHED_M4["mx106"], supply_voltage=known.supply_voltage, firmware_gain=known.firmware_gain)
    shared = {key: value for key, value in asdict(one.friction).items() if key not in ("viscous", "coulomb")}
    values = ServoValues(
        one.kp(), one.force_limit(), one.damping(), one.friction.viscous, one.friction.coulomb, one.armature,
        delay=0.0, offset=0.013, **shared,
    )  # fmt: skip
    with BenchSession(robot_model_dir / "bench_pendulum.xml", known, threads=2) as session:
        runs = runs_of(read_log(log), known, session.options.timestep)
        kernel = session.kernel(runs)
        expected = misfit(runs, kernel.split(kernel.readings(values.array()[None])[0]))
    path = written(tmp_path / "m4.json", {**MX106_M4, "q_offset": -0.013})
    other = written(tmp_path / "other.json", {**MX106_M4, "kt": 1.5})
    words = (
        "compare",
        log,
        "--model",
        robot_model_dir / "nominal.xml",
        "--bam",
        other,
        "--bam",
        path,
        "--no-report",
        "--json",
    )
    assert frasa(*words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["candidates"]["m4.json"]["by_log"] == pytest.approx(expected.by_run, rel=1e-9)
    assert found["misfit"] == found["candidates"]["m4.json"] != found["candidates"]["other.json"]
    assert set(found["candidates"]) == {"nominal", "m4.json", "other.json"}


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [({"actuator": "mx64"}, 2, "of mx64"), ({"kt": "x"}, 3, "kt = 'x'"), ({"model": "m9"}, 3, "model")],
)
def test_compare_refuses_in_one_line(log, robot_model_dir, tmp_path, capsys, change, status, words):
    path = written(tmp_path / "a.json", {**MX106_M4, **change})
    assert frasa("compare", log, "--model", robot_model_dir / "nominal.xml", "--bam", path, "--no-report") == status
    lines = capsys.readouterr().err.strip().splitlines()
    assert words in lines[-1]
    assert not any("Traceback" in line for line in lines)


def fit_file(path):
    """The fit of `fit_of` as a file."""
    one = fit_of()
    units = {"kp": "N m/rad", "forcerange": "N m", "frictionloss": "N m", "armature": "kg m^2", "delay": "s",
             "offset": "rad", "damping": "N m s/rad", "damping_off": "N m s/rad"}  # fmt: skip
    parameters = {
        name: {**dict.fromkeys(("value", "low", "high", "spread_low", "spread_high"), content["value"]),
               "unit": units[name.partition(".")[2]], "verdict": "identified"}
        for name, content in one.parameters.items()
    }  # fmt: skip
    return written(path, {
        "schema": SCHEMA, "servo": one.servo, "friction": "m4", "origin": "real", "stated_at": one.stated,
        "parameters": parameters, "law": asdict(one.law), "correlation": {"names": [], "matrix": []}, "inputs": {},
    })  # fmt: skip


def test_export_command(tmp_path, capsys):
    fit, out = fit_file(tmp_path / "mx106.json"), tmp_path / "new" / "m4.json"
    assert frasa("export-bam", fit, "--out", out, "--json") == 0
    printed, said = capsys.readouterr()
    assert json.loads(out.read_text()) == json.loads(printed)["parameters"] == bam_parameters.export(fit_of()).data
    assert "not in it: delay: 8 ms" in said
    assert [path.name for path in out.parent.iterdir()] == ["m4.json"]
    assert frasa("export-bam", fit, "--out", out) == 0
    assert capsys.readouterr().out == ""


def test_export_command_refuses(tmp_path, capsys):
    """Nothing is written then, and what was there stays."""
    fit, out = fit_file(tmp_path / "mx106.json"), written(tmp_path / "m4.json", "old")
    broken = written(tmp_path / "broken.json", "{}")
    for words, status in (
        ((fit, "--out", fit), 2),
        ((fit, "--out", tmp_path / "m4.txt"), 2),
        ((tmp_path / "none.json", "--out", out), 3),
        ((broken, "--out", out), 3),
    ):
        assert frasa("export-bam", *words) == status
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert out.read_text() == "old"
    assert json.loads(fit.read_text())["servo"] == "mx106"

import argparse
import hashlib
import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest

from frasa_sysid import stored_fit
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import SERVO_FIELDS, run_command
from frasa_sysid.calibration.friction import FIELDS
from frasa_sysid.cli import build_parser
from frasa_sysid.commands import compare
from frasa_sysid.cost import misfit
from frasa_sysid.fit import fit
from frasa_sysid.fit_record import Extras, save, to_json
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.publish import publish, write
from frasa_sysid.readers import read_log
from frasa_sysid.rig import runs_of
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.writer import write_mcap


@pytest.fixture(scope="session")
def place(robot_model_dir, tmp_path_factory):
    """Nominal models, a log of six runs of three rigs, and a small fit of them: M4 with sag and a zero for each rig."""
    folder = tmp_path_factory.mktemp("compare")
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, folder)
    write_mcap(folder / "log.mcap", read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[1::6])
    servo, nominal = stated_servo("mx106", folder / "nominal.xml")
    with BenchSession(folder / "bench_pendulum.xml", servo, threads=2) as session:
        runs = runs_of(read_log(folder / "log.mcap"), servo, session.options.timestep)
        problem = state_problem(
            servo, nominal, runs, (), session.delay_range, law="m4", effects=("sag", "offsets", "punch")
        )
        result = fit(problem, session, {}, evaluations=20, restarts=1, known=(np.full(len(problem.free), 0.2),))
        assert len({run.rig for run in runs}) == 3
        (folder / "fits").mkdir()
        save(folder / "fits" / "mx106.json", to_json(result, Extras("simulated")))
        yield folder, result, session, runs


def compared(capsys, *words):
    """What `compare` prints for machines."""
    quiet = () if "--report" in words else ("--no-report",)
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    compare.add_parser(parser.add_subparsers(required=True))
    status = run_command(parser, ["compare", *(str(word) for word in words), *quiet, "--json"])
    out, err = capsys.readouterr()
    assert status == 0, err
    return json.loads(out)


def test_a_fit_file_is_simulated_as_it_was_fitted(place, capsys):
    """Law, coefficients that follow another one, effects and the zero of each rig all reach the simulation."""
    folder, result, _, _ = place
    values = result.problem.servo_values(result.values)
    assert values.load_external == values.load_motor > 0.0
    assert values.load_external_stribeck == values.load_motor_stribeck > 0.0
    assert any(one.rig and value != 0.0 for one, value in zip(result.problem.free, result.values, strict=True))
    path = folder / "fits" / "mx106.json"
    found = compared(capsys, folder / "log.mcap", "--model", folder / "nominal.xml", "--fit", path)
    assert found["candidates"]["mx106.json"]["by_log"] == pytest.approx(result.fitted.by_run, abs=1e-12)
    assert found["candidates"]["nominal"]["by_log"] == pytest.approx(result.nominal.by_run, abs=1e-12)
    assert found["misfit"] == found["candidates"]["mx106.json"]


def test_a_fit_stated_elsewhere_is_the_same_servo(place, capsys, tmp_path):
    """Gain and torque limit that were stated at another supply and firmware gain are brought to the bench's."""
    folder, result, _, _ = place
    data = json.loads((folder / "fits" / "mx106.json").read_text())
    data["stated_at"]["supply_voltage"] *= 0.5
    data["stated_at"]["firmware_gain"] *= 2.0
    for key in stored_fit.load(folder / "fits" / "mx106.json").parameters["mx106.kp"].keys() - {"unit", "verdict"}:
        data["parameters"]["mx106.forcerange"][key] *= 0.5
    (tmp_path / "other.json").write_text(json.dumps(data))
    words = ("--model", folder / "nominal.xml", "--fit", tmp_path / "other.json")
    found = compared(capsys, folder / "log.mcap", *words)
    assert found["misfit"]["by_log"] == pytest.approx(result.fitted.by_run, rel=1e-9)


def test_a_model_with_a_friction_law(place, capsys):
    """The law in a model's custom numbers is simulated; one that was not published from a fit is lent nothing of it."""
    folder, result, session, runs = place
    values = result.problem.servo_values(result.values)
    law = values.friction()
    numbers = " ".join(f"{value!r}" for value in asdict(law).values())
    text = (folder / "nominal.xml").read_text()
    custom = f'<custom><numeric name="mx106_friction" data="{numbers}"/></custom></mujoco>'
    (folder / "law.xml").write_text(text.replace("</mujoco>", custom))
    _, nominal = stated_servo("mx106", folder / "nominal.xml")
    shared = {name: value for name, value in asdict(law).items() if name not in ("viscous", "coulomb")}
    expected = replace(ServoValues(**nominal), **shared, damping_off=law.viscous, frictionloss=law.coulomb)
    kernel = session.kernel(runs)
    errors = misfit(runs, kernel.split(kernel.readings(expected.array()[None], None)[0]))
    words = ("--model", folder / "nominal.xml", "--with-model", folder / "law.xml")
    found = compared(capsys, folder / "log.mcap", *words)
    assert found["misfit"]["by_log"] == pytest.approx(errors.by_run, abs=1e-12)
    assert found["misfit"]["mae_rad"] != pytest.approx(found["candidates"]["nominal"]["mae_rad"])


def test_a_nominal_model_is_nominal(place, capsys):
    """A fit that lies beside a model lends it nothing."""
    folder = place[0]
    words = ("--model", folder / "nominal.xml", "--with-model", folder / "nominal.xml")
    found = compared(capsys, folder / "log.mcap", *words)["candidates"]
    assert found["nominal"] == found["nominal.xml"]


def test_a_published_model_has_the_zeros_of_its_own_fit(place, capsys, tmp_path):
    """They come from the fit it was published from, beside it or named, and from no other; a line says what lacks."""
    folder, result, session, runs = place
    fit_file, nominal, model = folder / "fits" / "mx106.json", folder / "nominal.xml", tmp_path / "own" / "cal.xml"
    write(publish([stored_fit.load(fit_file)], nominal, model), nominal, model)
    values = result.problem.servo_values(result.values)
    # Effects stay off; their neutral values are those of a servo without.
    plain = ServoValues(**stated_servo("mx106", nominal)[1])
    known = {one: getattr(values, one) for one in (*SERVO_FIELDS, *FIELDS, "damping_off") if hasattr(values, one)}
    bare = replace(plain, **known)
    zeros = result.problem.offsets(result.problem.to_unit(result.values)[None], runs)
    kernel = session.kernel(runs)

    def by_run(servo, zeros):
        return misfit(runs, kernel.split(kernel.readings(servo.array()[None], zeros)[0])).by_run

    without, full = by_run(bare, None), by_run(replace(bare, offset=values.offset), zeros)
    assert np.abs(np.subtract(list(without.values()), list(full.values()))).max() > 1e-4

    def row(*more):
        parser = argparse.ArgumentParser(prog="frasa-sysid")
        compare.add_parser(parser.add_subparsers(required=True))
        words = [folder / "log.mcap", "--model", nominal, "--with-model", model, *more, "--no-report", "--json"]
        assert run_command(parser, ["compare", *map(str, words)]) == 0
        out, err = capsys.readouterr()
        return json.loads(out)["candidates"]["cal.xml"]["by_log"], err

    named, err = row("--fit", fit_file)
    assert named == pytest.approx(full, abs=1e-9)
    assert "nominal, for" not in err
    shutil.copytree(folder / "fits", model.parent / "fits")
    assert row()[0] == named
    other = model.parent / "fits" / "mx106.json"
    other.write_text(other.read_text() + "\n")  # a fit of the same servo, but not the one it was published from
    found, err = row()
    assert found == pytest.approx(without, abs=1e-9)
    assert err.splitlines()[0] == (
        f"{model}: zero of the encoder is nominal, for its fit {stored_fit.load(fit_file).sha256[:12]} is neither in "
        f"{model.parent / 'fits'} nor given with --fit"
    )
    model.with_name("randomization.yaml").unlink()
    found, err = row("--fit", fit_file)
    assert found == pytest.approx(without, abs=1e-9)
    assert f"{model}: zero of the encoder is nominal, for there is no " in err


def test_the_page_of_a_comparison(place, capsys, tmp_path, page_text):
    """Errors, traces, residuals and numbers of every candidate, and what they rest on."""
    pytest.importorskip("matplotlib")
    folder, result, _, _ = place
    page = tmp_path / "page.html"
    words = ("--model", folder / "nominal.xml", "--fit", folder / "fits" / "mx106.json", "--report", page)
    found = compared(capsys, folder / "log.mcap", *words)
    assert found["outputs"]["report"] == str(page)
    text = page_text(page)
    for words in ("Simulated over measured", "Residuals", "Error of every run", "Numbers of the candidates"):
        assert words in text
    for name, one in found["candidates"].items():
        assert f"{one['mae_rad'] * 1e3:.2f} mrad" in text
        assert f"{name}, mrad" in text
        assert all(f"{error * 1e3:.1f}" in text for error in one["by_log"].values())
    assert f"{result.problem.servo_values(result.values).kp:.4g}" in text
    assert hashlib.sha256((folder / "log.mcap").read_bytes()).hexdigest() in text
    assert str(folder) not in text


def test_a_page_is_left_unless_nobody_wants_it(place, capsys, tmp_path, monkeypatch):
    """Without a name it is compare.html where one works; with --no-report there is none."""
    pytest.importorskip("matplotlib")
    folder = place[0]
    words = ["compare", str(folder / "log.mcap"), "--model", str(folder / "nominal.xml")]
    monkeypatch.chdir(tmp_path)
    assert run_command(build_parser(), [*words, "--no-report"]) == 0
    assert not list(tmp_path.iterdir())
    assert run_command(build_parser(), words) == 0
    assert "report: compare.html" in capsys.readouterr().err
    assert [one.name for one in tmp_path.iterdir()] == ["compare.html"]


def test_measured_and_simulated_side_by_side(place, capsys, tmp_path):
    """One MCAP has both on topics of their own; read again, the simulated ones stay beside the measured ones."""
    folder, _, _, _ = place
    out = tmp_path / "both.mcap"
    words = ("--model", folder / "nominal.xml", "--fit", folder / "fits" / "mx106.json", "--mcap", out)
    found = compared(capsys, folder / "log.mcap", *words)
    assert found["outputs"]["mcap"] == str(out)
    measured, both = read_log(folder / "log.mcap"), read_log(out)
    assert len(both) == len(measured)
    for one, other in zip(measured, both, strict=True):
        np.testing.assert_array_equal(other.signal("position").y, one.signal("position").y)
        for name, topic in (("mx106.json", "/sim/joint_states"), ("nominal", "/sim/nominal/joint_states")):
            simulated = other.signal(f"position@{topic}")
            np.testing.assert_allclose(simulated.t, one.signal("position").t, atol=1e-9)
            error = np.abs(simulated.y - one.signal("position").y).mean()
            assert error == pytest.approx(found["candidates"][name]["by_log"][one.name], rel=1e-6)
        assert other.extra["simulated"] == {"nominal": "/sim/nominal/", "mx106.json": "/sim/"}
    again = compared(capsys, out, *words[:4])
    assert list(again["misfit"]["by_log"].values()) == pytest.approx(list(found["misfit"]["by_log"].values()), rel=1e-6)
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    compare.add_parser(parser.add_subparsers(required=True))
    assert run_command(parser, ["compare", *map(str, (out, *words[:4], "--mcap", out))]) == 2
    assert "is one of the logs" in capsys.readouterr().err

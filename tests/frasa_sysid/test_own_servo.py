"""A servo that does not come with frasa, from its table to a calibrated model of its bench, through the commands."""

import json
import shutil
from dataclasses import replace

import pytest

from frasa_sysid.calibration import load_calibration, load_model, read, run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.recording import Signal
from frasa_sysid.servo import read_servo
from frasa_sysid.simulate import simulate_bench, truth_of
from frasa_sysid.simulated_bench import bench_for
from frasa_sysid.writer import write_mcap

TABLE = """
schema = "frasa.servo/1"
name = "rocket9"
source = "a servo that nobody makes"
[firmware]
position_gain = 40
gain_divisor = 16
full_duty = 1023
ticks_per_turn = 8192
max_duty = 0.9
supply_compensated = {compensated}
[supply]
voltage = {{ value = 11.1, unit = "V" }}
[motor]
stall_torque = {{ value = {stall}, unit = "kg cm", low = 20, high = 60 }}
no_load_speed = {{ value = {speed}, unit = "rpm" }}
"""
TRUTH, GUESS = {"stall": 32.0, "speed": 63.0}, {"stall": 45.0, "speed": 50.0}


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def _table(path, compensated="false", **numbers):
    path.write_text(TABLE.format(compensated=compensated, **numbers))
    return path


def _logs(table, out, **changes):
    """Eight runs of 4 s of that servo on a stiff supply."""
    truth = read_servo(table).servo
    usual = bench_for(truth)
    bench = replace(usual, loads=usual.loads[1:2], gains=usual.gains[:2], **{"supply_resistance": 0.0, **changes})
    made = [_cut(one, 4.0) for one in simulate_bench(truth, bench, out.name)]
    write_mcap(out, made)
    return truth_of(truth, bench)


def _cut(recording, end):
    signals = {
        name: Signal(name, one.unit, one.t[one.t < end], one.y[one.t < end]) for name, one in recording.signals.items()
    }
    return replace(recording, signals=signals)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Logs of a true servo, and a folder with its bench as somebody guesses the servo."""
    folder = tmp_path_factory.mktemp("own")
    truth = _logs(_table(folder / "truth.toml", **TRUTH), folder / "rocket9.mcap")
    _table(folder / "guess.toml", **GUESS)
    assert frasa("servos", folder / "guess.toml", "--bench", folder / "bench") == 0
    return folder, truth


def test_from_logs_to_a_bench_model(place, capsys):
    """The truth is found within the intervals (kp to 1 %), published into the bench's model, and simulates the logs."""
    folder, truth = place
    words = ("--servo", folder / "guess.toml", "--model", folder / "bench" / "nominal.xml")
    log = folder / "rocket9.mcap"
    few = ("--evaluations", 400, "--restarts", 1, "--threads", 1, "--no-report", "--json")
    assert frasa("fit", log, *words, "--publish", "--hold-out", "trajectory=sin_sin", *few) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["servo"] == "rocket9"
    for name in ("kp", "damping", "armature", "frictionloss", "forcerange"):
        one = found["parameters"][f"rocket9.{name}"]
        expected = truth.get(f"rocket9.{name}", truth["friction.coulomb"])
        if one["verdict"] == "identified":
            assert one["value"] == pytest.approx(expected, rel=0.02), name
    assert found["parameters"]["rocket9.kp"]["value"] == pytest.approx(truth["rocket9.kp"], rel=0.01)
    assert found["parameters"]["rocket9.kp"]["verdict"] == "identified"
    assert found["misfit"]["held_out"]["mae_rad"] < 0.05 * found["misfit"]["held_out_nominal"]["mae_rad"]

    calibrated = folder / "bench" / "calibrated.xml"
    assert read(load_model(calibrated), "rocket9.kp") == found["mujoco"]["kp"]
    assert "rocket9.kp" in load_calibration(calibrated).ranges
    assert frasa("compare", log, *words, "--with-model", calibrated, "--no-report", "--json", "--threads", 1) == 0
    errors = json.loads(capsys.readouterr().out)["candidates"]
    assert errors["calibrated.xml"]["mae_rad"] < 0.001 < 0.02 < errors["nominal"]["mae_rad"]


def test_a_table_beside_the_model_is_known_by_its_name(place, capsys, tmp_path):
    """In the folder `servos` beside a model the name that the logs give is enough."""
    folder, _ = place
    shutil.copytree(folder / "bench", tmp_path / "bench")
    (tmp_path / "bench" / "servos").mkdir()
    shutil.copy(folder / "guess.toml", tmp_path / "bench" / "servos" / "rocket9.toml")
    words = (folder / "rocket9.mcap", "--model", tmp_path / "bench" / "nominal.xml", "--no-report", "--json")
    assert frasa("compare", *words, "--threads", 1) == 0
    assert json.loads(capsys.readouterr().out)["servo"] == "rocket9"
    shutil.rmtree(tmp_path / "bench" / "servos")
    assert frasa("compare", *words) == 2
    assert "unknown servo 'rocket9'" in capsys.readouterr().err


def test_inspect_counts_saturation_by_the_table(place, capsys):
    """Whether the torque limit shows depends on the servo's own gain and duty limit."""
    folder, _ = place
    assert frasa("inspect", folder / "rocket9.mcap", "--servo", folder / "guess.toml", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert {one["servo"] for one in told["identifiable"]} == {"rocket9"}
    assert frasa("inspect", folder / "rocket9.mcap", "--servo", "rocket10") == 2


def test_a_table_stands_for_the_servo_that_logs_name(place, capsys, tmp_path):
    """That is said, in one line, by all that look at logs; a name that contradicts them is refused."""
    folder, _ = place
    table = tmp_path / "mine.toml"
    table.write_text((folder / "guess.toml").read_text().replace('name = "rocket9"', 'name = "mine"'))
    log, few = folder / "rocket9.mcap", ("--model", folder / "bench" / "nominal.xml", "--threads", 1, "--no-report")
    short = (*few, "--evaluations", 1, "--restarts", 1, "--out", tmp_path / "fit.json")
    for words in (("inspect", log), ("compare", log, *few), ("fit", log, *short)):
        assert frasa(*words, "--servo", table) == 0
        line = f"the logs say rocket9; the numbers are those of mine, from {table}"
        assert capsys.readouterr().err.count(line) == 1
        assert frasa(*words, "--servo", "mx64") == 2
        assert "the logs say rocket9, --servo says mx64" in capsys.readouterr().err
        assert frasa(*words, "--servo", folder / "guess.toml") == 0
        assert "the logs say" not in capsys.readouterr().err


def test_bounds_of_the_table_hold_in_the_fit(place, capsys):
    """A number that the truth lies outside of ends on its bound, and is not called identified."""
    folder, _ = place
    text = (folder / "guess.toml").read_text()
    narrow = folder / "narrow.toml"
    narrow.write_text(text + '[joint]\narmature = { value = 0.09, unit = "kg m^2", low = 0.08, high = 0.1 }\n')
    few = ("--evaluations", 100, "--restarts", 1, "--threads", 1, "--no-report", "--json", "--out", folder / "n.json")
    model = folder / "narrow_bench" / "nominal.xml"
    assert frasa("servos", narrow, "--bench", model.parent) == 0
    assert frasa("fit", folder / "rocket9.mcap", "--servo", narrow, "--model", model, *few) == 0
    one = json.loads(capsys.readouterr().out)["parameters"]["rocket9.armature"]
    assert one["value"] == pytest.approx(0.08)
    assert one["verdict"] != "identified"
    # A model that says something else than the table allows is wrong, or the table is.
    usual = folder / "bench" / "nominal.xml"
    assert frasa("fit", folder / "rocket9.mcap", "--servo", narrow, "--model", usual, *few) == 3
    assert "its servo table allows 0.08 to 0.1: one of the two is wrong" in capsys.readouterr().err


def test_a_supply_that_the_firmware_makes_up_for(tmp_path, capsys):
    """Logs at 8 V of a compensated servo stated at 11.1 V: its gain comes out unscaled; no range of supply."""
    truth = _logs(_table(tmp_path / "c.toml", "true", **TRUTH), tmp_path / "low.mcap", supply_voltage=8.0)
    _table(tmp_path / "same.toml", "true", **TRUTH)
    words = ("--servo", tmp_path / "same.toml", "--evaluations", 60, "--restarts", 1, "--threads", 1)
    assert frasa("servos", tmp_path / "same.toml", "--bench", tmp_path / "bench") == 0
    model = tmp_path / "bench" / "nominal.xml"
    assert frasa("fit", tmp_path / "low.mcap", *words, "--model", model, "--no-report", "--json", "--publish") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["mujoco"]["kp"] == pytest.approx(truth["rocket9.kp"], rel=0.01)
    assert "supply_voltage" not in found.get("from_logs", {})
    assert "supply_voltage" not in load_calibration(tmp_path / "bench" / "calibrated.xml").ranges


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["--bench", "X"], 2, "--bench: expected one servo that turns"),
        (["emps", "--bench", "X"], 2, "expected one servo that turns"),
        (["mx28"], 2, "unknown servo 'mx28': known are"),
        (["--like", "mx64"], 2, "--like goes with --new"),
        (["mx64", "--new", "mx28"], 2, "--new goes with --like only"),
    ],
)
def test_words_that_do_not_go_together(words, status, message, capsys, tmp_path, monkeypatch):
    """One line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    assert frasa("servos", *words) == status
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_known_servos_are_listed(capsys):
    """Every servo with what it comes to in MuJoCo's terms."""
    assert frasa("servos", "--json") == 0
    listed = {one["name"]: one for one in json.loads(capsys.readouterr().out)["servos"]}
    assert listed["mx106"]["mujoco"]["kp"] == pytest.approx(21.0, rel=0.01)
    assert "datasheet" in listed["sts3250"]["source"]

import html
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frasa_sysid.calibration import load_calibration, load_model, read, run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.identifiability import findings, next_logs
from frasa_sysid.inspection import motions
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.stored_fit import load
from frasa_sysid.writer import write_mcap

KEYS = {
    "schema",
    "servo",
    "friction",
    "effects",
    "not_in_model",
    "parameters",
    "mujoco",
    "law",
    "torque_off",
    "profiles",
    "misfit",
    "restarts",
    "multimodal",
    "evaluations",
    "seconds",
    "seed",
    "outputs",
}


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def cut(recording, end):
    """The first seconds of a run."""
    signals = {
        name: Signal(name, one.unit, one.t[one.t < end], one.y[one.t < end]) for name, one in recording.signals.items()
    }
    return replace(recording, signals=signals)


@pytest.fixture(scope="session")
def few(robot_model_dir):
    """Four short runs of the project's own bench log: two trajectories at two gains."""
    every = read_log(robot_model_dir.parent / "bench_logs" / "mx64.mcap")
    chosen = [
        one
        for one in every
        if one.rig.mass == 0.31 and one.rig.firmware_gain != 16.0 and one.rig.trajectory in ("lift_and_drop", "sin_sin")
    ]
    assert len(chosen) == 4
    return [cut(one, 2.6) for one in chosen]


@pytest.fixture
def place(robot_model_dir, tmp_path, few):
    """A copy of the nominal robot model, and a log beside it."""
    folder = tmp_path / "robot_model"
    folder.mkdir()
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, folder)
    write_mcap(tmp_path / "few.mcap", few)
    return tmp_path


def fit_words(place, *more, log="few.mcap"):
    log = place / log if isinstance(log, str) else log
    return ["fit", log, "--model", place / "robot_model" / "nominal.xml", "--evaluations", 20, *more]


@pytest.mark.parametrize("frozen", [(), ("0" * 64,)])
def test_a_new_bench_fit_leaves_the_robots_out(place, capsys, robot_record, frozen):
    """A fit of the robot that did not stand on the new bench fit is named, not published, and not touched."""
    beside = place / "robot_model" / "fits" / "robot.json"
    robot_record(frozen=frozen).save(beside)
    content = beside.read_bytes()
    assert frasa(*fit_words(place, "--publish")) == 0
    assert "the fit of the robot is left out" in capsys.readouterr().err
    assert beside.read_bytes() == content
    assert read(load_model(place / "robot_model" / "calibrated.xml"), "left_knee.zero") == 0.0


def test_fit_and_publish(place, capsys):
    """One command from a log to a calibrated model: everything promised is printed, everything named exists."""
    before = (place / "robot_model" / "nominal.xml").read_bytes()
    assert frasa(*fit_words(place, "--publish", "--json", "--hold-out", "kp=8")) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result.keys() >= KEYS
    assert (result["schema"], result["servo"], result["friction"], result["seed"]) == ("frasa.fit/2", "mx64", "m1", 0)
    assert (result["effects"], result["not_in_model"]) == ([], [])
    assert [one["start"] for one in result["restarts"]].count("seed 0") == 1
    assert len(result["restarts"]) == 3
    for one in result["parameters"].values():
        assert one.keys() >= {"value", "unit", "low", "high", "verdict", "bootstrap_low", "bootstrap_high"}
        assert one["low"] <= one["value"] <= one["high"]
        assert one["bootstrap_low"] <= one["value"] <= one["bootstrap_high"]
    assert set(result["mujoco"]) == {"kp", "damping", "frictionloss", "armature", "forcerange", "delay"}
    for kind in ("nominal", "fitted", "held_out"):
        assert set(result["misfit"][kind]) == {"mae_rad", "rmse_rad"}
    assert result["misfit"]["fitted"]["mae_rad"] < 0.5 * result["misfit"]["nominal"]["mae_rad"]
    assert result["evaluations"] >= 20
    assert result["seconds"] > 0
    paths = {name: place / path for name, path in result["outputs"].items()}
    assert set(paths) == {"fit", "model", "ranges", "report"}
    assert all(path.is_file() for path in paths.values())
    model = load_model(paths["model"])
    for field, value in result["mujoco"].items():
        assert read(model, f"mx64.{field}") == value
    calibration = load_calibration(paths["model"])
    supply = calibration.ranges["supply_voltage"]
    seen = result["from_logs"]["supply_voltage"]
    assert supply.low <= seen[0] <= seen[1] <= supply.high
    fitted = calibration.ranges.keys() - {"supply_voltage"}
    assert "mx64.kp" in fitted
    assert all(calibration.values()[name] == result["parameters"][name]["value"] for name in fitted)
    assert (place / "robot_model" / "nominal.xml").read_bytes() == before
    assert "replays the 4 runs" in err
    assert not list(place.rglob("*.partial.json"))
    page = paths["report"].read_text()
    assert len(page) < 5_000_000
    assert "http:" not in page
    assert "https:" not in page

    assert frasa("compare", place / "few.mcap", "--model", paths["model"], "--no-report", "--json") == 0
    compared = json.loads(capsys.readouterr().out)
    assert compared["misfit"].keys() >= {"mae_rad", "rmse_rad"}
    assert compared["candidates"]["nominal"]["mae_rad"] > compared["misfit"]["mae_rad"]
    by_run = compared["misfit"]["by_log"]
    fitted = json.loads(paths["fit"].read_text())["by_run"]
    assert by_run == pytest.approx({**fitted["fitted"], **fitted["held_out"]}, abs=1e-9)


def test_same_seed_same_bytes(place, capsys):
    """The fit file is a function of logs, model and seed: no clock, no folder, no leftovers."""
    made = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        out = place / name / "mx64.json"
        words = fit_words(place, "--no-report", "--optimizer", "cmaes", "--seed", seed, "--out", out, "--threads", 2)
        assert frasa(*words) == 0
        made.append(out.read_bytes())
        assert [path.name for path in out.parent.iterdir()] == ["mx64.json"]
    assert made[0] == made[1] != made[2]
    assert str(place).encode() not in made[0]
    assert capsys.readouterr().out == ""


def test_a_fit_with_everything(place, capsys):
    """Law, effects, own step, pieces, restarts and refits, all from the command line, all told in the fit file."""
    words = ["--friction", "m2", "--effects", "sag,punch", "--timestep", 0.001, "--first", 2.4, "--shooting", 0.8]
    more = ["--restarts", 2, "--bootstrap", 3, "--jobs", 1, "--no-report", "--json"]
    assert frasa(*fit_words(place, *words, *more)) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["friction"], result["effects"], result["bootstrap_draws"]) == ("m2", ["sag", "punch"], 3)
    assert len(result["not_in_model"]) == 2
    assert result["runs"] == {"train": 4, "held_out": 0}
    assert result["pieces"] == {"train": 12, "held_out": 0}
    assert sorted(one["start"] for one in result["restarts"]) == ["nested", "seed 0", "seed 1"]
    names = {"mx64.stribeck", "mx64.stribeck_speed", "mx64.stribeck_exponent", "mx64.punch", "bench.sag"}
    assert result["parameters"].keys() >= names
    assert all(one["refit_low"] <= one["refit_high"] for one in result["parameters"].values())
    assert result["as_m1"]["mujoco"].keys() == result["mujoco"].keys()
    assert result["misfit"]["fitted"]["mae_rad"] < 0.5 * result["misfit"]["nominal"]["mae_rad"]
    stored = load(place / "robot_model" / "fits" / "mx64.json")
    assert (stored.friction, stored.stand_in.values) == ("m2", result["as_m1"]["mujoco"])


def test_the_page_says_what_the_logs_lack(place, few, capsys):
    """The page's advice holds what the recordings themselves say is missing, beside what the fit says."""
    still = altered([one for one in few if one.rig.trajectory == "sin_sin"], torque_enable=None)
    assert len(still) == 2
    write_mcap(place / "still.mcap", still)
    assert frasa(*fit_words(place, "--restarts", 1, "--json", log="still.mcap")) == 0
    page = Path(json.loads(capsys.readouterr().out)["outputs"]["report"]).read_text()
    advice = next_logs(findings(motions(read_log(place / "still.mcap"))))
    assert advice
    for one in advice:
        assert html.escape(one, quote=False) in page or html.escape(one) in page


def altered(few, **signals):
    """The runs with signals replaced by what a function makes of their values, or removed."""
    made = []
    for one in few:
        kept = dict(one.signals)
        for name, change in signals.items():
            old = kept.pop(name)
            if change is not None:
                kept[name] = Signal(name, old.unit, old.t, change(old.y))
        made.append(replace(one, signals=kept))
    return made


def with_rig(few, **facts):
    return [replace(one, rig=replace(one.rig, **facts)) for one in few]


BAD_LOGS = {
    "without a goal": (lambda few: altered(few, goal=None), "no 'goal' signal"),
    "without a position": (lambda few: altered(few, position=None), "no 'position' signal"),
    "without firmware gain": (lambda few: with_rig(few, firmware_gain=None), "--firmware-gain"),
    "without a load": (lambda few: with_rig(few, mass=None), "--mass"),
    "without a servo": (lambda few: with_rig(few, servo=None), "--servo"),
    "of two servos": (lambda few: [few[0], *with_rig(few[1:], servo="mx106")], "several servos, mx106, mx64"),
}


@pytest.mark.parametrize("what", BAD_LOGS)
def test_a_bad_log_is_one_line(place, few, capsys, what):
    """A log that lacks something ends with exit 3 and one line that says what to do; nothing is written."""
    make, complaint = BAD_LOGS[what]
    write_mcap(place / "bad.mcap", make(few))
    assert frasa(*fit_words(place, log="bad.mcap")) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert complaint in err
    assert not (place / "robot_model" / "fits").exists()


def test_degrees_are_not_radians(place, few, capsys):
    """A log in degrees does not fit in silence."""
    degrees = altered(few, position=np.degrees, goal=np.degrees)
    write_mcap(place / "bad.mcap", degrees)
    status = frasa(*fit_words(place, log="bad.mcap"))
    err = capsys.readouterr().err
    assert status == 3
    assert err.count("\n") == 1
    assert "deg" in err


@pytest.mark.parametrize("content", [None, b"", b"text", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_log(place, capsys, content):
    """A missing, empty, foreign or cut-off file ends with exit 3 and one line."""
    if content is not None:
        (place / "bad.mcap").write_bytes(content)
    assert frasa(*fit_words(place, log="bad.mcap")) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["--servo", "mx28"], 2, "unknown servo"),
        (["--hold-out", "speed"], 2, "--hold-out"),
        (["--seed", -1], 2, "--seed"),
        (["--seed", 2**32], 2, "--seed"),
        (["--threads", -1], 2, "--threads"),
        (["--evaluations", 0], 2, "--evaluations"),
        (["--servo", "mx106"], 2, "the logs say mx64, --servo says mx106"),
        (["--publish", "--out", "elsewhere.json"], 2, "elsewhere"),
        (["--model", "typo.xml"], 3, "no model at"),
        (["--bench-model", "typo.xml"], 3, "no model at"),
        (["--bench-model", "NOMINAL"], 3, "one hinge"),
        (["--out", "few.mcap/fits/a.json"], 1, "cannot write"),
        (["--out", "page.html"], 2, ".json"),
        (["--restarts", 0], 2, "--restarts"),
        (["--bootstrap", -1], 2, "--bootstrap"),
        (["--jobs", 0], 2, "--jobs"),
        (["--first", 0], 2, "--first"),
        (["--first", "nan"], 2, "--first"),
        (["--shooting", -1], 2, "--shooting"),
        (["--timestep", "inf"], 2, "--timestep"),
        (["--timestep", 0.1], 2, "--timestep"),
        (["--publish", "--timestep", 0.001], 2, "--timestep"),
        (["--effects", "sag,magic"], 2, "magic"),
        (["--effects", ","], 2, "--effects"),
    ],
)
def test_a_bad_word_is_one_line(place, capsys, monkeypatch, words, status, complaint):
    """Wrong options and models end with their exit status and one last line, before any fitting."""
    monkeypatch.chdir(place)
    words = [place / "robot_model" / "nominal.xml" if word == "NOMINAL" else word for word in words]
    assert frasa(*fit_words(place, *words)) == status
    err = capsys.readouterr().err.strip().splitlines()
    assert complaint in err[-1]
    assert len(err) == 1 or status == 1
    assert not any("Traceback" in line for line in err)


def test_a_servo_that_the_model_lacks(place, few, capsys):
    """Its fit has no place in the model: said before the fit."""
    write_mcap(place / "other.mcap", with_rig(few, servo=None))
    assert frasa(*fit_words(place, "--publish", "--servo", "xl330", log="other.mcap")) == 2
    assert "no servo class 'xl330'" in capsys.readouterr().err


def test_the_same_log_twice(place, capsys):
    """A log given twice would count twice: it is refused, though the paths differ."""
    shutil.copytree(place / "robot_model", place / "copy")
    shutil.copy(place / "few.mcap", place / "copy")
    first, *rest = fit_words(place)
    assert frasa(first, place / "copy" / "few.mcap", *rest) == 3
    assert "come twice" in capsys.readouterr().err


def test_other_fits_are_looked_at_first(place, capsys):
    """A broken fit beside the one to be published, or another of the same servo, is said before fitting."""
    fits = place / "robot_model" / "fits"
    fits.mkdir()
    (fits / "other.json").write_text("{}")
    assert frasa(*fit_words(place, "--publish")) == 3
    assert "other.json" in capsys.readouterr().err
    (fits / "other.json").unlink()
    assert frasa(*fit_words(place, "--no-report", "--optimizer", "cmaes")) == 0
    (fits / "mx64.json").rename(fits / "other.json")
    capsys.readouterr()
    assert frasa(*fit_words(place, "--publish")) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "a fit of mx64 too" in err


def test_a_variant_beside_is_seen_before_the_fit(place, capsys):
    """Ranges of another model in the folder are said at once, for a bench and for a robot; the other place works."""
    nominal = place / "robot_model" / "nominal.xml"
    assert frasa(*fit_words(place, "--no-report", "--optimizer", "cmaes")) == 0
    fit = place / "robot_model" / "fits" / "mx64.json"
    variant = place / "robot_model" / "variant.xml"
    assert frasa("publish", fit, "--model", nominal, "--out", variant) == 0
    capsys.readouterr()
    before = fit.stat().st_mtime_ns
    robot = Path(__file__).parents[2] / "bench_logs" / "robot.mcap"
    for words in (fit_words(place, "--publish"), ["fit", robot, "--model", nominal, "--publish"]):
        assert frasa(*words) == 2
        err = capsys.readouterr().err
        assert err.splitlines()[-1].startswith(f"frasa-sysid: {variant.with_name('calibrated.xml')} would take the")
        assert fit.stat().st_mtime_ns == before
    own = place / "own" / "calibrated.xml"
    assert frasa("publish", fit, "--model", nominal, "--out", own) == 0
    assert load_calibration(own).id == load_calibration(variant).id


def test_compare_keeps_namesakes_apart(place, capsys):
    """Two models of one file name are two candidates."""
    for name in ("a", "b"):
        shutil.copytree(place / "robot_model", place / name)
    words = [word for name in ("a", "b") for word in ("--with-model", place / name / "nominal.xml")]
    model = place / "robot_model" / "nominal.xml"
    assert frasa("compare", place / "few.mcap", "--model", model, *words, "--no-report", "--json") == 0
    found = json.loads(capsys.readouterr().out)["candidates"]
    assert len(found) == 3
    assert len({one["mae_rad"] for one in found.values()}) == 1


def test_publish_command(place, capsys):
    """Broken and missing fit files, and an output that is the nominal model, are one line each."""
    (place / "a.json").write_text("{}")
    model = place / "robot_model" / "nominal.xml"
    for word in ("a.json", "none.json"):
        assert frasa("publish", place / word, "--model", model) == 3
        assert capsys.readouterr().err.count("\n") == 1
    assert not (place / "robot_model" / "calibrated.xml").exists()


def test_simulate_command(tmp_path, capsys, made_of):
    """A simulated log says where it lies and what is true; bad words are usage errors."""
    assert frasa("simulate", "--servo", "mx64", "--out", tmp_path / "a.mcap", "--delay", "0.004", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["truth"]["mx64.delay"] == 0.004
    assert result["runs"] == len(read_log(tmp_path / "a.mcap")) == 36
    made = made_of(tmp_path / "a.mcap")
    assert (made["servo"], made["seed"]) == ("mx64", result["seed"])
    assert made["versions"]["frasa"] == result["versions"]["frasa"]
    for words in (["--delay", "1"], ["--delay", "nan"], ["--seed", "-1"]):
        assert frasa("simulate", "--servo", "mx64", "--out", tmp_path / "b.mcap", *words) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "b.mcap").exists()


def test_ctrl_c_saves_the_best(place):
    """SIGINT while searching: exit 130, a fit file of the best so far, and a checkpoint to go on from."""
    words = fit_words(place, "--evaluations", 1_000_000, "--optimizer", "cmaes", "--no-report")
    process = subprocess.Popen(
        [sys.executable, "-m", "frasa_sysid.cli", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # A test run in the background of a shell ignores SIGINT, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    fits = place / "robot_model" / "fits"
    deadline = time.monotonic() + 60
    while not (fits / "mx64.partial.json").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert json.loads((fits / "mx64.json").read_text())["stop"] == "interrupted"
    assert (fits / "mx64.partial.json").is_file()
    assert not (place / "robot_model" / "calibrated.xml").exists()

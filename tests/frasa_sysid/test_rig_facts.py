"""Facts of the rig from a map's `[rig]` and from `import`, up to a fit of runs at several loads and gains."""

import argparse

import pandas as pd
import pytest

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.bench import add_bench_arguments
from frasa_sysid.commands.import_facts import NUMBERS
from frasa_sysid.errors import InputError
from frasa_sysid.readers import read_log
from frasa_sysid.readers.signal_map import builtin_maps, load_map, parse_map
from frasa_sysid.recording import RigFacts
from frasa_sysid.stored_fit import load
from frasa_sysid.writer import write_mcap

SIGNALS = {"goal": "rad", "position": "rad", "supply_voltage": "V", "torque_enable": "1"}
MAP = '[time]\ncolumn = "t"\nunit = "s"\n' + "".join(
    f'[[signal]]\ncolumn = "{name}"\nsignal = "{name}"\nunit = "{unit}"\n' for name, unit in SIGNALS.items()
)
RIG = '[rig]\nservo = "MX106"\nmass = 0.535\nlength = 0.15\narm_mass = 0.036\nsupply_voltage = 15\n'


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def facts(text):
    return dict(parse_map("m.toml", (MAP + text).encode(), builtin=False).rig)


def table(path, recording):
    """A run as a logger of one's own would write it: a CSV of what stands at the same stamps."""
    frame = {"t": recording.signal("position").t, **{name: recording.signal(name).y for name in SIGNALS}}
    pd.DataFrame(frame).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def runs(robot_model_dir):
    """Runs of the project's own bench by load, gain and motion."""
    every = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    return {(one.rig.mass, one.rig.firmware_gain, one.rig.trajectory): one for one in every}


@pytest.fixture
def one(tmp_path, runs):
    """A run as a CSV, with a map that knows the rig and not the gain."""
    (tmp_path / "bench.toml").write_text(MAP + RIG)
    return table(tmp_path / "one.csv", runs[0.535, 16.0, "up_and_down"])


def test_a_map_says_what_rig_facts_has():
    """Every fact has its key, and comes out as it stands there."""
    every = {
        "servo": "mx64",
        "mass": 1.0,
        "length": 0.1,
        "arm_mass": 0.0,
        "inertia": 0.01,
        "gravity_torque": 0.5,
        "firmware_gain": 32.0,
        "supply_voltage": 12.0,
        "control": "position",
        "trajectory": "sine",
        "base": "fixed",
    }
    assert set(every) == set(RigFacts.__dataclass_fields__)
    lines = "".join(f"{name} = {value!r}\n" for name, value in every.items())
    assert facts("[rig]\n" + lines) == every
    assert facts("") == {}
    assert all(not load_map(name).rig for name in builtin_maps())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[rig]\nmas = 1", "unknown key 'mas'; did you mean 'mass'?"),
        ("[rig]\nmass = '1 kg'", "mass = '1 kg', expected a number"),
        ("[rig]\nmass = -1", "mass = -1.0: expected a finite number, zero or more"),
        ("[rig]\nmass = true", "expected a number"),
        ("[rig]\nservo = 3", "servo = 3, expected text in quotes"),
        ("[rig]\nservo = 'mine.toml'", "expected its name"),
        ("[rig]\ncontrol = 'torque'", "expected 'position', 'voltage' or 'force'"),
        ("[rig]\nbase = 'hung'", "expected 'fixed' or 'floating'"),
        ("[[rig]]\nmass = 1", "expected a table"),
    ],
)
def test_facts_that_cannot_be_used(text, complaint):
    """One line says where and what was expected."""
    with pytest.raises(InputError) as error:
        facts(text)
    assert complaint in str(error.value)
    assert str(error.value).startswith("map m.toml: [rig]")
    assert "\n" not in str(error.value)


def test_import_has_the_facts_of_fit():
    """The options of `import` are those of `fit`, by the same names and in the same units."""
    parser = argparse.ArgumentParser()
    add_bench_arguments(parser)
    of_fit = {action.dest: action.metavar for action in parser._actions}
    assert {name: of_fit.get(name) for name in NUMBERS} == {name: unit.upper() for name, unit in NUMBERS.items()}


def test_options_go_before_the_map(tmp_path, one, capsys):
    """What the map says is carried into the MCAP; an option replaces it, and a supply that was not is told."""
    words = ["import", one, "--format", "csv", "--map", tmp_path / "bench.toml", "--out", tmp_path / "out"]
    options = ["--firmware-gain", 16, "--mass", 0.54, "--supply-voltage", 20, "--trajectory", "up_and_down"]
    assert frasa(*words, *options) == 0
    assert "voltage_contradicted: 1 in 1 of 1 logs" in capsys.readouterr().err
    (recording,) = read_log(tmp_path / "out" / "one.mcap")
    assert recording.rig == RigFacts("mx106", 0.54, 0.15, 0.036, None, None, 16.0, 20.0, "position", "up_and_down")
    assert frasa(*words, "--servo", "mx64") == 0
    assert read_log(tmp_path / "out" / "one.mcap")[0].rig.servo == "mx64"
    assert frasa(*words, "--mass", -1) == 2
    assert "mass = -1.0: expected a finite number" in capsys.readouterr().err


def test_facts_find_their_row_of_a_rig_table(tmp_path, one):
    """A table of inertias is looked up by what the map or the options say."""
    (tmp_path / "rigs.csv").write_text("mass,length,total_inertia,total_g_bias\n0.535,0.15,0.0123,-0.8\n")
    words = ["import", one, "--format", "csv", "--map", tmp_path / "bench.toml", "--out", tmp_path]
    assert frasa(*words, "--rig-table", tmp_path / "rigs.csv") == 0
    assert read_log(tmp_path / "one.mcap")[0].rig.gravity_torque == 0.8


def test_what_a_log_declares_is_not_overruled(tmp_path, runs, capsys):
    """Another value is refused in one line, the same value and a gap that is filled are not."""
    (tmp_path / "in").mkdir()
    source = tmp_path / "in" / "a.mcap"
    write_mcap(source, [runs[0.535, 16.0, "sin_sin"]])
    words = ["import", source, "--format", "mcap", "--out", tmp_path / "out"]
    assert frasa(*words, "--mass", 0.6) == 3
    assert "the log declares mass = 0.535, --mass says 0.6: leave that out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert frasa(*words, "--trajectory", "sine") == 3
    assert frasa(*words, "--mass", 0.535, "--trajectory", "sin_sin") == 0
    assert read_log(tmp_path / "out" / "a.mcap")[0].rig == runs[0.535, 16.0, "sin_sin"].rig


def test_runs_at_several_loads_and_gains_are_fitted_together(tmp_path, runs, model_dir):
    """CSV logs of two loads and three gains, a folder for each, are fitted as the log that declares all itself."""
    chosen = [(0.535, 8.0), (0.535, 32.0), (1.2, 16.0)]
    motions = ("lift_and_drop", "sin_time_square")
    (tmp_path / "bench.toml").write_text(MAP + RIG)
    folders = []
    for mass, gain in chosen:
        folders.append(tmp_path / f"{mass}kg_P{gain:g}")
        for motion in motions:
            source = table(tmp_path / f"{motion}_{mass}_{gain:g}.csv", runs[mass, gain, motion])
            words = ["import", source, "--format", "csv", "--map", tmp_path / "bench.toml", "--out", folders[-1]]
            assert frasa(*words, "--firmware-gain", gain, "--mass", mass, "--trajectory", motion) == 0
    write_mcap(tmp_path / "whole.mcap", [runs[mass, gain, motion] for mass, gain in chosen for motion in motions])
    found = []
    for i, logs in enumerate((folders, [tmp_path / "whole.mcap"])):
        words = ["--model", model_dir / "nominal.xml", "--no-report", "--restarts", 1, "--evaluations", 400]
        assert frasa("fit", *logs, *words, "--out", tmp_path / f"{i}.json") == 0
        found.append(load(tmp_path / f"{i}.json").parameters["mx106.kp"]["value"])
    assert found[0] == pytest.approx(found[1], rel=1e-4)
    assert found[0] == pytest.approx(runs[0.535, 8.0, "sin_sin"].truth["mx106.kp"], rel=0.1)

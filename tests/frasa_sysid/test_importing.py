import argparse
import gzip
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.commands import import_formats, importing, inspect
from frasa_sysid.errors import LogError
from frasa_sysid.readers import read_log
from frasa_sysid.readers.bam import read_bam
from frasa_sysid.rig_table import read_rig_table
from frasa_sysid.writer import write_mcap


def frasa(*words):
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    importing.add_parser(parser.add_subparsers(required=True))
    return run_command(parser, [str(word) for word in words])


def bam(path, scale=1.0, **header):
    entries = [
        {
            "position": scale * 0.01 * i,
            "speed": 1.0,
            "input_volts": 12.0,
            "timestamp": 0.01 * i,
            "goal_position": scale * 0.02 * i,
            "torque_enable": True,
        }
        for i in range(50)
    ]
    entries[20]["position"] = -2047 * 2 * np.pi / 4096
    facts = {"mass": 0.535, "length": 0.1, "kp": 4, "vin": 15.0, "motor": "sts3215", "offset": 0.0} | header
    content = json.dumps(
        {key: value for key, value in facts.items() if value is not None} | {"entries": entries}
    ).encode()
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "rigs.csv"
    path.write_text(
        "\ufeffmass,length, total_inertia,total_g_bias \r\n0.535,0.100,0.0067,-0.54\n0.741,0.1,0.009,-0.74\n"
    )
    return path


def test_import_keeps_everything(tmp_path, table, made_of):
    """The MCAP holds the recording with its faults and facts, and the original byte for byte."""
    source = bam(tmp_path / "in" / "a.json.gz")
    assert frasa("import", source, "--format", "bam", "--out", tmp_path / "out", "--rig-table", table) == 0
    out = tmp_path / "out" / "a.mcap"
    read, direct = read_log(out)[0], read_bam(source)[0]
    assert read.name == "a.mcap#00"
    for name, signal in direct.signals.items():
        np.testing.assert_array_equal(read.signal(name).y, signal.y)
    assert read.faults == direct.faults
    assert {fault.code for fault in read.faults} == {"failed_read", "voltage_contradicted"}
    assert (read.rig.inertia, read.rig.gravity_torque, read.rig.mass) == (0.0067, 0.54, 0.535)
    assert read.extra == {"offset": 0.0, "imported_from": "a.json.gz", "imported_sha256": direct.sha256}
    assert made_of(out)["inputs"] == {str(source): direct.sha256}
    with out.open("rb") as file:
        attached = list(make_reader(file).iter_attachments())
    assert [(one.name, one.data) for one in attached] == [("a.json.gz", source.read_bytes())]


def test_same_source_same_bytes(tmp_path):
    """Importing twice gives the same bytes and replaces what was there."""
    source = bam(tmp_path / "a.json")
    for _ in range(2):
        assert frasa("import", source, "--format", "bam", "--out", tmp_path / "one") == 0
    assert frasa("import", source, "--format", "bam", "--out", tmp_path / "two") == 0
    assert (tmp_path / "one" / "a.mcap").read_bytes() == (tmp_path / "two" / "a.mcap").read_bytes()
    assert len(list((tmp_path / "one").iterdir())) == 1


def test_one_bad_source_costs_no_other(tmp_path, capsys):
    """A bad source is named, the others are imported, the exit status is 3."""
    bam(tmp_path / "in" / "a.json")
    bam(tmp_path / "in" / "c.json")
    (tmp_path / "in" / "b.json").write_text("{")
    assert frasa("import", tmp_path / "in", "--format", "bam", "--out", tmp_path / "out", "--json") == 3
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.mcap", "c.mcap"]
    out, err = capsys.readouterr()
    assert out == ""
    assert "b.json is not JSON" in err
    assert "1 of 3 sources" in err


def test_files_directories_and_globs(tmp_path):
    """A source is a file, a directory or a glob; each file counts once; names and JSON tell what was made."""
    for name in ("a.json", "b.json.gz", "c.json"):
        bam(tmp_path / "in" / name)
    (tmp_path / "in" / "notes.csv").write_text("x")
    folder = importing.find_sources(str(tmp_path / "in"), "bam")
    assert [path.name for path in folder] == ["a.json", "b.json.gz", "c.json"]
    found = importing.find_sources(str(tmp_path / "in" / "*.json"), "bam")
    assert [path.name for path in found] == ["a.json", "c.json"]
    for nothing in ("none.json", "no*.json"):
        with pytest.raises(LogError, match="does not exist"):
            importing.find_sources(str(tmp_path / nothing), "bam")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="holds no"):
        importing.find_sources(str(tmp_path / "empty"), "bam")


def test_each_file_once_and_a_missing_one_costs_no_other(tmp_path, capsys):
    """A file named twice is imported once; a source that does not exist is named, the rest imported."""
    source = bam(tmp_path / "in" / "a.json")
    words = [source, tmp_path / "in", tmp_path / "none.json", "--format", "bam", "--out", tmp_path / "out"]
    assert frasa("import", *words) == 3
    assert "none.json does not exist" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.mcap"]


def test_json_on_standard_output(tmp_path, capsys):
    """With --json one object stands on standard output, and nothing else."""
    bam(tmp_path / "a.json")
    assert frasa("import", tmp_path / "a.json", "--format", "bam", "--out", tmp_path, "--json") == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result["schema"] == "frasa.import/1"
    assert result["imported"][0]["faults"] == {"failed_read": 1, "voltage_contradicted": 1}
    assert "failed_read: 1 in 1 of 1 logs" in err


def test_rig_table_must_know_the_rig(tmp_path, table, capsys):
    """A run whose rig is not in the table is an error that names the run."""
    bam(tmp_path / "a.json", mass=0.6)
    bam(tmp_path / "b.json", mass=None)
    arguments = ["--format", "bam", "--out", tmp_path / "out", "--rig-table", table]
    assert frasa("import", tmp_path / "a.json", *arguments) == 3
    assert "a.json" in (err := capsys.readouterr().err)
    assert "no row for mass 0.6 kg and length 0.1 m" in err
    assert frasa("import", tmp_path / "b.json", *arguments) == 3
    assert "declares no mass and length" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("mass,length\n1,2\n", "no column total_inertia, total_g_bias"),
        ("mass,length,total_inertia,total_g_bias\n1,2,x,4\n", "line 2 is not four numbers"),
        ("mass,length,total_inertia,total_g_bias\n1,2,3,4\n", "total_g_bias <= 0"),
        ("mass,length,total_inertia,total_g_bias\n1,2\n", "line 2 is not four numbers"),
        ('mass,length,total_inertia,total_g_bias\n1,2,3,"' + "4" * 200_000, "is not a text table"),
    ],
)
def test_bad_rig_table(tmp_path, content, complaint):
    """A table that cannot be used is refused with its line."""
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(LogError, match=complaint):
        read_rig_table(tmp_path / "t.csv")


def test_servo_and_unit(tmp_path):
    """--servo overrides the log, --unit deg converts, and MCAP itself can be brought to radians."""
    source = bam(tmp_path / "in" / "a.json", scale=60)
    out = tmp_path / "out"
    assert frasa("import", source, "--format", "bam", "--out", out) == 3
    assert frasa("import", source, "--format", "bam", "--out", out, "--unit", "rad", "--servo", "MX64") == 0
    assert read_mcap_servo(out / "a.mcap", unit="rad") == ("mx64", pytest.approx(58.8))
    again = tmp_path / "again"
    assert frasa("import", out / "a.mcap", "--format", "mcap", "--out", again, "--unit", "deg") == 0
    assert read_mcap_servo(again / "a.mcap") == ("mx64", pytest.approx(np.deg2rad(58.8)))
    assert frasa("import", source, "--format", "dynaban", "--out", out, "--unit", "deg") == 2


def read_mcap_servo(path, unit="auto"):
    from frasa_sysid.readers import read_mcap

    recording = read_mcap(path, unit=unit)[0]
    return recording.rig.servo, recording.signal("goal").y[-1]


def test_sources_that_would_collide(tmp_path):
    """Two sources of one name, or a source that its import would replace, are refused before anything is written."""
    a, b = bam(tmp_path / "one" / "a.json"), bam(tmp_path / "two" / "a.json.gz")
    assert frasa("import", a, b, "--format", "bam", "--out", tmp_path / "out") == 2
    assert frasa("import", a, "--format", "bam", "--out", tmp_path / "out") == 0
    assert frasa("import", tmp_path / "out" / "a.mcap", "--format", "mcap", "--out", tmp_path / "out") == 2


@pytest.mark.parametrize(
    ("name", "stem"), [("a.json.gz", "a"), ("a.b.json", "a.b"), ("a", "a"), (".gz", ".gz"), ("x.txt", "x")]
)
def test_stem(tmp_path, name, stem):
    """Only the endings of a format go."""
    assert import_formats.stem(tmp_path / name) == stem


def test_real_bench_with_its_rig_table(tmp_path, shared_dir):
    """The STS3215 bench finds every rig in its owners' table, read back from MCAP without a new fault."""
    folder = shared_dir / "data" / "sts3215"
    if not folder.is_dir():
        pytest.skip("no STS3215 logs in the shared data")
    table = folder / "bench_configs.csv"
    sources = sorted(folder.glob("*.json.gz"))[::6]
    assert frasa("import", *sources, "--format", "bam", "--out", tmp_path, "--rig-table", table) == 0
    for source in sources:
        recording = read_log(tmp_path / f"{import_formats.stem(source)}.mcap")[0]
        assert recording.rig.inertia > 0.006
        assert 0.5 < recording.rig.gravity_torque < 1.5
        assert recording.faults == read_bam(source)[0].faults


@pytest.mark.parametrize(
    ("form", "folder", "names", "recordings"),
    [
        ("jandi", "mx106_jandi", ["sine", "step", "triangle"], 3),
        ("miuzei", "servo_miuzei", ["response"], 96),
        ("emps", "emps", ["DATA_EMPS"], 1),
    ],
)
def test_public_sets(tmp_path, shared_dir, capsys, form, folder, names, recordings):
    """Each set becomes files that carry its originals, and `inspect` shows them without a verdict on metres."""
    source = shared_dir / "data" / folder
    if not source.is_dir():
        pytest.skip(f"no {folder} in the shared data")
    assert frasa("import", source, "--format", form, "--out", tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.mcap" for name in names]
    logs = [one for name in names for one in read_log(tmp_path / f"{name}.mcap")]
    assert len(logs) == recordings
    attached = []
    for name in names:
        with (tmp_path / f"{name}.mcap").open("rb") as file:
            attached += [one.name for one in make_reader(file).iter_attachments()]
    originals = sorted(path.name for path in source.rglob("*") if path.is_file())
    assert sorted(attached) == originals
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    inspect.add_parser(parser.add_subparsers(required=True))
    capsys.readouterr()
    assert run_command(parser, ["inspect", *(str(tmp_path / f"{name}.mcap") for name in names), "--json"]) == 0
    verdicts = json.loads(capsys.readouterr().out)["identifiable"]
    assert bool(verdicts) == (form != "emps")
    # What was recorded as duty stays below half: nothing saturates, whatever a gain in another unit would say.
    if form == "jandi":
        assert [one["verdict"] for one in verdicts if one["parameter"] == "force limit"] == ["no"]


@pytest.mark.parametrize("form", ["emps", "jandi", "miuzei"])
def test_units_that_need_no_declaration(tmp_path, form, capsys):
    """--unit deg makes no sense where the format fixes the unit; a folder without such logs is named."""
    assert frasa("import", tmp_path, "--format", form, "--out", tmp_path, "--unit", "deg") == 2
    assert "--unit deg" in capsys.readouterr().err
    assert frasa("import", tmp_path, "--format", form, "--out", tmp_path) == 3
    assert "holds no" in capsys.readouterr().err


TURNS = '[time]\nrate = 100\n[[signal]]\ncolumn = "q"\nsignal = "position"\nunit = "deg"\n'
TURNS += TURNS.partition("rate = 100\n")[2].replace('"q"', '"g"').replace("position", "goal")


def test_a_joint_of_several_turns(tmp_path):
    """Angles whose unit was declared, by a map or --unit, are not doubted later; each message names what helps."""
    goals = np.linspace(0, 1000, 300)
    text = "q,g\n" + "".join(f"{goal - 1},{goal}\n" for goal in goals)
    (tmp_path / "far.csv").write_text(text)
    (tmp_path / "far.toml").write_text(TURNS)
    words = ["import", tmp_path / "far.csv", "--format", "csv", "--map", tmp_path / "far.toml"]
    assert frasa(*words, "--out", tmp_path / "csv") == 0
    (mapped,) = read_log(tmp_path / "csv" / "far.mcap")
    assert mapped.signal("goal").y.max() == pytest.approx(np.deg2rad(1000))
    # The same from a recorder that declares nothing.
    bare = tmp_path / "bare.mcap"
    write_mcap(bare, [replace(mapped, extra={})])
    with pytest.raises(LogError, match=r"goal looks like degrees: it reaches 17\.45") as error:
        read_log(bare)
    remedy = re.search(r"'frasa-sysid (.*?)'", str(error.value))[1].replace("DIR", str(tmp_path / "again")).split()
    assert frasa(*(word if word != "deg" else "rad" for word in remedy)) == 0
    assert read_log(tmp_path / "again" / "bare.mcap")[0].signal("goal").y.max() == pytest.approx(np.deg2rad(1000))
    assert frasa(*remedy) == 0
    assert read_log(tmp_path / "again" / "bare.mcap")[0].signal("goal").y.max() == pytest.approx(
        np.deg2rad(17.453), 1e-3
    )


def test_what_was_declared_is_on_record(tmp_path, made_of):
    """The MCAP says with which options it was made."""
    source = bam(tmp_path / "a.json", mass=None)
    words = ["--unit", "rad", "--mass", 0.5, "--servo", "mx64"]
    assert frasa("import", source, "--format", "bam", "--out", tmp_path, *words) == 0
    assert made_of(tmp_path / "a.mcap")["declared"] == {"mass": 0.5, "servo": "mx64", "unit": "rad"}


def test_another_log_of_the_same_name_is_not_replaced(tmp_path, capsys):
    """Runs of one name from several folders do not eat each other; the same log may change or move."""
    first, second = bam(tmp_path / "p8" / "up.json"), bam(tmp_path / "p16" / "up.json", kp=16)
    out = tmp_path / "out" / "up.mcap"
    words = ["--format", "bam", "--out", tmp_path / "out"]
    assert frasa("import", first, *words) == 0
    before = out.read_bytes()
    assert frasa("import", second, *words) == 3
    assert f"{second} would replace {out}, which was imported from {first}" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert frasa("import", bam(first, kp=8), *words) == 0
    assert read_log(out)[0].rig.firmware_gain == 8
    moved = tmp_path / "moved" / "up.json"
    moved.parent.mkdir()
    first.rename(moved)
    assert frasa("import", moved, *words, "--trajectory", "sine") == 0
    for foreign in (b"", b"no MCAP", out.read_bytes()[:-40]):
        out.write_bytes(foreign)
        assert frasa("import", second, *words) == 0

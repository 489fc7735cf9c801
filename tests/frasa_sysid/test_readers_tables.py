import argparse
import gzip
import tracemalloc

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.commands import importing
from frasa_sysid.errors import InputError, LogError
from frasa_sysid.readers import csv_columns, read_log
from frasa_sysid.readers.columns import read_columns
from frasa_sysid.readers.csv_columns import CsvFile
from frasa_sysid.readers.npz_columns import NpzFile
from frasa_sysid.readers.parquet_columns import ParquetFile
from frasa_sysid.readers.signal_map import parse_map

NAMES = ("t", "q_knee", "q_hip", "cmd_knee", "cmd_hip", "v")
MAP = """
[time]
column = "t"
unit = "{unit}"
[[signal]]
column = "q_*"
signal = "position"
unit = "deg"
[[signal]]
column = "cmd_*"
signal = "goal"
unit = "rad"
[[signal]]
column = "v"
signal = "supply_voltage"
unit = "mV"
[joints]
knee = "left_knee"
"""
FILES = {"csv": CsvFile, "parquet": ParquetFile}


def the_map(text=MAP, **values):
    return parse_map("m.toml", text.format(**({"unit": "s"} | values)).encode(), builtin=False)


def samples(n=300, factor=1.0):
    t = np.arange(n) / 100
    q = np.stack([10 * np.sin(5 * t), 20 * np.cos(3 * t)], axis=1)
    return pd.DataFrame(
        {"t": t * factor, "q_knee": q[:, 0], "q_hip": q[:, 1], "cmd_knee": t, "cmd_hip": -t, "v": 12000.0, "x": "text"}
    )


def write(folder, form, frame):
    path = folder / f"a.{form}"
    frame.to_csv(path, index=False) if form == "csv" else frame.to_parquet(path)
    return path


def frasa(*words):
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    importing.add_parser(parser.add_subparsers(required=True))
    return run_command(parser, [str(word) for word in words])


def codes(recording):
    return {fault.code: fault.count for fault in recording.faults}


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_columns_become_signals(tmp_path, form):
    """Values, units, joints and times come from the command line's map to MCAP; the original and the map go with it."""
    frame = samples()
    path = write(tmp_path, form, frame)
    (tmp_path / "m.toml").write_text(MAP.format(unit="s"))
    out = tmp_path / "out"
    assert frasa("import", path, "--format", form, "--map", tmp_path / "m.toml", "--out", out) == 0
    recording = read_log(out / "a.mcap")[0]
    assert recording.signal("position").columns == ("left_knee", "hip")
    np.testing.assert_allclose(recording.signal("position").y, np.deg2rad(frame[["q_knee", "q_hip"]]), atol=1e-12)
    np.testing.assert_allclose(recording.signal("goal").y, frame[["cmd_knee", "cmd_hip"]])
    np.testing.assert_allclose(recording.signal("position").t, frame["t"], atol=1e-9)
    assert recording.signal("supply_voltage").unit == "V"
    np.testing.assert_allclose(recording.signal("supply_voltage").y, 12.0)
    assert recording.extra["map"] == "m.toml"
    assert recording.extra["imported_from"] == f"a.{form}"
    assert recording.faults == ()


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_epoch_times_keep_their_last_digit(tmp_path, form, unit, factor):
    """Whole numbers since 1970 are subtracted as such: no float holds them to the nanosecond."""
    frame = samples()
    frame["t"] = (frame["t"] * factor).round().astype(np.int64) + int(1_700_000_000 * factor) + 7
    recording = read_columns(FILES[form](write(tmp_path, form, frame)), the_map(unit=unit))[0]
    np.testing.assert_allclose(recording.signal("position").t, np.arange(300) / 100, atol=1e-9)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_dates(tmp_path, form):
    """Dates are read where they are declared, and refused where numbers are, and the other way round."""
    frame = samples()
    frame["t"] = pd.Timestamp("2025-03-17T17:36:26.25Z") + pd.to_timedelta(frame["t"], unit="s")
    path = write(tmp_path, form, frame)
    recording = read_columns(FILES[form](path), the_map(unit="iso"))[0]
    np.testing.assert_allclose(recording.signal("position").t, np.arange(300) / 100, atol=1e-9)
    with pytest.raises(LogError, match='declare unit = "iso"'):
        read_columns(FILES[form](path), the_map(unit="s"))
    with pytest.raises(LogError, match="holds numbers, not dates"):
        read_columns(FILES[form](write(tmp_path, form, samples())), the_map(unit="iso"))


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_losses_are_counted(tmp_path, form):
    """Infinity, empty fields, repeated and unsorted stamps are dropped or sorted, each with its number."""
    frame = samples()
    frame.loc[10, "q_knee"] = np.inf
    frame.loc[[20, 21], "q_hip"] = np.nan
    frame.loc[30, "t"] = frame.loc[29, "t"]
    frame.loc[[40, 41], "t"] = frame.loc[[41, 40], "t"].to_numpy()
    recording = read_columns(FILES[form](write(tmp_path, form, frame)), the_map())[0]
    assert codes(recording) == {"blank": 2, "not_finite": 1, "repeated_time": 1, "time_order": 1}
    assert recording.signal("position").t.size == 296
    assert recording.signal("goal").t.size == 299


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_blank_cells_of_a_slower_column(tmp_path, form):
    """What a table leaves empty is counted as such: beside failed readings, and where a joint never reports."""
    frame = samples().astype({"v": float})
    frame.loc[frame.index % 10 != 0, "v"] = np.nan
    frame["cmd_knee"] = (
        frame[next(name for name in frame if name.startswith("cmd"))] if "cmd_knee" not in frame else 1.0
    )
    frame["q_hip"] = np.nan
    frame.loc[5, "q_knee"] = np.inf
    recording = read_columns(FILES[form](write(tmp_path, form, frame)), the_map())[0]
    said = {fault.message for fault in recording.faults}
    assert "supply_voltage: blank in 270 of 300 rows; left out, as where a column is slower than the table" in said
    assert codes(recording) == {"blank": 270, "dead_joint": 1, "not_finite": 1}
    assert recording.signal("supply_voltage").t.size == 30
    assert recording.signal("position").t.size == 299


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (MAP.format(unit="ms").replace("q_*", "p_*").replace("cmd", "c").replace('"v"', '"w"'), "it holds t, q_knee"),
        (MAP.format(unit="ns"), "samples 1e-11 s apart if t is in ns; is that the unit"),
        (MAP.format(unit="s").replace('"t"', '"time"'), "no column time, which"),
        (MAP.format(unit="s").replace('"v"', '"x"'), "number"),
        (MAP.format(unit="s").replace('"mV"', '"mV"\njoints = ["a", "b"]'), "2 joints, but v is one column"),
        (
            MAP.format(unit="s").replace(
                '"mV"', '"mV"\n[[signal]]\ncolumn = "q_hip"\nsignal = "position"\nunit = "rad"'
            ),
            "a joint without a name",
        ),
        (MAP.format(unit="s").split("[[", 1)[1].join(["[[", ""]), "declares no [time]"),
        (
            MAP.format(unit="s") + 'hip = "left_knee2"\n[[signal]]\ncolumn="v"\nsignal="gyro"\nunit="rad/s"\n',
            "has the axes",
        ),
    ],
)
def test_maps_that_do_not_fit(tmp_path, form, text, complaint):
    """A map that names nothing, a wrong unit of time, text for numbers: one line says what the table holds."""
    path = write(tmp_path, form, samples())
    with pytest.raises(LogError) as error:
        read_columns(FILES[form](path), parse_map("m.toml", text.encode(), builtin=False))
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


def test_without_a_map_the_columns_are_listed(tmp_path, capsys):
    """No guess is made: the columns are named, with what to do; a map of topics is no map of columns."""
    path = write(tmp_path, "csv", samples())
    assert frasa("import", path, "--format", "csv", "--out", tmp_path / "out") == 3
    assert (
        "--map FILE.toml which columns are which signals, in which unit; it holds t, q_knee" in capsys.readouterr().err
    )
    assert frasa("import", path, "--format", "csv", "--map", "ros2_control", "--out", tmp_path / "out") == 3
    assert "is for messages ('topic = ...'), this log holds tables" in capsys.readouterr().err
    assert frasa("import", path, "--format", "bam", "--map", "ros2_control", "--out", tmp_path / "out") == 2
    (tmp_path / "m.toml").write_text(MAP.format(unit="s"))
    words = ["--map", tmp_path / "m.toml", "--unit", "deg", "--out", tmp_path / "out"]
    assert frasa("import", path, "--format", "csv", *words) == 2
    assert not (tmp_path / "out").exists()


def test_an_entry_that_meets_nothing_is_named(tmp_path):
    """A typing error in one entry of a map does not pass in silence."""
    text = MAP.format(unit="s").replace("cmd_*", "cmnd_*")
    recording = read_columns(CsvFile(write(tmp_path, "csv", samples())), parse_map("m.toml", text.encode(), False))[0]
    assert [fault.message for fault in recording.faults] == ["map m.toml: [[signal]] 2: no column cmnd_*"]


def test_csv_dialects(tmp_path):
    """Gzip, semicolons, tabs, a byte-order mark, # before the header, blank lines and quotes are all read."""
    frame = samples().drop(columns="x")
    expected = read_columns(CsvFile(write(tmp_path, "csv", frame)), the_map())[0]
    plain = (tmp_path / "a.csv").read_text()
    variants = {
        "b.csv": "\ufeff" + plain,
        "c.csv": plain.replace(",", ";"),
        "d.csv": "# " + plain.replace(",", "\t"),
        "e.csv": plain.replace("\n", "\r\n") + "\r\n",
        "f.csv": plain.replace("q_knee", '"q_knee"'),
        "g.csv.gz": plain,
    }
    for name, text in variants.items():
        data = text.encode()
        (tmp_path / name).write_bytes(gzip.compress(data) if name.endswith("gz") else data)
        recording = read_columns(CsvFile(tmp_path / name), the_map())[0]
        for signal in expected.signals.values():
            np.testing.assert_array_equal(recording.signal(signal.name).y, signal.y)


def test_csv_that_is_damaged(tmp_path):
    """A last row that was cut off is dropped and counted; any other short row, or text in it, is named by its line."""
    text = write(tmp_path, "csv", samples()).read_text()
    path = tmp_path / "b.csv"
    path.write_text(text[: text.rindex(",") - 4])
    recording = read_columns(CsvFile(path), the_map())[0]
    assert codes(recording) == {"truncated": 1}
    assert recording.signal("position").t.size == 299
    lines = text.splitlines()
    for bad, complaint in (
        ("1,2", "line 6 has not 7 fields"),
        ("0.04,x,1,1,1,1,", "line 6: q_knee = 'x' is not a number"),
    ):
        path.write_text("\n".join([*lines[:5], bad, *lines[6:]]))
        with pytest.raises(LogError, match=complaint):
            read_columns(CsvFile(path), the_map())
    for data, complaint in (
        (b"", "is empty"),
        (b"\n1,2\n", "first line is empty"),
        (b"t,q_a\n", "no rows"),
        (b"\xff\xfe1", "not a CSV"),
    ):
        path.write_bytes(data)
        with pytest.raises(LogError, match=complaint):
            read_columns(CsvFile(path), the_map())
    (tmp_path / "c.csv.gz").write_bytes(gzip.compress(text.encode())[:-10])
    with pytest.raises(LogError, match="damaged gzip"):
        CsvFile(tmp_path / "c.csv.gz").load(["t"], [])


def test_csv_takes_memory_for_what_is_kept_only(tmp_path):
    """Of a file of forty columns two are kept: memory follows these and a block, not the file."""
    path = tmp_path / "wide.csv"
    rows = 4 * csv_columns.BLOCK
    with path.open("w") as file:
        file.write("t,q_a," + ",".join(f"c{i}" for i in range(38)) + "\n")
        for i in range(rows):
            file.write(f"{i / 1000:.3f},{i % 7}" + ",0.12345678" * 38 + "\n")
    tracemalloc.start()
    loaded = CsvFile(path).load(["q_a"], ["t"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert loaded.columns["q_a"].size == rows
    assert peak < path.stat().st_size / 3


def test_npz(tmp_path):
    """Arrays side by side need the names of their columns; axes are put in order; a rate may stand for the times."""
    t = np.arange(200) / 50
    q = np.stack([np.sin(t), np.cos(t)], axis=1)
    quaternion = np.tile([0.0, 0.0, 0.6, 0.8], (200, 1))
    np.savez(tmp_path / "a.npz", q=q, imu=quaternion, other=np.zeros(3))
    text = """
[time]
rate = 50
[[signal]]
column = "q"
signal = "position"
unit = "rad"
joints = ["a", "b"]
[[signal]]
column = "imu"
signal = "orientation"
unit = "1"
joints = ["x", "y", "z", "w"]
"""
    recording = read_columns(NpzFile(tmp_path / "a.npz"), parse_map("m", text.encode(), False))[0]
    np.testing.assert_array_equal(recording.signal("position").y, q)
    np.testing.assert_allclose(recording.signal("position").t, t)
    assert recording.signal("orientation").columns == ("w", "x", "y", "z")
    np.testing.assert_array_equal(recording.signal("orientation").y[0], [0.8, 0.0, 0.0, 0.6])
    for change, complaint in (
        (('joints = ["a", "b"]\n', ""), "q has 2 columns; name them in order"),
        (('["a", "b"]', '["a"]'), "1 joints, but q has 2 columns"),
        (('column = "q"', 'column = "other"'), "differ in length"),
    ):
        with pytest.raises(LogError, match=complaint):
            read_columns(NpzFile(tmp_path / "a.npz"), parse_map("m", text.replace(*change).encode(), False))


def test_npz_is_not_unpickled(tmp_path):
    """Objects in an array, a damaged archive, and a file that is none are refused in one line."""

    class Trap:
        def __reduce__(self):
            return (tmp_path.joinpath("trapped").write_text, ("x",))

    np.savez(tmp_path / "a.npz", t=np.array([Trap()], dtype=object), q_a=np.zeros(1))
    with pytest.raises(LogError, match="nothing is unpickled"):
        NpzFile(tmp_path / "a.npz").load(["t"], [])
    assert not (tmp_path / "trapped").exists()
    np.savez(tmp_path / "b.npz", t=np.arange(1000.0))
    (tmp_path / "b.npz").write_bytes((tmp_path / "b.npz").read_bytes()[:500])
    (tmp_path / "c.npz").write_text("hello")
    for name in ("b.npz", "c.npz"):
        with pytest.raises(LogError, match=r"not an \.npz file, or cut off"):
            NpzFile(tmp_path / name)


def test_parquet_lists_and_runs(tmp_path):
    """As LeRobot writes: lists of one length are the joints, and a column says where a run begins."""
    n = 100
    table = pa.table(
        {
            "timestamp": pa.array(np.tile(np.arange(n) / 50, 2).astype(np.float32)),
            "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(np.arange(4.0 * n) / 300), 2),
            "action": pa.array([[0.0, 0.1]] * (2 * n)),
            "episode_index": pa.array(np.repeat([0, 1], n)),
        }
    )
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=64)
    text = """
[time]
column = "timestamp"
unit = "s"
run = "episode_index"
[[signal]]
column = "observation.state"
signal = "position"
unit = "rad"
joints = ["a", "b"]
[[signal]]
column = "action"
signal = "goal"
unit = "rad"
joints = ["a", "b"]
"""
    first, second = read_columns(ParquetFile(tmp_path / "a.parquet"), parse_map("m", text.encode(), False))
    assert (first.name, second.name) == ("a.parquet#00", "a.parquet#01")
    np.testing.assert_allclose(second.signal("position").y[0], np.array([200, 201]) / 300)
    assert second.signal("position").t[0] == 0.0
    np.testing.assert_allclose(second.duration, 99 / 50, rtol=1e-6)


def test_parquet_that_is_damaged(tmp_path):
    """A file cut off, a text file, and lists that differ are refused in one line."""
    path = write(tmp_path, "parquet", samples())
    (tmp_path / "b.parquet").write_bytes(path.read_bytes()[:-50])
    (tmp_path / "c.parquet").write_text("hello")
    for name in ("b.parquet", "c.parquet"):
        with pytest.raises(LogError, match="not a Parquet file, or cut off") as error:
            ParquetFile(tmp_path / name)
        assert "\n" not in str(error.value)
    pq.write_table(pa.table({"q": [[1.0], [1.0, 2.0]]}), tmp_path / "d.parquet")
    with pytest.raises(LogError, match="expected one length"):
        ParquetFile(tmp_path / "d.parquet").load(["q"], [])


def test_a_missing_package_is_named_with_how_to_get_it(tmp_path, monkeypatch):
    """Parquet without pyarrow says what to install."""
    import sys

    path = write(tmp_path, "parquet", samples())
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogError, match=r"pip install 'frasa\[formats\]'"):
        ParquetFile(path)


def test_harold_as_a_plain_table(tmp_path, shared_dir):
    """A public quadruped log read by a map of eight lines equals what its own reader says."""
    from frasa_sysid.readers.harold import read_harold

    source = shared_dir / "data" / "robots" / "harold_session_2026-01-03_19-04-36.csv.gz"
    if not source.is_file():
        pytest.skip("no Harold log in the shared data")
    own = read_harold(source)[0]
    names = CsvFile(source).names()
    time = names[0]
    text = f'[time]\ncolumn = "{time}"\nunit = "iso"\n'
    for column, signal in (("pos_*", "position"), ("cmd_pos_*", "goal")):
        text += f'[[signal]]\ncolumn = "{column}"\nsignal = "{signal}"\nunit = "rad"\n'
    recording = read_columns(CsvFile(source), parse_map("m", text.encode(), False))[0]
    for signal in ("position", "goal"):
        np.testing.assert_array_equal(recording.signal(signal).y, own.signal(signal).y)


def test_input_errors_are_logs_errors():
    """A map that is wrong ends with exit status 3, as a log that is wrong does."""
    assert InputError.exit_code == LogError.exit_code == 3

import io
import struct
import zlib

import numpy as np
import pytest
import scipy.io
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.errors import LogError
from frasa_sysid.inspection import is_bench
from frasa_sysid.readers import matlab, read_log, read_mcap
from frasa_sysid.readers.emps import read_emps
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap

T = 0.001 * np.arange(200)


def content(packed=True, **changes):
    variables = {
        "t": T[:, None],
        "qm": 0.1 * np.sin(T)[:, None],
        "qg": 0.1 * np.sin(T + 0.01)[:, None],
        "vir": np.cos(T)[:, None],
        "gtau": 35.0,
        "kp": 160.0,
        "kv": 243.0,
    } | changes
    file = io.BytesIO()
    scipy.io.savemat(file, {key: value for key, value in variables.items() if value is not None}, do_compression=packed)
    return file.getvalue()


def write(path, **changes):
    path.write_bytes(content(**changes))
    return path


@pytest.mark.parametrize("packed", [True, False])
def test_the_axis(tmp_path, packed):
    """Positions stay metres, the force is the voltage times the drive's gain."""
    recording = read_emps(write(tmp_path / "a.mat", packed=packed))[0]
    units = {name: signal.unit for name, signal in recording.signals.items()}
    assert units == {"position": "m", "goal": "m", "voltage_command": "V", "force": "N"}
    np.testing.assert_allclose(recording.signal("force").y, 35.0 * np.cos(T))
    np.testing.assert_allclose(recording.signal("position").t, T)
    assert recording.rig.known() == {"servo": "emps", "control": "force"}
    assert recording.faults == ()
    assert recording.linear
    assert not is_bench(recording)


def test_metres_survive_mcap(tmp_path):
    """Written to MCAP and read back, the axis is the same: values, units, kind of control; no angle is made of it."""
    direct = read_emps(write(tmp_path / "a.mat", qg=3 + np.zeros((200, 1)), qm=20 + 6.3 * (T > 0.1)[:, None]))[0]
    write_mcap(tmp_path / "a.mcap", [direct])
    read = read_log(tmp_path / "a.mcap")[0]
    for name, signal in direct.signals.items():
        assert read.signal(name).unit == signal.unit
        np.testing.assert_array_equal(read.signal(name).y, signal.y)
    assert (read.rig, read.linear, read.extra, read.faults) == (direct.rig, True, direct.extra, ())
    with pytest.raises(LogError, match="is no angle"):
        read_mcap(tmp_path / "a.mcap", unit="deg")


def test_one_axis_has_one_kind_of_unit():
    """Metres and radians in one recording are refused, whichever of the two is wrong."""
    for position, goal in (("m", "rad"), ("rad", "m")):
        signals = {
            "position": Signal("position", position, T, T),
            "goal": Signal("goal", goal, T, T),
        }
        with pytest.raises(LogError, match=rf"'goal' is in \[{goal}\], expected \[{position}\]"):
            Recording("a", signals, RigFacts(), "real", "", "", "file")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"vir": None}, "no variable vir"),
        ({"gtau": None}, "no variable gtau"),
        ({"gtau": 0.0}, "'gtau' is not one positive number"),
        ({"gtau": np.ones((2, 2))}, "'gtau' is not one positive number"),
        ({"gtau": "text"}, "'gtau' is not an array of real numbers"),
        ({"qm": np.ones((200, 1)) * 1j}, "'qm' is not an array of real numbers"),
        ({"qm": {"a": 1.0}}, "'qm' is not an array of real numbers"),
        ({"qm": np.array([[1.0, "a"]], dtype=object)}, "'qm' is not an array of real numbers"),
        ({"qm": np.ones((20, 10))}, r"'qm' has shape \(20, 10\)"),
        ({"qm": np.ones((5, 1))}, "5 values of 'qm' but 200 times"),
        ({"qm": np.full((200, 1), 240.0)}, "'qm' reaches 240, expected metres"),
        ({"qm": np.full((200, 1), np.nan)}, "no finite 'position'"),
    ],
)
def test_bad_variables(tmp_path, changes, complaint):
    """A file with the wrong things in it is refused with the variable that shows it."""
    with pytest.raises(LogError, match=complaint):
        read_emps(write(tmp_path / "a.mat", **changes))


def test_nan_is_dropped_and_counted(tmp_path):
    """A sample that is not finite goes and is counted; time may begin anywhere."""
    position = 0.1 * np.sin(T)
    position[7] = np.nan
    recording = read_emps(write(tmp_path / "a.mat", qm=position[:, None], t=(T + 5)[:, None]))[0]
    assert recording.signal("position").t.size == 199
    assert recording.signal("position").t[0] == 0
    assert [(fault.code, fault.count) for fault in recording.faults] == [("not_finite", 1)]


def test_files_that_are_no_matlab_5(tmp_path):
    """Other files, a 7.3 file and one that was cut off are told apart."""
    whole = content()
    for data, complaint in (
        (b"", "is empty"),
        (b"hello", "not a MATLAB 5 file"),
        (b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM", "save it with -v7"),
        (whole[:300], "cut off"),
        (whole[:128], "no variable"),
    ):
        (tmp_path / "a.mat").write_bytes(data)
        with pytest.raises(LogError, match=complaint):
            read_emps(tmp_path / "a.mat")


@pytest.mark.parametrize("packed", [True, False])
def test_arrays_of_all_kinds_of_numbers(tmp_path, packed):
    """What SciPy writes is read exactly: singles, integers, matrices by columns, and beside things of other kinds."""
    rng = np.random.default_rng(0)
    written = {
        "matrix": rng.normal(size=(3, 5)),
        "cube": rng.normal(size=(2, 3, 4)),
        "single": rng.normal(size=(7, 1)).astype(np.float32),
        "few": np.array([[1, 2, 3]], np.uint8),
        "whole": np.array([[-(2**40)], [2**40]]),
        "a_name_that_is_rather_long": np.array([[1.5]]),
        "none": np.zeros((0, 1)),
    }
    others = {
        "text": "words",
        "struct": {"a": 1.0},
        "cells": np.array([[1.0, "a"]], dtype=object),
        "wave": np.ones(2) * 1j,
    }
    scipy.io.savemat(tmp_path / "a.mat", others | written, do_compression=packed)
    for name, values in matlab.read_matlab(tmp_path / "a.mat", list(written)).items():
        np.testing.assert_array_equal(values, written[name])
    for name in others:
        with pytest.raises(LogError, match=f"'{name}' is not an array of real numbers"):
            matlab.read_matlab(tmp_path / "a.mat", [name])


@pytest.mark.parametrize("i", range(8))
@pytest.mark.parametrize("value", [0, 1, 2, 4, 5, 6, 8, 9, 14, 15, 17, 127, 255])
def test_wrong_types_and_sizes(tmp_path, i, value):
    """A byte of an array's tag, flags, size or name that is another is at most an error: it never ends the process."""
    data = content(packed=False)
    for place in (128 + i, 136 + i, 144 + i, 152 + i, 160 + i, 168 + i, 176 + i):
        altered = bytearray(data)
        altered[place] = value
        (tmp_path / "a.mat").write_bytes(altered)
        try:
            read_emps(tmp_path / "a.mat")
        except LogError:
            continue


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    """A variable that unpacks to more than the limit is refused before it is."""
    monkeypatch.setattr(matlab, "LIMIT", 10_000)
    packed = zlib.compress(bytes(1_000_000))
    (tmp_path / "a.mat").write_bytes(content()[:128] + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(LogError, match="unpacks to more than"):
        read_emps(tmp_path / "a.mat")


@settings(max_examples=150, deadline=None)
@given(
    packed=st.booleans(),
    changes=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=4),
    head=st.booleans(),
)
def test_any_byte_may_be_wrong(tmp_path_factory, packed, changes, head):
    """Whatever bytes are flipped, the file is read or refused, and nothing else happens."""
    data = bytearray(content(packed=packed))
    for place, value in changes:
        data[int(place * (600 if head else len(data)))] = value
    path = tmp_path_factory.mktemp("fuzz") / "a.mat"
    path.write_bytes(data)
    try:
        read_emps(path)
    except LogError:
        return


def test_the_published_numbers_come_back(shared_dir, tmp_path):
    """Least squares on the imported log, filtered as its authors did, gives their mass and friction."""
    path = shared_dir / "data" / "emps" / "DATA_EMPS.mat"
    if not path.exists():
        pytest.skip("no EMPS data in the shared data")
    write_mcap(tmp_path / "a.mcap", read_emps(path))
    recording = read_log(tmp_path / "a.mcap")[0]
    position, force = recording.signal("position"), recording.signal("force")
    assert position.t.size == 24_841
    b, a = scipy.signal.butter(4, 100 / 500)
    q = scipy.signal.filtfilt(b, a, position.y)
    dq = np.gradient(q, 1e-3)
    ddq = np.gradient(dq, 1e-3)
    inner = slice(50, -50)
    matrix = np.stack([ddq, dq, np.sign(dq), np.ones(q.size)], axis=1)[inner]
    both = [scipy.signal.decimate(one, 10, axis=0) for one in (matrix, force.y[inner])]
    mass, viscous, coulomb, offset = np.linalg.lstsq(*both, rcond=None)[0]
    assert mass == pytest.approx(95.11, abs=0.5)
    assert viscous == pytest.approx(203.5, abs=4)
    assert coulomb == pytest.approx(20.39, abs=0.4)
    assert offset == pytest.approx(-3.165, abs=0.1)

import numpy as np
import pytest

from frasa_sysid.errors import LogError
from frasa_sysid.readers.dynaban import read_dynaban

TWO_TESTS = """StartOfNewTest 0

Time Command Position Speed
9 3000 4094 3000
19 3000 4095 20
29 3000 1 20
Time Command Position Speed
0 -1500 10 -1500
10 -1500 9 -20
20 -1500 4095 -40
"""


def test_format(tmp_path):
    """Commands become volts, steps radians, ticks seconds; wraps go, the first speed goes, the last test stays."""
    (tmp_path / "log").write_text(TWO_TESTS)
    first, second = read_dynaban(tmp_path / "log")
    assert [first.name, second.name] == ["log#000", "log#001"]
    assert first.rig.known() == {
        "servo": "mx64",
        "gravity_torque": 0.0,
        "supply_voltage": 12.0,
        "control": "voltage",
        "trajectory": "staircase",
    }
    step = 2 * np.pi / 4096
    np.testing.assert_allclose(first.signal("position").y, np.array([4094, 4095, 4097]) * step)
    np.testing.assert_allclose(first.signal("position").t, [0, 0.001, 0.002])
    np.testing.assert_array_equal(first.signal("voltage_command").y, [12, 12, 12])
    np.testing.assert_array_equal(second.signal("voltage_command").y, [-6, -6, -6])
    np.testing.assert_allclose(second.signal("velocity").y, [-20 * step, -40 * step])
    np.testing.assert_allclose(second.signal("velocity").t, [0.001, 0.002])
    assert {fault.code for fault in first.faults} == {"encoder_wrap", "first_sample"}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("hello\n", "line 1 stands before"),
        ("StartOfNewTest 0\n", "holds no test"),
        ("Time Command Position Speed\n1 2 3\n", "line 2 is not four numbers"),
        ("Time Command Position Speed\n1 2 3 x\n", "line 2 is not four numbers"),
        ("é\n", "not a Dynaban log"),
    ],
)
def test_not_a_dynaban_log(tmp_path, content, complaint):
    """What is no Dynaban log is refused with the line that shows it."""
    (tmp_path / "log").write_text(content)
    with pytest.raises(LogError, match=complaint):
        read_dynaban(tmp_path / "log")


def test_a_test_of_one_row(tmp_path):
    """Its only velocity is the command, which is dropped: there is none left."""
    (tmp_path / "log").write_text("\n".join(TWO_TESTS.splitlines()[:4]) + "\n")
    (only,) = read_dynaban(tmp_path / "log")
    assert "velocity" not in only.signals
    np.testing.assert_array_equal(only.signal("voltage_command").y, [12])


def test_the_published_log(shared_dir):
    """All 113 tests of 999 samples are there, the last one too; 47 of them wrapped."""
    path = shared_dir / "data" / "mx64_dynaban" / "completeTest.gz"
    if not path.exists():
        pytest.skip("no Dynaban log in the shared data")
    recordings = read_dynaban(path)
    assert len(recordings) == 113
    assert {recording.signal("position").t.size for recording in recordings} == {999}
    assert sum("encoder_wrap" in [fault.code for fault in one.faults] for one in recordings) == 47
    kinds = [one.rig.trajectory for one in recordings]
    assert [kinds.count(kind) for kind in ("staircase", "sawtooth", "steps")] == [30, 9, 74]
    for one in recordings:
        position = one.signal("position")
        assert np.abs(np.diff(position.y)).max() < 0.1
        assert np.ptp(position.y) < 7.2
        assert position.t[-1] == pytest.approx(0.999, abs=0.002)
        assert np.abs(one.signal("velocity").y).max() < 8.0
    assert recordings[-1].signal("voltage_command").y[0] == pytest.approx(-2880 / 3000 * 12)


def test_the_speed_column_lags_by_25_ms(shared_dir):
    """The known delay of the published log survives the import: speed is position's slope 25 ms ago."""
    path = shared_dir / "data" / "mx64_dynaban" / "completeTest.gz"
    if not path.exists():
        pytest.skip("no Dynaban log in the shared data")
    test = read_dynaban(path)[35]
    position, velocity = test.signal("position"), test.signal("velocity")
    inner = (velocity.t > 0.1) & (velocity.t < 0.95)
    errors = {}
    for lag in range(10, 41):
        ends = [np.interp(velocity.t - lag / 1000 + half, position.t, position.y) for half in (-0.0255, 0.0255)]
        errors[lag] = np.abs((ends[1] - ends[0]) / 0.051 - velocity.y)[inner].mean()
    assert min(errors, key=errors.__getitem__) == 25

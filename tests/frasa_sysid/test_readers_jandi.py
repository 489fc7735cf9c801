import csv
import gzip
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.errors import LogError
from frasa_sysid.readers.jandi import read_jandi
from frasa_sysid.readers.servo_clock import reading_times, unwrap_ticks

STEP = 2 * np.pi / 4096
NAMES = [
    "tx_end_ns",
    "rx_end_ns",
    "acquisition_kind",
    "q_present_rad",
    "present_position_tick",
    "dq_present_rad_s",
    "current_A_joint",
    "pwm_percent",
    "input_voltage_V",
    "temperature_C",
    "realtime_tick_ms",
    "hardware_error",
]


def metadata(**changes):
    return {
        "valid_flag": True,
        "trajectory": "step",
        "model_number": 321,
        "bench": {"bare_horn": True},
        "config_snapshot": {"resolved": {"hardware": {"direction": -1, "zero_tick": 2048}}},
        "register_readback": {"operating_mode": 5, "position_p_gain": 350},
    } | changes


def rows(n=60, drift=1e-4):
    found = []
    for i in range(n):
        sent = 10**12 + 10_000_000 * i
        tick = int((32_700 + 10 * i * (1 - drift)) % 32768)
        state = ["state", -(5 * STEP), 2053, 0.1, 0.2, 25.0, 12.5, 38, tick, ""]
        if i % 20 == 19:
            state = ["hardware_error", *[""] * 8, "0"]
        found.append([sent, sent + 2_000_000, *state])
    return found


def write(folder, telemetry=None, facts=None, goals=None, names=NAMES):
    folder.mkdir(exist_ok=True)
    with (folder / "telemetry.csv").open("w", newline="") as file:
        csv.writer(file).writerows([names, *(rows() if telemetry is None else telemetry)])
    goals = [[0.01, 2041, row[0]] for row in rows()] if goals is None else goals
    with gzip.open(folder / "command_events.csv.gz", "wt", newline="") as file:
        csv.writer(file).writerows([["goal_rad", "goal_tick", "tx_end_ns"], *goals])
    (folder / "metadata.json").write_text(json.dumps(metadata() if facts is None else facts))
    return folder


def test_a_run(tmp_path):
    """Ticks become radians in the joint's direction, percent a duty; the rows without a state are counted."""
    recording = read_jandi(write(tmp_path / "step"))[0]
    assert recording.name == "step"
    assert recording.rig.known() == {
        "servo": "mx106",
        "mass": 0.0,
        "length": 0.0,
        "firmware_gain": 350.0,
        "control": "position",
        "trajectory": "step",
    }
    assert {name: signal.unit for name, signal in recording.signals.items()} == {
        "goal": "rad",
        "position": "rad",
        "velocity": "rad/s",
        "current": "A",
        "duty": "1",
        "supply_voltage": "V",
        "temperature": "degC",
    }
    np.testing.assert_allclose(recording.signal("position").y, -5 * STEP)
    np.testing.assert_allclose(recording.signal("goal").y, 7 * STEP)
    np.testing.assert_allclose(recording.signal("goal").t, 0.01 * np.arange(60))
    assert recording.signal("duty").y[0] == 0.25
    assert recording.signal("position").t.size == 57
    np.testing.assert_allclose(recording.signal("position").t[:3], [0.001, 0.011, 0.021], atol=6e-4)
    faults = {fault.code: fault.count for fault in recording.faults}
    assert faults == {"no_state": 3, "firmware_unit": 1, "current_based": 1}
    assert recording.extra["operating_mode"] == 5


def test_ticks_are_unwrapped_across_gaps():
    """A gap longer than the register's period is known from the host's time."""
    host = np.array([0.0, 0.01, 40.0, 120.0])
    ticks = np.mod(np.array([32_765.0, 32_775, 72_765, 152_765]), 32768)
    np.testing.assert_array_equal(unwrap_ticks(ticks, host), [0, 10, 40_000, 120_000])


def test_the_servo_clock_corrects_a_late_host():
    """A reading that the host stamped 30 ms late is put where the servo's clock says; the drift is found."""
    true = 0.01 * np.arange(2000)
    ticks = np.mod(np.floor(true * (1 - 1e-4) * 1000), 32768)
    host = true.copy()
    host[500] += 0.03
    times, clock = reading_times(host, ticks)
    assert clock is not None
    assert clock.drift == pytest.approx(1e-4, abs=5e-6)
    assert clock.outliers == 1
    assert np.abs(times - true).max() < 1.1e-3
    assert np.abs(np.delete(times - true, 500)).max() < 1e-4


def test_a_clock_that_stands_is_not_used(tmp_path):
    """A servo clock that says nothing leaves the host's times, and is reported."""
    table = rows()
    for row in table:
        row[10] = 5 if row[10] != "" else ""
    recording = read_jandi(write(tmp_path / "a", table))[0]
    assert "servo_clock" in {fault.code for fault in recording.faults}
    np.testing.assert_allclose(recording.signal("position").t[:3], [0.001, 0.011, 0.021])


def changed(row, place, value):
    table = rows()
    table[row][place] = value
    return table


@pytest.mark.parametrize(
    ("what", "complaint"),
    [
        ({"telemetry": changed(3, 3, 5 * STEP)}, "q_present_rad and its ticks"),
        ({"telemetry": changed(3, 5, "x")}, "line 5: dq_present_rad_s = 'x' is not a number"),
        ({"telemetry": changed(3, 0, "1.5")}, "line 5: tx_end_ns = '1.5' is not a whole number"),
        ({"telemetry": changed(3, 0, 10**30)}, "is not a whole number"),
        ({"telemetry": changed(3, 0, 9 * 10**18)}, "days apart"),
        ({"telemetry": changed(3, 0, 10**12)}, "out of order"),
        ({"telemetry": [*rows()[:5], [1, 2]]}, "line 7 has 2 fields, expected 12"),
        ({"telemetry": []}, "has a header and no rows"),
        ({"telemetry": [[*row[:3], *[""] * 8, "0"] for row in rows()]}, "0 states"),
        ({"names": ["other", *NAMES[1:]]}, "no column tx_end_ns"),
        ({"goals": [[0.01, 2055, 10**12]]}, "goal_rad and its ticks"),
        ({"facts": metadata(register_readback={"operating_mode": 1, "position_p_gain": 1})}, "operating mode 1"),
        ({"facts": metadata(register_readback={"operating_mode": 10**400})}, "'operating_mode' = '1000"),
        ({"facts": metadata(register_readback={"operating_mode": 5})}, "'position_p_gain' = 'None'"),
        ({"facts": metadata(register_readback={"operating_mode": 5, "position_p_gain": -1})}, "firmware_gain = -1"),
        ({"facts": metadata(bench=[])}, "no object 'bench'"),
        ({"facts": []}, "no object 'register_readback'"),
    ],
)
def test_bad_runs(tmp_path, what, complaint):
    """What cannot be used is refused in one line that names the place."""
    with pytest.raises(LogError, match=complaint) as error:
        read_jandi(write(tmp_path / "run", **what))
    assert "\n" not in str(error.value)


def test_incomplete_folders(tmp_path):
    """A run without one of its files, or with one that was cut off, is refused."""
    folder = write(tmp_path / "run")
    events = (folder / "command_events.csv.gz").read_bytes()
    (folder / "command_events.csv.gz").write_bytes(events[:-20])
    with pytest.raises(LogError, match="damaged gzip"):
        read_jandi(folder)
    (folder / "command_events.csv.gz").unlink()
    with pytest.raises(LogError, match=r"no command_events\.csv"):
        read_jandi(folder)
    with pytest.raises(LogError, match=r"no telemetry\.csv"):
        read_jandi(tmp_path)


@settings(max_examples=60, deadline=None)
@given(place=st.integers(0, 11), row=st.integers(0, 59), value=st.text(max_size=8) | st.floats().map(str))
def test_any_field_may_be_wrong(tmp_path_factory, place, row, value):
    """Whatever stands in one field, a run is read or refused, and nothing else happens."""
    folder = write(tmp_path_factory.mktemp("fuzz") / "run", changed(row, place, value))
    try:
        recording = read_jandi(folder)[0]
    except LogError:
        return
    assert np.isfinite(recording.signal("position").y).all()


@pytest.mark.parametrize(("name", "samples"), [("step", 1931), ("sine", 4212), ("triangle", 9209)])
def test_the_published_runs(shared_dir, name, samples):
    """Every state is there, the servo's clock is followed within rounding, and the sign is right."""
    folder = shared_dir / "data" / "mx106_jandi" / name
    if not folder.is_dir():
        pytest.skip("no Jandi runs in the shared data")
    recording = read_jandi(folder)[0]
    position, goal, duty = (recording.signal(one) for one in ("position", "goal", "duty"))
    assert position.t.size == samples
    assert position.y.min() < -0.05 < 0.05 < position.y.max()
    clock = recording.extra["clock"]["readings"]
    assert 110 < clock["servo_drift_ppm"] < 122
    assert clock["largest_residual_ms"] < 0.8
    held = goal.y[np.searchsorted(goal.t, position.t, side="right") - 1]
    assert np.corrcoef(held - position.y, duty.y)[0, 1] > 0.4
    lags = np.arange(0, 120) / 1000
    apart = [np.abs(np.interp(position.t - lag, goal.t, goal.y) - position.y).mean() for lag in lags]
    assert 0.02 < lags[int(np.argmin(apart))] < 0.085

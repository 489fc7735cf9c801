import gzip
import json
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.errors import LogError
from frasa_sysid.readers.miuzei import read_miuzei


def rollout(**changes):
    return {"type": "step", "targets": ["kp"], "actions": [0.0, 0.5, 0.5], "sensor_data": [0.0, 0.0, 0.25]} | changes


def write(path, *rollouts, config=None):
    log = {"dataset": "real", "config": config or {"action_hz": 50}, "data": list(rollouts)}
    path.write_text(json.dumps(log))
    return path


def test_rollouts(tmp_path):
    """Shares of half a turn become radians on a nominal clock; what is not known is said."""
    recordings = read_miuzei(write(tmp_path / "a.json", rollout(), rollout(type="prbs")))
    assert [one.name for one in recordings] == ["a.json#00", "a.json#01"]
    one = recordings[0]
    np.testing.assert_allclose(one.signal("goal").y, np.pi * np.array([0, 0.5, 0.5]))
    np.testing.assert_allclose(one.signal("position").y, np.pi * np.array([0, 0, 0.25]))
    np.testing.assert_allclose(one.signal("position").t, [0, 0.02, 0.04])
    assert one.rig.known() == {"servo": "miuzei", "firmware_gain": 1.0, "control": "position", "trajectory": "step"}
    assert {fault.code: fault.count for fault in one.faults} == {"nominal_clock": 3, "rig_not_stated": 1}
    assert one.clock == "file"
    assert one.extra == {"meant_to_excite": ["kp"]}


def test_missing_readings_are_counted(tmp_path):
    """A null or NaN costs its sample and is counted."""
    recording = read_miuzei(write(tmp_path / "a.json", rollout(sensor_data=[0.0, None, float("nan")])))[0]
    assert recording.signal("position").t.size == 1
    assert ("not_finite", 2) in [(fault.code, fault.count) for fault in recording.faults]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"actions": [0.0]}, "1 actions but 3 readings"),
        ({"actions": []}, "'actions' is not a list with numbers"),
        ({"actions": "abc"}, "'actions' is not a list with numbers"),
        ({"actions": [0, True, 0]}, "'actions' holds 'True', expected numbers"),
        ({"actions": [0, "1", 0]}, "'actions' holds '1', expected numbers"),
        ({"sensor_data": [0, 45.0, 0]}, "'sensor_data' reaches 45, expected shares of half a turn"),
        ({"sensor_data": [None, None, None]}, "'sensor_data' holds no number"),
        ({"sensor_data": [0, 10**400, 0]}, "too large"),
    ],
)
def test_bad_rollouts(tmp_path, changes, complaint):
    """A rollout that cannot be used is named with what was found."""
    with pytest.raises(LogError, match=complaint):
        read_miuzei(write(tmp_path / "a.json", rollout(), rollout(**changes)))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "is not a Miuzei log"),
        ('{"data": [1]}', "is not a Miuzei log"),
        ('{"data": []}', "'data' is empty"),
        ('{"data": [{"actions": [0], "sensor_data": [0]}]}', "action_hz = 'None'"),
        ('{"config": {"action_hz": 0}, "data": [{"actions": [0], "sensor_data": [0]}]}', "action_hz = '0'"),
        ('{"config": {"action_hz": NaN}, "data": [{"actions": [0], "sensor_data": [0]}]}', "action_hz = 'nan'"),
        ("", "is empty"),
    ],
)
def test_not_a_miuzei_log(tmp_path, content, complaint):
    """What is no such file is refused with what was expected."""
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(LogError, match=complaint):
        read_miuzei(tmp_path / "a.json")


def test_cut_off(tmp_path):
    """A gzip file that was cut off is refused."""
    (tmp_path / "a.json.gz").write_bytes(gzip.compress(json.dumps([0] * 1000).encode())[:-9])
    with pytest.raises(LogError, match="damaged gzip"):
        read_miuzei(tmp_path / "a.json.gz")


ANY = st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=3), st.lists, max_leaves=8)


@settings(max_examples=80, deadline=None)
@given(actions=ANY, readings=ANY, kind=ANY, rate=ANY)
def test_any_json_is_read_or_refused(tmp_path_factory, actions, readings, kind, rate):
    """Whatever a rollout holds, it is read or refused, and nothing else happens."""
    path = tmp_path_factory.mktemp("fuzz") / "a.json"
    bad = {"type": kind, "actions": actions, "sensor_data": readings}
    for config in ({"action_hz": rate}, {"action_hz": 50}):
        write(path, bad, config=config)
        try:
            read_miuzei(path)
        except LogError:
            continue


def test_the_published_rollouts(shared_dir):
    """All 96 rollouts are there, on the encoder's grid, and follow their goals some samples late."""
    path = shared_dir / "data" / "servo_miuzei" / "response.json.gz"
    if not path.exists():
        pytest.skip("no Miuzei log in the shared data")
    recordings = read_miuzei(path)
    kinds = Counter(one.rig.trajectory for one in recordings)
    assert kinds == {"step": 30, "prbs": 21, "square": 20, "ramp": 12, "triangle": 12, "chirp": 1}
    for one in recordings:
        counts = one.signal("position").y / (2 * np.pi / 4095)
        assert np.abs(counts - np.round(counts)).max() < 1e-6
        assert abs(one.signal("position").y[0]) < 0.004
        assert np.abs(one.signal("goal").y).max() <= 0.625 * np.pi + 1e-9
    lags = [lag_of(one) for one in recordings if one.rig.trajectory == "prbs"]
    assert min(lags) in (4, 5)


def lag_of(recording):
    goal, position = recording.signal("goal").y, recording.signal("position").y
    apart = [np.abs(goal[: goal.size - lag] - position[lag:]).mean() for lag in range(1, 12)]
    return 1 + int(np.argmin(apart))

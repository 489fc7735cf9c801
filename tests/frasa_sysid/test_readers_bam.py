import gzip
import json
import re
from collections import Counter

import numpy as np
import pytest

from frasa_sysid.errors import LogError
from frasa_sysid.readers.bam import read_bam


def bam(n=20, **header):
    entries = [
        {
            "position": 0.01 * i,
            "speed": 1.0,
            "load": 3,
            "input_volts": 12.0,
            "temp": 30,
            "timestamp": 5.0 + 0.01 * i,
            "goal_position": 0.02 * i,
            "torque_enable": i < 10,
        }
        for i in range(n)
    ]
    facts = {
        "mass": 0.5,
        "arm_mass": 0.01,
        "length": 0.1,
        "kp": 32,
        "vin": 12.0,
        "motor": "MX106",
        "trajectory": "sin_sin",
    }
    return facts | {"offset": 0.25} | header | {"entries": entries}


def write(path, log):
    path.write_text(json.dumps(log))
    return path


def test_raw_log(tmp_path):
    """Header facts and entries arrive under frasa's names and units; what has no place is kept."""
    recording = read_bam(write(tmp_path / "a.json", bam()))[0]
    assert recording.rig.known() == {
        "servo": "mx106",
        "mass": 0.5,
        "length": 0.1,
        "arm_mass": 0.01,
        "firmware_gain": 32.0,
        "supply_voltage": 12.0,
        "control": "position",
        "trajectory": "sin_sin",
    }
    assert {name: signal.unit for name, signal in recording.signals.items()} == {
        "position": "rad",
        "velocity": "rad/s",
        "load": "raw",
        "supply_voltage": "V",
        "temperature": "degC",
        "goal": "rad",
        "torque_enable": "1",
    }
    assert recording.extra == {"offset": 0.25}
    assert recording.clock == "file"
    assert recording.signal("position").t[0] == 0
    assert recording.signal("torque_enable").y.sum() == 10


def test_packed_and_processed(tmp_path):
    """A gzipped log reads the same; a processed one may leave its stamps to `dt`."""
    log = bam(dt=0.005)
    for entry in log["entries"]:
        del entry["timestamp"]
    (tmp_path / "a.json.gz").write_bytes(gzip.compress(json.dumps(log).encode()))
    position = read_bam(tmp_path / "a.json.gz")[0].signal("position")
    np.testing.assert_allclose(position.t, 0.005 * np.arange(20))


def test_missing_values_are_counted(tmp_path):
    """A null or absent value costs that sample of that signal, and is counted."""
    log = bam()
    log["entries"][3]["position"] = None
    del log["entries"][9]["position"]
    recording = read_bam(write(tmp_path / "a.json", log))[0]
    assert recording.signal("position").t.size == 18
    assert recording.signal("velocity").t.size == 20
    assert [(fault.code, fault.count) for fault in recording.faults] == [("not_finite", 2)]


def test_degrees(tmp_path):
    """Goals in degrees are refused unless declared; then angles and speeds are converted."""
    log = bam()
    for entry in log["entries"]:
        entry["goal_position"] *= 100
    with pytest.raises(LogError, match="looks like degrees"):
        read_bam(write(tmp_path / "a.json", log))
    recording = read_bam(tmp_path / "a.json", unit="deg")[0]
    assert recording.signal("velocity").y[0] == pytest.approx(np.deg2rad(1.0))
    assert recording.signal("goal").y[-1] == pytest.approx(np.deg2rad(38.0))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[1]", "not a BAM log"),
        ('{"mass": 1}', "not a BAM log"),
        ('{"entries": []}', "'entries' is empty"),
        ('{"entries": [{"speed": 1, "timestamp": 0}]}', "no position"),
        ('{"entries": [{"position": 1}]}', "neither a 'timestamp'"),
        ('{"entries": [{"position": null, "timestamp": 0}]}', "no position"),
        ('{"mass": "heavy", "entries": [{"position": 1, "timestamp": 0}]}', "'mass' = 'heavy', expected a number"),
        ('{"mass": -1, "entries": [{"position": 1, "timestamp": 0}]}', "mass = -1"),
        ('{"entries": [{"position": 1, "timestamp": 0}, {"position": "x", "timestamp": 1}]}', "not a number"),
        ("", "is empty"),
    ],
)
def test_not_a_bam_log(tmp_path, content, complaint):
    """What is no BAM log is refused with what was expected."""
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(LogError, match=complaint):
        read_bam(tmp_path / "a.json")


def test_damaged_gzip(tmp_path):
    """A gzip file that was cut is an error of that file."""
    packed = gzip.compress(json.dumps(bam(200)).encode())
    (tmp_path / "a.json.gz").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(LogError, match="damaged gzip"):
        read_bam(tmp_path / "a.json.gz")


def read_folder(folder):
    if not folder.is_dir():
        pytest.skip(f"no real logs: expected a folder {folder.name} in the shared data")
    recordings = [read_bam(path)[0] for path in sorted(folder.glob("*.json.gz"))]
    counts, logs = Counter(), Counter()
    for fault in (fault for recording in recordings for fault in recording.faults):
        counts[fault.code] += fault.count
        logs[fault.code] += 1
    return recordings, counts, logs


def test_sts3215_bench(shared_dir):
    """The 96 logs of the STS3215 bench have 19 failed reads in 16 of them, and a wrong voltage in all."""
    recordings, counts, logs = read_folder(shared_dir / "data" / "sts3215")
    assert len(recordings) == 96
    assert (counts["failed_read"], logs["failed_read"]) == (19, 16)
    assert logs["voltage_contradicted"] == 96
    assert (counts["averaged_read"], logs["averaged_read"]) == (18, 15)
    assert set(logs) <= {"failed_read", "averaged_read", "voltage_contradicted", "gap"}
    assert counts["gap"] <= 20
    for recording in recordings:
        assert recording.signal("position").y.min() > -2.6
        assert 11.8 <= np.median(recording.signal("supply_voltage").y) <= 12.2
        enable = recording.signal("torque_enable").y
        assert (enable == 0).sum() == (400 if recording.rig.trajectory == "lift_and_drop" else 0)


def test_xl330_bench(shared_dir):
    """XL330 loads are signed again, and the two rates of the drop are told with their periods."""
    recordings, _, logs = read_folder(shared_dir / "data" / "xl330")
    assert len(recordings) == 16
    for recording in recordings:
        load = recording.signal("load").y
        assert load.min() >= -885
        assert load.max() <= 885
        mixed = [fault.message for fault in recording.faults if fault.code == "mixed_rates"]
        assert bool(mixed) == (recording.rig.trajectory == "lift_and_drop")
        if mixed:
            assert re.search(r"every 5\.\d\d ms and every 3\.\d\d ms", mixed[0])
    assert logs["unsigned_load"] == 12


def test_sts3250_bench(shared_dir):
    """STS3250 logs read without a fault but the two rates of the one drop."""
    recordings, _, logs = read_folder(shared_dir / "data" / "sts3250_bam")
    assert len(recordings) == 4
    assert logs == {"mixed_rates": 1}

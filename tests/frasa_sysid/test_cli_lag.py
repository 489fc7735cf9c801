import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.cli import build_parser
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap


def recording(name="a", delay=0.0123, columns=("hip", "knee")):
    t = np.arange(0, 12, 0.01)
    x = lambda t: 0.5 * np.sin(4 * t) + 0.2 * np.sin(9 * t + 1)  # noqa: E731
    v = lambda t: 2.0 * np.cos(4 * t) + 1.8 * np.cos(9 * t + 1)  # noqa: E731
    y = np.stack([x(t), x(t)], axis=1)
    dy = np.stack([v(t - delay), v(t - 2 * delay)], axis=1)
    signals = {
        "position": Signal("position", "rad", t, y, columns),
        "velocity": Signal("velocity", "rad/s", t, dy, columns),
        "goal": Signal("goal", "rad", t, y, columns),
    }
    return Recording(name, signals, RigFacts(), "simulated", "none", "", "file")


@pytest.fixture
def log(tmp_path):
    write_mcap(tmp_path / "robot.mcap", [recording("a"), recording("b")])
    return tmp_path / "robot.mcap"


def run(*words):
    args = build_parser().parse_args([str(word) for word in words])
    return args.run(args)


def cells_of(text, columns):
    """What stands in the first columns of the tables in a text, by row, folded cells put together."""
    rows = []
    for line in text.splitlines():
        if line.startswith("│"):
            cells = [cell.strip() for cell in line.split("│")[1:-1]]
            if cells[2]:  # a number, which is never folded: a row begins
                rows.append([""] * columns)
            rows[-1] = [old + new for old, new in zip(rows[-1], cells, strict=False)]
    return rows


def test_names_are_never_cut(tmp_path, capsys, monkeypatch):
    """Rows whose names start alike are told apart also where no terminal is; what is too long is folded."""
    joints = tuple(f"right_shoulder_of_the_big_robot_{axis}" for axis in ("pitch", "roll"))
    log = tmp_path / "a_log_with_quite_a_long_name.mcap"
    write_mcap(log, [recording("a", columns=joints), recording("b", columns=joints)])
    run("lag", log)
    text = capsys.readouterr().err
    assert "…" not in text
    assert max(len(line) for line in text.splitlines() if line.startswith("│")) == 120
    told = [[f"{log.name}#0{i}", joint] for i in (0, 1) for joint in joints]
    assert cells_of(text, 2) == told

    one = recording()
    names = [f"position@/{'right_shoulder_' * 6}{axis}" for axis in ("pitch", "roll")]
    signals = {name: replace(one.signals["position"], name=name) for name in names}
    monkeypatch.setattr("frasa_sysid.commands.inspect.read_within", lambda *_: [replace(one, signals=signals)])
    run("inspect", tmp_path)
    text = capsys.readouterr().err
    assert "…" not in text
    assert [cell.replace(" ", "") for (cell,) in cells_of(text.split("What these")[0], 1)] == [
        f"{name}x2" for name in names
    ]


def test_lag_by_joint_and_report(log, tmp_path, capsys):
    """Each joint by log and together; the page is written and needs nothing from elsewhere."""
    result = run("lag", log, "--report", tmp_path / "lag.html")
    assert result["schema"] == "frasa.lag/1"
    assert [(one["recording"], one["joint"]) for one in result["logs"]] == [
        ("robot.mcap#00", "hip"),
        ("robot.mcap#00", "knee"),
        ("robot.mcap#01", "hip"),
        ("robot.mcap#01", "knee"),
    ]
    together = {one["joint"]: one for one in result["joints"]}
    assert together["hip"]["delay"] == pytest.approx(0.0123, abs=1e-4)
    assert together["knee"]["delay"] == pytest.approx(0.0246, abs=1e-4)
    assert together["hip"]["verdict"] == "identified"
    text = capsys.readouterr().err
    assert "hip: 12.3" in text
    page = (tmp_path / "lag.html").read_text()
    assert "velocity against position" in page
    assert "http" not in page.split("<body>")[1]


def test_one_joint_and_another_pair(log):
    """Only what was asked for."""
    result = run("lag", log, "--of", "position", "--against", "goal", "--joint", "knee")
    assert {one["joint"] for one in result["logs"]} == {"knee"}
    assert result["joints"][0]["delay"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("words", "error", "complaint"),
    [
        (("--of", "gyro"), LogError, "no 'gyro' signal; it has goal, position, velocity"),
        (("--joint", "ankle"), LogError, "no column 'ankle'; it has hip, knee"),
        (("--longest", "0"), UsageError, "expected 0.001 to 10 s"),
        (("--longest", "nan"), UsageError, "expected 0.001 to 10 s"),
    ],
)
def test_bad_requests(log, words, error, complaint):
    """One line with what there is."""
    with pytest.raises(error, match=complaint):
        run("lag", log, *words)


def test_exit_status_and_json(log, tmp_path):
    """Plain JSON on standard output; 3 for a file that is no log, 2 for no file at all."""
    call = [sys.executable, "-m", "frasa_sysid.cli", "lag"]
    done = subprocess.run([*call, str(log), "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["logs"]) == 4
    (tmp_path / "bad.mcap").write_text("{}")
    done = subprocess.run([*call, str(tmp_path / "bad.mcap")], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert len(done.stderr.strip().splitlines()) == 1
    assert subprocess.run(call, capture_output=True, check=False).returncode == 2


def test_logs_without_the_channel_are_left_out(log, tmp_path, capsys):
    """One log that lacks a channel costs the others nothing, and is named."""
    bare = recording("c")
    bare = replace(bare, signals={"position": bare.signals["position"]})
    write_mcap(tmp_path / "bare.mcap", [bare])
    assert len(run("lag", log, tmp_path / "bare.mcap")["logs"]) == 4
    assert "left out: 1 of 3 logs; bare.mcap#00 has no 'velocity'" in capsys.readouterr().err


def test_inspect_names_joints_and_clocks(tmp_path, capsys):
    """What looks wrong with a joint, and how two clocks run, in text and JSON."""
    one = recording()
    position = one.signals["position"]
    wrong = replace(position, y=position.y * np.array([1.0, -1.0]))
    velocity = one.signals["velocity"]
    turned = replace(velocity, y=velocity.y * np.array([1.0, -1.0]))
    drift = {"value": 118.0, "low": 112.0, "high": 124.0}
    extra = {"clocks": [{"of": "host", "against": "servo", "offset_ms": None, "drift_ppm": drift}]}
    signals = {**one.signals, "position": wrong, "velocity": turned}
    write_mcap(tmp_path / "wrong.mcap", [replace(one, signals=signals, extra=extra)])
    result = run("inspect", tmp_path / "wrong.mcap")
    assert [(check["code"], check["joint"]) for check in result["checks"]] == [("wrong_sign", "knee")]
    clocks = result["recordings"][0]["clocks"]
    assert clocks["compared"][0]["drift_ppm"] == drift
    assert clocks["jitter"]["position"]["period_ms"] == pytest.approx(10.0)
    text = " ".join(capsys.readouterr().err.split())
    assert "sign of knee looks wrong" in text
    assert "host against servo: drift +118.0 ppm (± 6.0)" in text

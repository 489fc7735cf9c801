"""A fit of a bench looks at its logs first: a wrong sign is refused, a servo that hangs below its goal is told of."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.bench import people_console
from frasa_sysid.commands.bench_checks import check_bench
from frasa_sysid.errors import LogError
from frasa_sysid.joint_checks import Check, checks
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Recording, RigFacts, Signal

MAP = """\
[time]
column = "t"
unit = "s"
[[signal]]
column = "goal"
signal = "goal"
unit = "rad"
[[signal]]
column = "angle"
signal = "position"
unit = "rad"
scale = {scale}
"""


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


@pytest.fixture(scope="module")
def runs(robot_model_dir):
    """Three runs of the project's own bench, of one load and one gain, that turn to both sides."""
    every = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    return [one for one in every if (one.rig.mass, one.rig.firmware_gain) == (0.535, 16.0)][:3]


def imported(tmp_path, runs, scale):
    """The runs as tables, brought in with a map that scales the position."""
    (tmp_path / "map.toml").write_text(MAP.format(scale=scale))
    for i, one in enumerate(runs):
        goal, position = one.signal("goal"), one.signal("position")
        frame = {"t": position.t, "goal": np.interp(position.t, goal.t, goal.y), "angle": position.y}
        pd.DataFrame(frame).to_csv(tmp_path / f"run{i}.csv", index=False)
    sources = sorted(tmp_path.glob("run*.csv"))
    words = ("--format", "csv", "--map", tmp_path / "map.toml", "--out", tmp_path / "logs")
    assert frasa("import", *sources, *words) == 0
    return tmp_path / "logs"


def fit_words(logs, model_dir):
    facts = ("--servo", "mx106", "--mass", 0.535, "--length", 0.15, "--firmware-gain", 16, "--supply-voltage", 15)
    few = ("--restarts", 1, "--evaluations", 10, "--no-report", "--threads", 1)
    return ("fit", logs, *facts, *few, "--model", model_dir / "nominal.xml", "--publish")


def test_a_wrong_sign_is_no_model(tmp_path, runs, model_dir, capsys):
    """Exit 3 and one line, before the fit; nothing is written. With the right sign the same command publishes."""
    logs = imported(tmp_path, runs, -1)
    before = sorted(model_dir.rglob("*"))
    capsys.readouterr()
    assert frasa(*fit_words(logs, model_dir)) == 3
    err = capsys.readouterr().err
    assert "run1.mcap#00 would mislead a fit: sign of the joint looks wrong" in err
    assert "(2 of 3 runs alike)" in err
    assert err.count("\n") == 1
    assert sorted(model_dir.rglob("*")) == before
    logs = imported(tmp_path, runs, 1)
    assert frasa(*fit_words(logs, model_dir)) == 0
    assert (model_dir / "calibrated.xml").is_file()


def hanging(share, shift=0.0):
    """A run whose servo goes a share of the way to a goal that gravity keeps it from, at 100 Hz, its zero shifted."""
    t = np.linspace(0.0, 4.0, 400)
    goal = -np.pi / 4 * (1 - np.cos(2 * t))
    signals = {name: Signal(name, "rad", t, y) for name, y in (("goal", goal), ("position", share * goal + shift))}
    rig = RigFacts("xl330", mass=0.1, length=0.1, firmware_gain=40.0, supply_voltage=5.0)
    return Recording("weak", signals, rig, "real", "a.mcap", "0" * 64, "log")


@pytest.mark.parametrize(("share", "shift", "code"), [(0.25, 0.0, "hangs_below"), (1.0, -0.5, "wrong_zero")])
def test_a_servo_far_from_its_goal_is_said(capsys, share, shift, code):
    """Too weak for its load or a shifted encoder: one log alone cannot tell, so the fit goes on with one line each."""
    run = hanging(share, shift)
    found = {one.code for one in checks(run)}
    assert code in found
    check_bench(people_console(), [run, replace(run, name="other")])
    lines = capsys.readouterr().err.strip().splitlines()
    assert {one.partition(": 2 of 2 runs, such as weak: ")[0] for one in lines} == found
    assert len(lines) == len(found)


@pytest.mark.parametrize(("code", "refused"), [("velocity_sign", True), ("slow_rate", True), ("wrong_zero", False)])
def test_only_what_a_weak_servo_can_do_is_let_pass(monkeypatch, code, refused):
    """Every check that refuses does so here, but the one that a low gain under a load comes to as well."""
    found = [Check("weak", code, "", "refuse", "something")]
    monkeypatch.setattr("frasa_sysid.commands.bench_checks.all_checks", lambda _: found)
    if refused:
        with pytest.raises(LogError, match="weak would mislead a fit: something"):
            check_bench(people_console(), [hanging(1.0)])
    else:
        check_bench(people_console(), [hanging(1.0)])


def test_real_logs_of_weak_servos_pass(shared_dir, tmp_path):
    """XL330 runs at low P hang 30 degrees below their goals; nothing in them is refused."""
    logs = sorted((shared_dir / "data" / "xl330").glob("*.json.gz"))
    if not logs:
        pytest.skip("no XL330 logs in shared/data")
    assert frasa("import", *logs, "--format", "bam", "--out", tmp_path / "xl330") == 0
    recordings = [one for path in sorted((tmp_path / "xl330").glob("*.mcap")) for one in read_log(path)]
    check_bench(people_console(), recordings)

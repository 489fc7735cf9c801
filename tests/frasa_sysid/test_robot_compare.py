"""Robots held against logs: what was published against what was fitted, the page of a fit, and bad input."""

import json
import re
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.calibration import apply, load_model, read, run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands import fit_robot as command
from frasa_sysid.errors import QualityError
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.recording import Signal
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_candidate import candidate_of
from frasa_sysid.robot_check import check_published_robot
from frasa_sysid.robot_compare import compare_robot, last_share, of_model
from frasa_sysid.robot_errors import errors_by_channel, series
from frasa_sysid.robot_fit import RECORD
from frasa_sysid.robot_rig import robot_run
from frasa_sysid.robot_simulator import RobotSimulator, pieces_of
from frasa_sysid.robot_truth import draw
from frasa_sysid.simulate_robot import IDEAL, simulate_robot
from frasa_sysid.writer import write_mcap

SHARE = "0.4"


@pytest.fixture(scope="module")
def held(held_robot):
    """Four and a half seconds of a held robot."""
    return held_robot(4.5, "held.mcap")


@pytest.fixture(scope="module")
def ground(robot_model_dir):
    """Two seconds of the same robot on its feet."""
    path = robot_model_dir / "nominal.xml"
    joints = joints_of(path)
    truth = replace(draw("floating", 5, joints.classes, joints.names), zeros=None)
    return simulate_robot(path, joints, truth, standing(joints, 10.0), 2.4, "ground.mcap", IDEAL, timestep=0.0005)


@pytest.fixture(scope="module")
def place(robot_model_dir, held, ground, tmp_path_factory):
    """Logs, models and bench fits, and a fit of the robot that was published with its page."""
    folder = tmp_path_factory.mktemp("robot") / "robot_model"
    shutil.copytree(robot_model_dir, folder)
    shutil.copytree(robot_model_dir, folder.parent / "benches")
    write_mcap(folder.parent / "held.mcap", [held])
    write_mcap(folder.parent / "ground.mcap", [ground])
    real, kept = command.fit_robot, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "fit_robot", lambda *words: kept.append(real(*words)) or kept[-1])
        words = ["fit", folder.parent / "held.mcap", folder.parent / "ground.mcap", "--model", folder / "nominal.xml"]
        words += ["--free", "delays,gain", "--hold-out-share", SHARE, "--position-delay", "0.003", "--publish"]
        assert run_command(build_parser(), [str(word) for word in words]) == 0
    return folder, kept[0]


def compared(capsys, place, *words, logs=("held.mcap",)):
    """What `compare` prints for machines."""
    folder = place[0]
    given = [folder.parent / log for log in logs]
    quiet = () if "--report" in words else ("--no-report",)
    arguments = ["compare", *given, "--model", folder / "nominal.xml", *words, *quiet, "--json"]
    status = run_command(build_parser(), [str(word) for word in arguments])
    out, err = capsys.readouterr()
    assert status == 0, err
    return json.loads(out)


def test_what_was_published_is_what_was_fitted(place, capsys):
    """The model by its own numbers and the fit by its file agree, on the part that the fit never saw too."""
    folder, found = place
    words = ("--with-model", folder / "calibrated.xml", "--fit", folder / "fits" / "robot.json")
    data = compared(capsys, place, *words, "--hold-out-share", SHARE, logs=("held.mcap", "ground.mcap"))
    assert data["schema"] == "frasa.compare/1"
    assert (data["kind"], data["hold_out_share"]) == ("robot", 0.4)
    nominal, model, fit = (data["candidates"][name] for name in ("nominal", "calibrated.xml", "robot.json"))
    assert data["misfit"] == fit
    assert model["mae_rad"] == pytest.approx(fit["mae_rad"], abs=1e-9)
    for channel, (mae, rmse) in found.errors["held_out_fitted"].items():
        assert fit["by_channel"][channel]["mae"] == pytest.approx(mae, abs=1e-9), channel
        assert model["by_channel"][channel]["rmse"] == pytest.approx(rmse, abs=1e-9), channel
    assert model["mae_rad"] < 0.6 * nominal["mae_rad"]
    assert set(model["by_log"]) == {"held.mcap#00", "ground.mcap#00"}
    assert set(model["by_joint"]) == set(found.problem.runs[0].joints)
    assert set(model["by_channel"]["orientation"]["by_joint"]) == {"roll", "pitch"}
    assert model["by_channel"]["gyro"]["unit"] == "rad/s"
    assert model["blown_up"] == 0


def test_a_model_with_delays_of_its_own_for_each_servo(place, capsys):
    """A model of bench fits keeps the delay of every servo class; so do the fits that made it."""
    folder = place[0]
    path = folder.parent / "benches" / "calibrated.xml"
    model = load_model(path)
    assert abs(read(model, "mx64.delay") - read(model, "mx106.delay")) > 1e-3
    fits = ("--fit", folder / "fits" / "mx64.json", "--fit", folder / "fits" / "mx106.json")
    data = compared(capsys, place, "--with-model", path, *fits)
    model, benches = data["candidates"]["calibrated.xml"], data["candidates"]["mx64.json + mx106.json"]
    assert model["by_joint"] == pytest.approx(benches["by_joint"], abs=1e-9)
    assert model["mae_rad"] < data["candidates"]["nominal"]["mae_rad"]


def test_mujocos_own_delays_say_the_same(place, ground):
    """Stepped by mj_step with its native delays and sensors, the published model reads what `compare` says it reads."""
    folder = place[0]
    path = folder / "calibrated.xml"
    two = compare_robot(of_model("model", path), [ground], None, last_share(0.0), 1)
    model = load_model(path)
    run = robot_run(ground, model)
    first, end = 0, int(two[0].samples.t[two[0].samples.piece == 0].max() / model.opt.timestep)
    apply(model, {"supply_voltage": float(run.supply[first : end + 1].mean())})
    data = mujoco.MjData(model)
    with RobotSimulator(path, "floating", 1) as simulator:
        piece, one = pieces_of(run, simulator.timestep, 1.0, 0.1)[0], of_model("model", path).candidate
        state = next(simulator.simulate([piece], [one], one))[2][0]
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    size = int(model.actuator_history[0, 0])
    times = (np.arange(size) - size) * model.opt.timestep
    for i in range(model.nu):
        mujoco.mj_initCtrlHistory(model, data, i, times, np.full((size, 1), run.goal[0, i]))
    read_at, knee, speed, gyro = [], [], [], []
    for k in range(end):
        data.ctrl[:] = run.goal[k]
        mujoco.mj_step(model, data)  # sensors are those of its beginning
        read_at.append(k * model.opt.timestep)
        knee.append(data.sensor("left_knee.position").data[0])
        speed.append(data.sensor("left_knee.velocity").data[0])
        gyro.append(data.sensor("measured_gyro").data[1])
    for told, channel, joint, allowed in (
        (knee, "position", "left_knee", 2e-5),
        (speed, "velocity", "left_knee", 2e-3),
        (gyro, "gyro", "y", 2e-3),
    ):
        one = series(two, "ground.mcap", channel, joint)
        part = (one.piece == 0) & (one.t < read_at[-1])
        ours = (one.y + one.residuals)[part]
        assert np.ptp(ours) > 10 * allowed
        theirs = np.interp(one.t[part], read_at, told)
        assert np.abs(ours - theirs).mean() < allowed, channel


def test_delays_that_mujoco_cannot_have(place):
    """MuJoCo takes a delay below its step for a whole one, of commands and sensors; so does the comparison."""
    model = load_model(place[0] / "calibrated.xml")
    step = model.opt.timestep
    apply(model, {"mx64.delay": 0.4 * step, "mx106.delay": 0.0, "sensor.position_delay": 0.3 * step})
    one = candidate_of(model)
    assert one.command_delays == pytest.approx({"mx64": 0.5 * step, "mx106": -0.5 * step})
    assert one.ages["position"] == step
    data = mujoco.MjData(model)
    knee = model.joint("left_knee")
    data.qvel[knee.dofadr[0]] = 1.0
    for _ in range(4):
        before = data.qpos[knee.qposadr[0]]
        mujoco.mj_step(model, data)
        now = data.qpos[knee.qposadr[0]]
        mujoco.mj_forward(model, data)
        assert data.sensor("left_knee.position").data[0] == before != now


def test_a_model_that_is_not_what_was_fitted(place, tmp_path):
    """The check of a publication passes what was published, and fails on two milliseconds of another delay."""
    folder, found = place
    robot = stored_robot_fit.load(folder / "fits" / "robot.json")
    fits = [stored_fit.load(folder / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]
    mean, count = check_published_robot(folder / "calibrated.xml", found, robot, fits, folder / "nominal.xml", 1)
    assert mean < 1e-9
    assert count == 4
    text = (folder / "calibrated.xml").read_text()
    delay = f'delay="{read(load_model(folder / "calibrated.xml"), "mx64.delay")!r}"'
    assert delay in text
    other = folder / "other.xml"
    other.write_text(text.replace(delay, 'delay="0.02"'))
    with pytest.raises(QualityError, match="away from the fit"):
        check_published_robot(other, found, robot, fits, folder / "nominal.xml", 1)
    other.unlink()


def test_the_page_of_a_fit(place, page_text):
    """One file with the numbers, intervals, verdicts, errors and pictures, and nothing from elsewhere."""
    pytest.importorskip("matplotlib")
    folder, found = place
    path = folder / "fits" / "robot.html"
    assert "Residuals by joint" in page_text(path)
    text = path.read_text()
    for one in found.estimates():
        scale = 1e3 if one.name.endswith("delay") else 1.0
        assert f"{one.value * scale:.4g}" in text, one.name
        assert f"{one.low * scale:.4g} to {one.high * scale:.4g}" in text, one.name
        assert one.name in text
    assert f"{found.errors['held_out_fitted']['position'][0] * 1e3:.3g} (rms" in text
    assert "known as a sum only" in text
    assert "positions are taken to be 3 ms old" in text
    assert len(re.findall(r"<img ", text)) == 4  # joints, trunk, residuals, correlation
    assert "held out" in text


def test_the_page_of_a_comparison(place, capsys, page_text):
    """Traces of the worst and typical joints, and errors of every robot."""
    pytest.importorskip("matplotlib")
    page = place[0].parent / "compare.html"
    data = compared(capsys, place, "--with-model", place[0] / "calibrated.xml", "--report", page)
    assert data["outputs"]["report"] == str(page)
    for one in data["candidates"].values():
        assert f"{one['mae_rad'] * 1e3:.2f} mrad" in page_text(page)
    text = page.read_text()
    assert f"{data['misfit']['by_channel']['velocity']['mae']:.3g} (rms" in text
    assert len(re.findall(r"<img ", text)) == 2  # no trunk: it was held


@pytest.mark.parametrize(
    ("change", "words", "status", "line"),
    [
        ("joints", (), 3, "'position' lacks"),
        ("goal", (), 3, "no 'goal' signal"),
        ("base", (), 2, "give --base fixed or floating"),
        ("short", ("--hold-out-share", "0.1"), 3, "too short for a share"),
        ("", ("--hold-out-share", "0.95"), 2, "expected 0 to 0.9"),
        ("", ("--bam", "x.json"), 2, "--bam is for logs of a bench; a whole robot takes models and fits"),
        ("", ("--fit", "fits/moved.json"), 3, "stood on the bench fit"),
        ("", ("--fit", "fits/stranger.json"), 3, "made with another model"),
    ],
)
def test_what_cannot_be_compared(place, held, tmp_path, capsys, change, words, status, line):
    """One clear line each, and the exit status of its kind."""
    signals, folder = dict(held.signals), place[0]
    position = signals["position"]
    strange = Signal("position", "rad", position.t, position.y[:, :4], tuple("abcd"))
    changed = {
        "joints": {"signals": signals | {"position": strange}},
        "goal": {"signals": {name: one for name, one in signals.items() if name != "goal"}},
        "base": {"rig": replace(held.rig, base=None)},
        "short": {"signals": {name: _until(one, 2.0) for name, one in signals.items()}},
    }  # fmt: skip
    write_mcap(tmp_path / "log.mcap", [replace(held, **changed.get(change, {}))])
    (tmp_path / "fits").mkdir()
    data = json.loads((folder / "fits" / "robot.json").read_text())
    (tmp_path / "fits" / "moved.json").write_text(json.dumps({**data, "frozen": ["1" * 64]}))
    (tmp_path / "fits" / "stranger.json").write_text(
        json.dumps({**data, "model": {"name": "other", "fingerprint": "0" * 16}})
    )
    command = ["compare", tmp_path / "log.mcap", "--no-report", "--model", folder / "nominal.xml"]
    command += [tmp_path / word if str(word).endswith(".json") and "/" in word else word for word in words]
    assert run_command(build_parser(), [str(word) for word in command]) == status
    err = capsys.readouterr().err
    assert line in err.replace("\n", " "), err
    assert "Traceback" not in err


def _until(signal, end):
    kept = signal.t < end
    return Signal(signal.name, signal.unit, signal.t[kept], signal.y[kept], signal.columns)


def test_errors_weigh_every_sample(ground, place):
    """By log, by joint and over all are means of the same samples."""
    two = compare_robot(of_model("model", place[0] / "nominal.xml"), [ground], None, last_share(0.0), 1)
    errors = errors_by_channel(two)
    assert set(errors) == {"position", "velocity", "gyro", "orientation"}
    position = [i for i, name in enumerate(two[0].layout.names) if name.startswith("position ")]
    part = two[0].residuals[np.isin(two[0].layout.column, position)]
    assert errors["position"].mae == pytest.approx(np.mean(np.abs(part)))
    assert errors["position"].by_log == {"ground.mcap": pytest.approx(errors["position"].mae)}
    assert np.mean(list(errors["position"].by_joint.values())) == pytest.approx(errors["position"].mae)


def test_a_held_delay_is_the_models(place, capsys):
    """With delays not free the fit keeps the bench's own, so that what it publishes replays it."""
    folder = place[0].parent / "again"
    shutil.copytree(place[0], folder)
    (folder / "fits" / "robot.json").unlink()
    words = ["fit", place[0].parent / "held.mcap", "--model", folder / "nominal.xml", "--free", "friction", "--publish"]
    assert run_command(build_parser(), [str(word) for word in [*words, "--no-report", "--hold-out-share", "0.6"]]) == 0
    assert "of the logs within" in capsys.readouterr().err


def test_a_gyro_bias_is_what_the_trunk_did_not_turn(place, ground):
    """A robot that ends tilted otherwise than it began has turned; only the rest of the gyro's mean is its bias."""
    gyro = ground.signals["gyro"]
    bias = [ground.truth[f"imu.gyro_bias_{axis}"] for axis in "xyz"]
    assert np.abs(gyro.y.mean(axis=0) - bias).max() > 0.02
    run = robot_run(ground, load_model(place[0] / "nominal.xml"))
    assert (gyro.y - run.channels["gyro"].y)[0] == pytest.approx(bias, abs=1e-3)


def test_inspect_says_what_a_robots_log_can_tell(place, capsys, tmp_path, held):
    """A held trunk tells no delay of its IMU, a log without velocities none of theirs, in the words of the fit."""
    silent = {name: one for name, one in held.signals.items() if name != "velocity"}
    write_mcap(tmp_path / "silent.mcap", [replace(held, signals=silent)])
    said = {}
    slow = {name: Signal(one.name, one.unit, one.t[::20], one.y[::20], one.columns) for name, one in silent.items()}
    write_mcap(tmp_path / "slow.mcap", [replace(held, signals=slow)])
    for path in (tmp_path / "silent.mcap", tmp_path / "slow.mcap", place[0].parent / "ground.mcap"):
        assert run_command(build_parser(), ["inspect", str(path), "--json"]) == 0
        data = json.loads(capsys.readouterr().out)
        assert {one["servo"] for one in data["identifiable"]} == {"robot"}
        said[path.stem] = {one["parameter"]: one for one in data["identifiable"]}
    assert said["slow"]["anything"]["reason"] == "positions every 200 ms; no servo's motion is seen at that rate"
    assert said["silent"]["delay of the gyro"]["verdict"] == "no"
    assert said["silent"]["delay of the gyro"]["record"] == RECORD["sensor.gyro_delay"]
    assert said["silent"]["delay of velocities"]["record"] == RECORD["sensor.velocity_delay"]
    assert said["ground"]["delay of the gyro"]["verdict"] == "weak"  # slow at first
    assert said["ground"]["joint zeros"]["verdict"] == "yes"
    assert "sum" in said["ground"]["command delay"]["reason"]

"""Ways to hold a robot: what gravity does in them, and the way from goals over logs to a fit."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation_file import read_excitation
from frasa_sysid.excitation_hung import design
from frasa_sysid.excitation_information import information
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_trial import try_out
from frasa_sysid.holds import HOLDS, down, holds_of, up_of
from frasa_sysid.joint_checks import checks
from frasa_sysid.readers import read_log
from frasa_sysid.robot_body import joints_of, tilt_quaternion
from frasa_sysid.robot_findings import robot_findings


@pytest.fixture(scope="module")
def path(robot_model_dir):
    return robot_model_dir / "nominal.xml"


@pytest.fixture(scope="module")
def joints(path):
    return joints_of(path)


def command(*words):
    return run_command(build_parser(), [str(word) for word in words])


@pytest.mark.parametrize("name", HOLDS)
def test_gravity_is_that_of_a_turned_trunk(name):
    """What is turned in place of the trunk is MuJoCo's own rotation; an orientation read back tells the same."""
    quaternion = np.array(tilt_quaternion(HOLDS[name].roll, HOLDS[name].pitch))
    seen = np.empty(3)
    inverse = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    mujoco.mju_rotVecQuat(seen, np.array([0.0, 0.0, -1.0]), inverse)
    np.testing.assert_allclose(down(name), seen, atol=1e-12)
    np.testing.assert_allclose(up_of(3.0 * quaternion[None])[0], -seen, atol=1e-12)


def test_face_down_gravity_loads_the_yaw_joints(path, joints):
    """Hip yaw is told face down and not upright; both together tell no joint less than one does in its time."""
    sizes = fitted_sizes(path, joints, 10.0)[0]  # legs that touch would tell of yaw joints too
    upright, prone = (design(joints, sizes, 10.0, hold=hold) for hold in ("upright", "face-down"))
    assert not np.array_equal(upright.goals, prone.goals)
    alone, both = (information(path, joints, every) for every in ([upright], [upright, prone]))
    yaw = alone.names.index("left_hip_yaw.zero")
    assert both.sd[yaw] < 0.5 * alone.sd[yaw]
    assert (both.sd <= alone.sd * (1 + 1e-9)).all()
    assert both.shares.shape == (10, len(both.names))
    assert both.shares[5:, yaw].sum() > 0.9
    yaw = joints.names.index("left_hip_yaw")
    still = [float(try_out(path, joints, one).torque[0, yaw]) for one in (upright, prone)]
    assert still[1] > 3 * still[0]


def test_a_soft_servo_shows_more_of_gravity(path, joints):
    """With a third of the gain the same goals tell zeros better, and a delay worse."""
    sizes = fitted_sizes(path, joints, 10.0, firmware_gain=4.0)[0]
    stiff, soft = (information(path, joints, [design(joints, sizes, 10.0, firmware_gain=gain)]) for gain in (None, 4.0))
    ratio = dict(zip(soft.names, soft.sd / stiff.sd, strict=True))
    assert ratio["left_hip_roll.zero"] < 0.7
    assert ratio["left_shoulder_pitch.zero"] < 0.7
    assert ratio["mx106.delay"] > 1.0


@pytest.fixture(scope="module")
def written(path, tmp_path_factory):
    """Goals of two holds, and a short log of a robot that follows them, with the folder they are in."""
    folder = tmp_path_factory.mktemp("holds")
    out = folder / "e.mcap"
    words = ("--joints", "left_hip_yaw", "left_elbow", "--parameters", "mx64.delay", "--seconds", 20, "--csv")
    assert command("excite", "--model", path, "--out", out, *words) == 0
    files = [folder / f"e-{hold}.mcap" for hold in ("upright", "face-down")]
    assert sorted(folder.iterdir()) == sorted([*files, *(one.with_suffix(".csv") for one in files)])
    words = ("--excitation", *files, "--seconds", 5, "--out", folder / "r.mcap", "--seed", 3)
    assert command("simulate", "--robot", "--model", path, *words) == 0
    return folder


def test_each_hold_has_goals_and_a_log_of_its_own(written):
    """Files say how to hold the robot; the logs were taken so, of one robot, with noise of their own."""
    assert [read_excitation(written / f"e-{hold}.mcap").hold for hold in ("upright", "face-down")] == [
        "upright",
        "face-down",
    ]
    upright, prone = read_log(written / "r.mcap", "auto")
    assert (upright.truth["left_knee.zero"], upright.extra["hold"], prone.extra["hold"]) == (
        prone.truth["left_knee.zero"],
        "upright",
        "face-down",
    )
    for one, hold in ((upright, "upright"), (prone, "face-down")):
        seen = -up_of(one.signal("orientation").y).mean(axis=0)
        assert np.degrees(np.arccos(seen @ down(hold) / np.linalg.norm(seen))) < 15.0
    assert [one.rig.firmware_gain for one in (upright, prone)] == [4.0, 4.0]
    bias = [upright.truth[f"imu.gyro_bias_{axis}"] for axis in "xyz"]
    count = min(one.signal("gyro").t.size for one in (upright, prone))
    noise = [(one.signal("gyro").y[:count] - bias)[:, 0] for one in (upright, prone)]
    assert abs(np.corrcoef(noise)[0, 1]) < 0.2
    verdicts = [{one.parameter: one.verdict for one in robot_findings(some)} for some in ([upright], [upright, prone])]
    assert [one["joint zeros"] for one in verdicts] == ["weak", "yes"]


def test_a_fit_takes_all_holds_of_a_file(written, robot_model_dir, capsys):
    """Both runs count, from the command line."""
    words = ("fit", written / "r.mcap", "--model", robot_model_dir / "nominal.xml", "--free", "zeros", "--no-report")
    assert command(*words, "--out", written / "robot.json", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["base"] == "fixed"
    truth = read_log(written / "r.mcap", "auto")[0].truth["left_hip_yaw.zero"]
    assert found["parameters"]["left_hip_yaw.zero"]["value"] == pytest.approx(truth, abs=np.radians(1.0))


def test_a_trunk_that_is_turned_while_it_is_held_is_named(written):
    """A few degrees of wander pass no one's notice; the noise of an IMU does."""
    log = read_log(written / "r.mcap", "auto")[1]
    assert "trunk_moved" not in {one.code for one in checks(log)}
    q = log.signals["orientation"]
    slow = np.linspace(0.0, np.radians(20.0), q.t.size)
    turned = np.empty_like(q.y)
    for row, was, angle in zip(turned, q.y, slow, strict=True):
        mujoco.mju_mulQuat(row, np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]), was)
    moved = replace(log, signals={**log.signals, "orientation": replace(q, y=turned)})
    (found,) = [one for one in checks(moved) if one.code == "trunk_moved"]
    assert (found.level, "tilted by 10 deg" in found.message) == ("warn", True)


def test_simulate_makes_the_recommended_set(path, tmp_path, capsys):
    """One command, one file, a run a hold; a tilt of one's own is one run; what cannot be together is refused."""
    out = tmp_path / "r.mcap"
    words = ("simulate", "--robot", "--model", path, "--out", out, "--seconds", 1)
    assert command(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["holds"] == ["upright", "face-down"]
    assert [one.duration for one in read_log(out, "auto")] == pytest.approx([0.5, 0.5], abs=0.05)
    assert command(*words, "--pitch", 30) == 0
    assert len(read_log(out, "auto")) == 1
    assert command(*words, "--holds", "side", "--firmware-gain", 12) == 0
    assert [one.rig.firmware_gain for one in read_log(out, "auto")] == [12.0]
    for wrong in (
        ("--pitch", 30, "--holds", "side"),
        ("--base", "floating", "--holds", "side"),
        ("--seconds", 0.6),
        ("--firmware-gain", 0),
    ):
        assert command(*words, *wrong) == 2
    assert capsys.readouterr().err.count("\n") >= 4


def test_names_of_holds():
    """Each once, and known."""
    assert holds_of(None) == ("upright", "face-down")
    assert holds_of("side") == ("side",)
    for wrong in ("side,side", "sideways", ""):
        with pytest.raises(UsageError, match="expected some of upright"):
            holds_of(wrong)

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import run_command, sha256_of_file
from frasa_sysid.cli import build_parser
from frasa_sysid.excitation_file import read_excitation, write_csv, write_excitation
from frasa_sysid.excitation_hung import design, first_sizes
from frasa_sysid.excitation_information import information
from frasa_sysid.excitation_sizes import SPEED_SHARE, TORQUE_SHARE, fitted_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.excitation_trial import try_out
from frasa_sysid.readers import read_log
from frasa_sysid.robot_body import bare, build, joints_of
from frasa_sysid.robot_physics import simulate
from frasa_sysid.robot_truth import draw


@pytest.fixture(scope="module")
def path(robot_model_dir):
    return robot_model_dir / "nominal.xml"


@pytest.fixture(scope="module")
def joints(path):
    return joints_of(path)


@pytest.fixture(scope="module")
def fitted(path, joints):
    """Amplitudes for ten seconds, and their trial."""
    return fitted_sizes(path, joints, 10.0)


def test_parts_join_at_one_pose_within_the_command_limits(joints):
    """Each part starts and ends at the centre pose; no goal leaves the command limits; parts cover the time."""
    excitation = design(joints, first_sizes(joints), 12.0)
    centre = first_sizes(joints).centre
    assert (excitation.goals >= joints.low).all()
    assert (excitation.goals <= joints.high).all()
    assert excitation.seconds == pytest.approx(12.0, abs=0.1)
    for part in excitation.parts:
        np.testing.assert_allclose(excitation.at(np.array([part.start, part.end - 0.01])), [centre, centre], atol=0.02)
    assert [part.start for part in excitation.parts[1:]] == [part.end for part in excitation.parts[:-1]]


def test_every_joint_moves_by_itself(joints):
    """In the multisine no two joints move alike, each by nearly its whole amplitude, with a low crest factor."""
    excitation = design(joints, first_sizes(joints), 30.0)
    part = excitation.parts[1]
    inside = (excitation.t > part.start + 0.5) & (excitation.t < part.end - 0.5)
    motion = excitation.goals[inside] - excitation.goals[0]
    alike = np.corrcoef(motion.T) - np.eye(len(joints.names))
    assert np.abs(alike).max() < 0.75
    crest = np.abs(motion).max(axis=0) / motion.std(axis=0)
    assert crest.max() < 3.5


def test_limits_are_kept_on_the_nominal_model(path, joints, fitted):
    """Torque and speed shares are kept, by a replay of its own too, and no two parts of the robot touch."""
    sizes, trial = fitted
    assert trial.torque.max() <= TORQUE_SHARE
    assert trial.speed.max() <= SPEED_SHARE
    excitation = design(joints, sizes, 10.0)
    model = bare(path, held=True, plain=False)
    data = mujoco.MjData(model)
    index = [joints.names.index(model.joint(int(j)).name) for j in model.actuator_trnid[:, 0]]
    data.qpos[model.jnt_qposadr[[model.joint(name).id for name in joints.names]]] = excitation.goals[0]
    share, touched = 0.0, 0
    for goals in excitation.goals:
        data.ctrl[:] = goals[index]
        mujoco.mj_step(model, data, 5)
        share = max(share, float(np.abs(data.actuator_force / model.actuator_forcerange[:, 1]).max()))
        touched += int((data.contact.dist[: data.ncon] < 0).sum())
    assert share < TORQUE_SHARE + 0.02
    assert touched == 0


def test_an_untamed_excitation_touches_and_is_found_out(path, joints):
    """The trial sees what is wrong with amplitudes far too large."""
    wild = first_sizes(joints)
    trial = try_out(path, joints, design(joints, replace(wild, swing=wild.swing * 1.3), 10.0))
    assert trial.touching.max() == pytest.approx(1.0)
    assert trial.torque.max() > TORQUE_SHARE


def test_another_robot_does_not_touch_itself_either(path, joints, fitted):
    """A robot that is not the nominal one stays clear of itself too."""
    truth = draw("fixed", 2, joints.classes, joints.names)
    excitation = design(joints, fitted[0], 10.0)
    written = np.arange(-0.5, 10.0, 0.01)
    traces = simulate(build(path, truth, joints, 0.0005), joints, truth, written, excitation.at(written), 10.0)
    assert traces.touching == 0.0


@pytest.fixture(scope="module")
def told(path, joints, fitted):
    return information(path, joints, [design(joints, fitted[0], 10.0)])


def test_information_follows_the_motion(path, joints, fitted, told):
    """What moves is told; without arm motion the arms' zeros are not; steps tell the delay best."""
    sd = dict(zip(told.names, told.sd, strict=True))
    assert sd["mx106.gain_scale"] < 0.05
    assert sd["mx106.delay"] < 0.001
    assert sd["left_hip_yaw.zero"] > 3 * sd["left_hip_roll.zero"]
    sizes = fitted[0]
    arms = np.array(["shoulder" in name or "elbow" in name or "head" in name for name in joints.names])
    hips = np.array(["hip_yaw" in name for name in joints.names])
    still = replace(sizes, **{name: getattr(sizes, name) * ~(arms | hips) for name in ("swing", "quick", "step")})
    less = information(path, joints, [design(joints, still, 10.0)])
    quiet = dict(zip(less.names, less.sd, strict=True))
    assert quiet["mx64.damping_scale"] > 5 * sd["mx64.damping_scale"]
    assert quiet["mx106.damping_scale"] < 1.5 * sd["mx106.damping_scale"]
    assert told.shares.sum(axis=0) == pytest.approx(1.0)


def test_information_is_the_slope_of_the_readings(path, joints, told):
    """The predicted age of velocities is what accelerations say, by a sum of its own."""
    assert told.names[8] == "sensor.velocity_delay"
    assert 1e-5 < told.sd[8] < 1e-3


def test_information_hardly_depends_on_the_step(path, joints, fitted, told, model_dir):
    """A step that does not divide the period of the readings changes little: 3 ms are taken as 2.5."""
    coarse = model_dir / "nominal.xml"
    coarse.write_text(coarse.read_text().replace('timestep="0.002"', 'timestep="0.003"'))
    found = information(coarse, joints, [design(joints, fitted[0], 10.0)])
    np.testing.assert_allclose(found.sd, told.sd, rtol=0.1)


def test_files_hold_the_same_goals(joints, tmp_path):
    """MCAP and CSV carry the goals, the joints and, the first, the parts."""
    excitation = standing(joints, 10.0)
    write_excitation(tmp_path / "e.mcap", excitation, "floating")
    write_csv(tmp_path / "e.csv", excitation)
    back = read_excitation(tmp_path / "e.mcap")
    assert (back.joints, back.parts) == (excitation.joints, excitation.parts)
    np.testing.assert_array_equal(back.goals, excitation.goals)
    lines = (tmp_path / "e.csv").read_text().splitlines()
    assert lines[0].split(",") == ["time", *joints.names]
    table = np.loadtxt(lines[1:], delimiter=",")
    np.testing.assert_allclose(table[:, 0], excitation.t, atol=1e-6)
    np.testing.assert_allclose(table[:, 1:], excitation.goals, atol=1e-6)


def command(*words):
    return run_command(build_parser(), [str(word) for word in words])


def test_command_line_and_simulation_of_its_file(path, joints, tmp_path, capsys, made_of):
    """`excite` writes goals for some joints; `simulate --excitation` sends them."""
    out, log = tmp_path / "e.mcap", tmp_path / "r.mcap"
    words = ("excite", "--model", path, "--out", out, "--csv", "--holds", "upright", "--seconds", 10)
    assert command(*words, "--joints", "left_elbow", "head_yaw", "--parameters", "mx64.delay", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"]["mx64.delay"]["verdict"] == "good"
    assert told["parameters"]["mx106.gain_scale"]["verdict"] != "good"
    assert "sensor.gyro_delay" in told["untold"]
    assert (tmp_path / "e.csv").is_file()
    assert command("simulate", "--robot", "--model", path, "--excitation", out, "--seconds", 4, "--out", log) == 0
    goal, planned = read_log(log, "auto")[0].signal("goal"), read_excitation(out)
    # The log names the model and the goals that it was made of, the goals their model.
    assert sha256_of_file(out) in made_of(log)["inputs"].values()
    assert set(made_of(out)["inputs"].items()) < set(made_of(log)["inputs"].items())
    moved = np.ptp(goal.y, axis=0) > 0.01
    assert {name for name, one in zip(joints.names, moved, strict=True) if one} == {"left_elbow", "head_yaw"}
    # A count of the encoder, and what the goal changes within the jitter of a cycle.
    assert np.abs(goal.y - planned.at(goal.t)).max() < 0.01


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--parameters", "sensor.gyro_delay"), "the trunk is held still"),
        (("--parameters", "colour"), "unknown parameter 'colour'"),
        (("--joints", "left_wing"), "left_wing"),
        (("--seconds", "1"), "expected 20 to 120"),
        (("--holds", "upright,upside-down"), "expected some of upright,face-down"),
        (("--base", "floating", "--joints", "left_knee"), "need --base fixed"),
    ],
)
def test_refusals(path, tmp_path, capsys, words, reason):
    """What makes no sense is refused in one line."""
    assert command("excite", "--model", path, "--out", tmp_path / "e.mcap", *words) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
    assert not (tmp_path / "e.mcap").exists()


def test_an_excitation_of_another_robot_is_refused(path, joints, tmp_path, capsys):
    """Joints that the model has not are named."""
    excitation = standing(joints, 10.0)
    other = replace(excitation, joints=("wing", *joints.names[1:]))
    write_excitation(tmp_path / "e.mcap", other, "fixed")
    words = ("simulate", "--robot", "--model", path, "--excitation", tmp_path / "e.mcap", "--out", tmp_path / "r.mcap")
    assert command(*words) == 2
    assert "head_yaw, wing" in capsys.readouterr().err

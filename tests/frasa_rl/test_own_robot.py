"""`frasa-rl init` on humanoids that no code knows: what it finds, what it writes, and what it refuses."""

import json
import re
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.cli import main
from frasa_rl.config import Task
from frasa_rl.own_look import look
from frasa_rl.own_stance import find_stance
from frasa_rl.own_task import stem
from frasa_rl.standup_env import StandUp
from frasa_rl.task_file import load_task
from frasa_sysid.calibration import (
    ModelError,
    delayed_sensors,
    load_calibration,
    load_model,
    number,
    read,
    run_command,
    servo_classes,
)
from frasa_sysid.calibration.anatomy import hinges, legs, trunk_body
from frasa_sysid.cli import build_parser
from frasa_sysid.excitation_hung import design, first_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.excitation_trial import try_out
from frasa_sysid.holds import gain_of
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_truth import draw
from frasa_sysid.servo import read_servo
from frasa_sysid.simulate_robot import simulate_robot
from frasa_sysid.writer import write_mcap


@pytest.fixture(scope="session")
def heron(robot_model_dir):
    """A humanoid in two files whose every habit differs from the other robots'; see its first lines."""
    return robot_model_dir.parent / "tests" / "frasa_rl" / "heron" / "heron.xml"


SERVOS = ("--servo", "strong=*_leg_*", "--servo", "weak=*wing*,twist")


def init(model, out, *more):
    return main(["init", "--model", str(model), "--out", str(out), *more])


@pytest.fixture(scope="module")
def made(heron, tmp_path_factory):
    """The folder that `init` writes for it."""
    out = tmp_path_factory.mktemp("made") / "heron"
    assert init(heron, out, *SERVOS, "--supply-voltage", "14.8", "--firmware-gain", "20") == 0
    return out


def test_it_finds_pairs_and_legs_without_names(heron, robot_model_dir):
    """Mirrored joints, the sign of joints mounted the other way round, and legs; on three robots."""
    model = load_model(heron)
    found = {one.name: one for one in hinges(model, trunk_body(model))}
    assert found["l_leg_fold"].partner == "r_leg_fold"
    assert found["l_leg_fold"].mirror == -1  # the right one turns about -y
    assert found["l_leg_swing"].mirror == 1
    assert found["l_leg_edge"].mirror == -1  # roll joints about +x on both sides
    assert found["l_leg_edge"].turns == "roll"
    assert (found["twist"].side, found["twist"].turns, found["twist"].partner) == ("middle", "yaw", None)
    names = [(leg.side, leg.hip_pitch, leg.knee, leg.ankle_pitch) for leg in legs(model, trunk_body(model))]
    assert sorted(names) == [
        ("left", "l_leg_swing", "l_leg_fold", "l_leg_tip"),
        ("right", "r_leg_swing", "r_leg_fold", "r_leg_tip"),
    ]
    sigmaban = load_model(robot_model_dir / "nominal.xml")
    pairs = {one.name: one for one in hinges(sigmaban, trunk_body(sigmaban))}
    for name, one in pairs.items():
        if name.startswith("left_"):
            assert one.partner == name.replace("left", "right")
            assert one.mirror == (1 if re.search("pitch|knee|elbow", name) else -1)
    assert {leg.ankle_roll for leg in legs(sigmaban, trunk_body(sigmaban))} == {"left_ankle_roll", "right_ankle_roll"}


def test_the_copy_is_the_same_robot(heron, made):
    """Masses, joints, geoms and servos are the original's; classes, sensors and the pose are added."""
    before, after = load_model(heron), load_model(made / "nominal.xml")
    for name in (
        "body_mass",
        "body_inertia",
        "jnt_axis",
        "jnt_range",
        "geom_size",
        "actuator_gainprm",
        "actuator_biasprm",
    ):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-9, err_msg=name)
    assert set(servo_classes(after)) == {"strong", "weak"}
    assert (number(after, "servo_supply_voltage"), number(after, "servo_firmware_gain")) == (14.8, 20.0)
    assert read(after, "strong.kp") == 30.0
    assert read(after, "strong.damping") == 1.1
    assert read(after, "weak.forcerange") == 3.0
    assert before.dof_frictionloss[6] == 0.0
    assert read(after, "weak.frictionloss") == pytest.approx(0.039)  # a guess: fits start from a multiple of it
    for field in ("position_delay", "velocity_delay", "gyro_delay", "orientation_delay"):
        assert delayed_sensors(after, field).size
    assert after.actuator_history[0, 0] * after.opt.timestep >= 0.04


def test_it_stands_in_the_pose_it_writes(made):
    """From the keyframe, its commands held, it still stands after two seconds, upright and hardly lower."""
    model = load_model(made / "nominal.xml")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("neutral").id)
    height = data.qpos[2]
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(height, abs=0.03)
    assert 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2) > np.cos(np.radians(15))


def test_its_task_runs(made):
    """The task's joints are the pairs that turn about y, with their signs; the environment steps it."""
    task = load_task(made / "standup.yaml")
    assert {one.name: one.mirror for one in task.joints} == {
        "wing_lift": -1, "wing_bend": 1, "leg_swing": 1, "leg_fold": -1, "leg_tip": 1,
    }  # fmt: skip
    assert task.names.trunk == "base"
    assert task.control_period_s == pytest.approx(0.05)
    # Training's presets choose starts, ends and leading rewards for this robot as for any other.
    chosen = replace(Task(), falling_share=0.45, near_target_push=0.45, end_gyro=15.0)
    chosen = replace(chosen, reward=replace(chosen.reward, gathering=1.5, approach=4.5))
    trained = load_task(made / "standup.yaml", chosen)
    assert trained == replace(
        task, **{name: getattr(chosen, name) for name in ("falling_share", "near_target_push", "end_gyro", "reward")}
    )
    env = StandUp(made / "nominal.xml", task)
    first, _ = env.reset(seed=1)
    second, reward, *_ = env.step(np.full(env.action_space.shape, 0.3, np.float32))
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()
    assert reward > 0.0


def test_its_servos_are_tables_and_its_model_fits(made):
    """Each class has a table with the model's numbers; the fitter takes the model as a whole robot."""
    for name in ("strong", "weak"):
        servo, model = read_servo(made / "servos" / f"{name}.toml").servo, load_model(made / "nominal.xml")
        for field, value in (("kp", servo.kp()), ("forcerange", servo.force_limit()), ("damping", servo.damping())):
            assert value == pytest.approx(read(model, f"{name}.{field}"))
    joints = joints_of(made / "nominal.xml")
    assert joints.classes == ("strong", "weak")
    assert joints.firmware_gain == 20.0
    assert len(joints.legs) == 2


def test_what_it_says(heron, tmp_path, capsys):
    """What was found, what was added, and what only the user can know; the same in JSON."""
    assert init(heron, tmp_path / "a", "--json") == 0
    told = capsys.readouterr()
    found = json.loads(told.out)
    assert found["trunk"] == "base"
    assert set(found["servos"].values()) == {"servo_a", "servo_b"}
    assert any("--servo NAME=JOINTS" in one for one in found["questions"])
    assert any("12 V was taken" in one for one in found["questions"])
    assert "not known: " in told.err
    assert "moved by the policy, 5" in told.err
    head = (tmp_path / "a" / "standup.yaml").read_text().split("schema:")[0]
    assert all(line.startswith("#") for line in head.splitlines())
    assert init(heron, tmp_path / "a") == 2  # nothing is overwritten
    assert "is there already" in capsys.readouterr().err


def test_the_robots_of_this_repository(robot_model_dir, tmp_path):
    """The Sigmaban keeps its own classes and pose; the small humanoid its encoders, IMU and delays."""
    assert init(robot_model_dir / "nominal.xml", tmp_path / "sigmaban") == 0
    model = load_model(tmp_path / "sigmaban" / "nominal.xml")
    assert set(servo_classes(model)) == {"mx64", "mx106"}
    task = load_task(tmp_path / "sigmaban" / "standup.yaml")
    assert {one.name: one.target_deg for one in task.joints if "knee" in one.name} == {"knee": 79.0}
    assert task.target_pitch_deg == pytest.approx(8.5, abs=1.0)
    assert not (tmp_path / "sigmaban" / "servos").exists()

    small = robot_model_dir / "small_humanoid" / "small_humanoid.xml"
    assert init(small, tmp_path / "small", "--servo", "xm430=*") == 0
    model, task = load_model(tmp_path / "small" / "nominal.xml"), load_task(tmp_path / "small" / "standup.yaml")
    assert (task.names.position, task.names.orientation, task.names.gyro) == ("encoder_{}", "attitude", "rate")
    assert read(model, "xm430.delay") == 0.008
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_allclose(model.body_mass, load_model(small).body_mass)


def test_names_without_sides():
    """What is left of two names when their sides are taken away."""
    assert stem("l_knee_pitch", "r_knee_pitch") == "knee_pitch"
    assert stem("HipRollL", "HipRollR") == "HipRoll"
    assert stem("left_hip", "right_hip") == "hip"
    assert stem("LKnee", "RKnee") == "Knee"
    assert stem("a", "b") == "a"


REFUSED = [
    ('size="0 0 0.05" contype="1" conaffinity="1"', 'size="0 0 0.05"', "has no floor: add <geom"),
    ('<geom name="soil" type', "<geom type", "the floor has no name"),
    ("<freejoint/>", "", "expected one body with a free joint, the trunk; found none"),
    ('<position joint="l_leg_fold" kp="30" forcerange="-7 7"/>', '<motor joint="l_leg_fold"/>',
     "actuator number 8 of joint l_leg_fold is a torque motor without a position gain"),
    ('joint="l_leg_fold" kp="30"', 'joint="l_leg_fold" kp="30" gear="2"', "has gear 2: expected 1"),
    ('joint="l_leg_fold" kp="30" forcerange="-7 7"', 'joint="l_leg_fold" kp="30"', "has no torque limit"),
    ('joint="l_leg_fold" kp="30"', 'joint="l_leg_fold" timeconst="0.1" kp="30"', "has activation dynamics"),
    ('joint="l_leg_fold" kp="30"', 'joint="l_leg_tip" kp="30"', "joint l_leg_tip has more than one actuator"),
    ('<joint name="twist" axis="0 0 1" range="-40 40"/>', '<joint name="twist" axis="0 0 1"/>',
     "neither joint twist nor its actuator has a range"),
    ('<geom class="solid" name="ribs"', '<geom name="ribs"', None),  # its head still collides
    ('<geom class="solid" name="skull"', '<geom name="ribs2"', None),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), REFUSED)
def test_what_cannot_be_trained_is_one_line(heron, tmp_path, capsys, old, new, message):
    """What is wrong and what to do; exit status 3, and nothing is written."""
    shutil.copytree(heron.parent, tmp_path / "robot")
    path = tmp_path / "robot" / "heron.xml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    status = init(path, tmp_path / "out")
    told = capsys.readouterr().err
    if message is None:
        assert status == 0
        return
    assert status == 3
    assert message in told
    assert len(told.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_trunk_or_feet_that_fall_through_the_floor(heron, tmp_path):
    """A visual shell alone does not collide: said before anything is trained on it."""
    shutil.copytree(heron.parent, tmp_path / "robot")
    path, other = tmp_path / "robot" / "heron.xml", tmp_path / "robot" / "heron_legs.xml"
    text, feet = path.read_text(), other.read_text()
    path.write_text(re.sub(r'<geom class="solid" name="(ribs|skull)"', r'<geom name="\1"', text))
    with pytest.raises(ModelError, match="nothing of the trunk 'base' collides with the floor"):
        look(path, {})
    path.write_text(text)
    other.write_text(re.sub(r'<geom class="solid" (type="sphere")', r"<geom \1", feet))
    with pytest.raises(ModelError, match="m above the robot's lowest point: give its feet geoms that collide"):
        look(path, {})


def test_a_robot_that_stands_in_no_pose(heron, tmp_path):
    """Feet far behind the body: every pose that was tried is told, and that a keyframe would help."""
    shutil.copytree(heron.parent, tmp_path / "robot")
    path = tmp_path / "robot" / "heron.xml"
    path.write_text(path.read_text().replace('pos="0 0 0.09" mass="1.5"', 'pos="0.3 0 0.09" mass="5"'))
    with pytest.raises(
        ModelError, match=r"no pose was found that the robot stands in .* falls .*add a <keyframe> named"
    ):
        find_stance(look(path, {}))


def test_meshes_go_along(heron, tmp_path):
    """A model with a mesh is copied with it, so that the folder is whole."""
    folder = tmp_path / "robot"
    shutil.copytree(heron.parent, folder)
    (folder / "meshes").mkdir()
    (folder / "meshes" / "cube.obj").write_text(
        "\n".join(f"v {x} {y} {z}" for x in (0, 0.01) for y in (0, 0.01) for z in (0, 0.01))
        + "\nf 1 2 4\nf 1 4 3\nf 5 8 6\nf 5 7 8\nf 1 6 2\nf 1 5 6\n"
        + "f 3 4 8\nf 3 8 7\nf 1 3 7\nf 1 7 5\nf 2 6 8\nf 2 8 4\n"
    )
    path = folder / "heron.xml"
    text = path.read_text().replace('<compiler angle="degree"', '<compiler meshdir="meshes" angle="degree"')
    text = text.replace("<worldbody>", '<asset><mesh name="cube" file="cube.obj"/></asset>\n<worldbody>', 1)
    path.write_text(
        text.replace(
            '<geom class="solid" name="skull"', '<geom type="mesh" mesh="cube"/>\n<geom class="solid" name="skull"'
        )
    )
    assert init(path, tmp_path / "elsewhere" / "deep") == 0
    shutil.rmtree(folder)
    assert load_model(tmp_path / "elsewhere" / "deep" / "nominal.xml").nmesh == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--servo", "mx64"), "expected NAME=JOINTS"),
        (("--servo", "mx64=*elbow*"), "no joint is called '*elbow*'; there are r_wing_lift"),
        (("--servo", "MX-64=*"), "expected a name of lower-case letters"),
        (("--supply-voltage", "0"), "--supply-voltage 0: expected a number above 0"),
    ],
)
def test_words_that_make_no_sense(heron, tmp_path, capsys, words, message):
    """Usage, in one line."""
    assert init(heron, tmp_path / "out", *words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_servos_of_one_name_must_be_alike(heron, tmp_path, capsys):
    """Legs and wings have different numbers: they cannot be one class."""
    assert init(heron, tmp_path / "out", "--servo", "all=*") == 3
    assert "are both servo 'all' and differ in kp, 15 and 30 N m/rad" in capsys.readouterr().err


def test_a_virtual_robot_of_it(made, tmp_path):
    """Its own battery, gain and servos; legs that move alike whichever way their joints are mounted."""
    path = made / "nominal.xml"
    joints = joints_of(path)
    truth = draw("floating", 3, joints.classes, joints.names, joints.types, joints.supply_voltage, joints.firmware_gain)
    assert 14.8 < truth.open_voltage < 16.4  # of a battery whose nominal voltage is 14.8
    assert truth.firmware_gain == 20.0
    assert gain_of(None, joints.firmware_gain) == pytest.approx(20.0 / 3.0)
    goals = dict(zip(joints.names, standing(joints, 10.0).goals.T, strict=True))
    np.testing.assert_allclose(goals["l_leg_fold"], -goals["r_leg_fold"], atol=1e-12)
    np.testing.assert_allclose(goals["l_leg_swing"], goals["r_leg_swing"], atol=1e-12)
    assert np.ptp(goals["l_wing_lift"]) > 0.5
    assert np.ptp(goals["twist"]) == 0.0  # it carries the legs

    tables = {name: one.kp() for name, one in joints.types.items()}
    shutil.copy(path, tmp_path / "nominal.xml")  # without the tables beside it
    for name, one in joints_of(tmp_path / "nominal.xml").types.items():
        assert one.kp() == pytest.approx(tables[name])
        assert "numbers of nominal.xml" in one.source


def test_goals_are_held_before_a_delayed_command_acts(made, tmp_path):
    """A model whose commands are delayed is not told to go to zero first, which would ask for all of its torque."""
    text = (made / "nominal.xml").read_text()
    path = tmp_path / "nominal.xml"
    path.write_text(text.replace('delay="0.0"', 'delay="0.02"'))
    joints = joints_of(path)
    assert read(load_model(path), "strong.delay") == 0.02
    sizes = first_sizes(joints)
    still = replace(sizes, swing=0 * sizes.swing, quick=0 * sizes.quick, step=0 * sizes.step)
    asked = try_out(path, joints, design(joints, still, 10.0)).torque.max()
    assert asked < 0.5


def test_a_whole_robot_fit_of_it(made, tmp_path, capsys):
    """A log of a virtual one held by the trunk, a fit of delays and gain, published into its own calibrated model."""
    shutil.copytree(made, tmp_path / "heron")
    model, log = tmp_path / "heron" / "nominal.xml", tmp_path / "held.mcap"
    joints = joints_of(model)
    truth = replace(draw("fixed", 3, joints.classes, joints.names, joints.types, 14.8, 20.0), zeros=None)
    sizes = first_sizes(joints)
    small = replace(sizes, quick=sizes.quick / 3, swing=sizes.swing / 3, step=sizes.step / 3)
    write_mcap(log, [simulate_robot(model, joints, truth, design(joints, small, 10.0), 3.0, log.name, timestep=0.0005)])
    words = [
        "fit",
        log,
        "--model",
        model,
        "--free",
        "delays,gain",
        "--publish",
        "--no-report",
        "--json",
        "--threads",
        1,
    ]
    assert run_command(build_parser(), [str(word) for word in words]) == 0
    found = json.loads(capsys.readouterr().out)
    errors = found["misfit"]
    assert errors["fitted"]["mae_rad"] < 0.5 * errors["nominal"]["mae_rad"]
    calibrated = tmp_path / "heron" / "calibrated.xml"
    assert read(load_model(calibrated), "strong.delay") == pytest.approx(truth.command_delay, abs=0.01)
    ranges = load_calibration(calibrated).ranges
    assert {"strong.kp", "weak.kp", "strong.delay", "sensor.velocity_delay"} <= ranges.keys()
    StandUp(calibrated, load_task(tmp_path / "heron" / "standup.yaml")).reset(seed=0)

"""A second humanoid, described by its model and a task file alone, goes all the way; no code knows its names."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from frasa_rl import supply
from frasa_rl.config import Assumed, Task
from frasa_rl.keyframe_file import load_keyframes, save_keyframes
from frasa_rl.randomize import Randomizer
from frasa_rl.robot import find_robot
from frasa_rl.routine import Detector, Key, Keyframes, Routine, Standing
from frasa_rl.settings import PRESETS
from frasa_rl.standup_env import StandUp
from frasa_rl.task_file import load_task
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import load_model, servo_classes


@pytest.fixture(scope="module")
def folder(robot_model_dir) -> Path:
    return robot_model_dir / "small_humanoid"


@pytest.fixture(scope="module")
def model_path(folder):
    return folder / "small_humanoid.xml"


@pytest.fixture(scope="module")
def task(folder):
    return load_task(folder / "standup.yaml")


def test_it_is_another_robot(model_path, task, robot_model_dir):
    """Other names, another number of joints, another order, no servo classes, no custom numbers."""
    model, other = load_model(model_path), load_model(robot_model_dir / "nominal.xml")
    joints = [{one.joint(i).name for i in range(one.njnt)} for one in (model, other)]
    assert not joints[0] & joints[1]
    assert len(task.joints) != len(Task().joints)
    assert servo_classes(model) == ()
    assert model.nnumeric == 0
    assert model.actuator(0).name not in joints[0]


def test_no_code_names_it(model_path):
    """None of the names in its files stands in the packages."""
    model = load_model(model_path)
    kinds = (
        (model.joint, model.njnt),
        (model.body, model.nbody),
        (model.actuator, model.nu),
        (model.sensor, model.nsensor),
    )
    names = {kind(i).name for kind, count in kinds for i in range(count)} - {
        "world",
        "floating",
        "Chest",
        "rate",
        "attitude",
    }
    root = model_path.parent.parent.parent
    code = "\n".join(path.read_text() for name in ("frasa_rl", "frasa_sysid") for path in (root / name).rglob("*.py"))
    assert [name for name in names if name and name in code] == []
    assert "small_humanoid" not in code


def test_it_is_physically_plausible(model_path):
    """Mirrored sides, sound inertias, servos that can carry it and are no stronger than small servos are."""
    model = load_model(model_path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert 2.0 < model.body_mass.sum() < 4.0
    for side, other in (("L", "R"),):
        for name in ("Hip", "Knee", "Ankle", "Elbow", "Shoulder", "HipRoll"):
            left, right = data.joint(name + side).xanchor, data.joint(name + other).xanchor
            np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-12)
        assert model.body("Thigh" + side).mass == model.body("Thigh" + other).mass
    for low, middle, high in np.sort(model.body_inertia[1:], axis=1):
        assert 0.0 < high <= low + middle + 1e-12
    weight = model.body_mass.sum() * 9.81
    assert weight * 0.05 < model.actuator_forcerange[0, 1] <= 4.1  # one bent leg, 5 cm off its knee


def test_it_stands_in_its_target_pose(model_path, task):
    """Released there, drawn anew each time, it holds the pose with still commands: success, and no self-contact."""
    env = StandUp(model_path, replace(task, near_target_spread=0.0))
    for seed in range(8):
        env.reset(seed=seed, options={"start": "target"})
        for _ in range(50):
            _, _, terminated, _, info = env.step(np.zeros(len(task.joints)))
        assert not terminated
        assert info["is_success"]
        assert env.core.batch.now.contact == 0.0


def test_it_lies_when_asked_to(model_path, task):
    """Prone and supine starts are on the front and the back; mirrored joints are commanded mirrored."""
    env = StandUp(model_path, task)
    robot = env.robot
    for kind, sign in (("prone", 1.0), ("supine", -1.0)):
        env.reset(seed=1, options={"start": kind})
        assert sign * env.core.batch.now.pitch[0] > np.radians(45)
        shoulder = env.core.batch.sim.ctrl[0, robot.actuators[4]]
        assert shoulder[0] == -shoulder[1] != 0.0
        assert robot.actuators[0, 0] == robot.actuators[0, 1]  # the waist is on the midline


def test_it_passes_the_checkers(model_path, task):
    """Those of gymnasium and of stable-baselines3."""
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    env = StandUp(model_path, task)
    assert env.metadata["render_fps"] == 25
    assert env.observation_space.shape == (26,)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*render modes.*")
        check_env(env)
        sb3.check_env(StandUp(model_path, task))


def test_many_at_once(model_path, task):
    """The vectorised environment runs it, finite and without divergence."""
    pytest.importorskip("stable_baselines3")
    from frasa_rl.vec_env import StandUpVecEnv

    envs = StandUpVecEnv(model_path, task, 4, pool=8, keep=False, threads=1)
    rng = np.random.default_rng(0)
    envs.reset()
    for _ in range(30):
        seen, earned, _, _ = envs.step(rng.uniform(-1, 1, (4, 6)))
        assert np.isfinite(seen).all()
        assert np.isfinite(earned).all()
    assert envs.divergences == 0
    envs.close()


def test_every_robot_is_another(model_path, task):
    """Its assumed ranges reach the model, without servo classes: ratios by joint, delays, supply, centre of mass."""
    model, original = build_model(model_path, task), build_model(model_path, task)
    randomizer = Randomizer(model, find_robot(model, task), task, None)
    trunk, rng, moved = model.body("Pelvis").id, np.random.default_rng(0), []
    data, still = mujoco.MjData(model), mujoco.MjData(original)
    mujoco.mj_kinematics(original, still)
    for _ in range(100):
        drawn = randomizer.draw(rng)
        np.testing.assert_allclose(
            model.actuator_forcerange, drawn["supply_ratio"] * original.actuator_forcerange, rtol=1e-12
        )
        assert model.sensor("rate").id >= 0
        assert model.sensor_delay[model.sensor("rate").id] == drawn["gyro_delay"]
        assert set(model.actuator_delay) == {drawn["command_delay"]}
        dof = model.joint("KneeL").dofadr[0]
        wanted = drawn["frictionloss"] * drawn["joint_frictionloss.KneeL"] * original.dof_frictionloss[dof]
        assert model.dof_frictionloss[dof] == pytest.approx(wanted)
        mujoco.mj_resetData(model, data)
        mujoco.mj_kinematics(model, data)
        moved.append(data.xipos[trunk] - still.xipos[trunk])
    # Its centre of mass is compiled at the frame's origin, where MuJoCo keeps it until mj_setConst has looked again.
    assert np.abs(moved).max() > 0.0029
    assert np.abs(moved).max() <= 0.003 + 1e-12


def test_volts_need_to_know_of_which(model_path, task, capsys):
    """A range in volts is used where the nominal supply is given, and else not drawn, which is said once."""
    volts = replace(task.assumed, supply_voltage=Assumed(11.0, 12.6, "V", "a test"))
    told = replace(task, assumed=volts, nominal_voltage=12.0)
    model = build_model(model_path, told)
    robot = find_robot(model, told)
    drawn = Randomizer(model, robot, told, None).draw(np.random.default_rng(0))
    assert 11.0 <= drawn["supply_voltage"] <= 12.6
    assert model.actuator_forcerange[0, 1] == pytest.approx(4.1 * drawn["supply_voltage"] / 12.0)
    untold = replace(told, nominal_voltage=None)
    supply._say_once.cache_clear()
    for _ in range(3):
        model = build_model(model_path, untold)
        drawn = Randomizer(model, robot, untold, None).draw(np.random.default_rng(0))
        assert not {"supply_voltage", "supply_ratio"} & set(drawn)
        assert model.actuator_forcerange[0, 1] == 4.1
    assert capsys.readouterr().err.count("nominal_voltage") == 1


@pytest.fixture
def few_starts(monkeypatch, tmp_path):
    """A small pool: 512 settled starts take longer than all the rest."""
    monkeypatch.setenv("FRASA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["quick"], pool=16))


def test_the_readmes_commands_run(robot_model_dir, tmp_path, monkeypatch, capsys, few_starts):
    """Those of its section on other robots, with less time and fewer trials."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.cli import main

    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot_model").symlink_to(robot_model_dir)
    readme = (robot_model_dir.parent / "README.md").read_text()
    section = readme.partition("`robot_model/small_humanoid/` also has a task")[2].partition("\n## ")[0]
    commands = [line.strip() for line in section.splitlines() if line.startswith("    frasa-rl ")]
    assert len(commands) == 4
    for command in commands:
        words = command.partition("#")[0].replace("--minutes 8 ", "--steps 600 ")
        words = words.replace("--trials 20", "--trials 1").replace("--protocol push", "--protocol push --push-trials 1")
        assert "--minutes" not in words, "the README's minutes are not the ones replaced here"
        code = main(words.split()[1:])
        if code == 1 and "cannot draw without a window" in capsys.readouterr().err:
            pytest.skip("this machine cannot draw")
        assert code == 0, command


def test_the_task_is_given_once(model_path, folder, tmp_path, capsys, few_starts, page_text):
    """To train: resuming and evaluating have it from the run; held commands need it."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.cli import main
    from frasa_rl.policy import Policy

    own = tmp_path / "own.yaml"
    own.write_text((folder / "standup.yaml").read_text() + "end_gyro: 8.0\n")
    words = ["--model", str(model_path), "--task", str(own)]
    run = str(tmp_path / "run")
    assert main(["train", *words, "--steps", "600", "--out", run, "--json"]) == 0
    shown = capsys.readouterr()
    said = json.loads(shown.out)
    assert "goes before the preset: end_gyro 8 (preset: 15)" in shown.err
    assert said["steps"] >= 600
    assert said["outputs"]["report"] is None or f"{said['steps']:,} steps" in page_text(Path(said["outputs"]["report"]))
    policy = Policy.load(run)
    assert (policy.layers[0][0].shape[1], policy.layers[-1][0].shape[0]) == (26, 6)
    assert main(["train", "--resume", run, "--steps", "640", "--no-report"]) == 0
    assert main(["evaluate", run, "--trials", "1", "--json", "--no-report"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == str(model_path)
    assert main(["evaluate", "nothing", *words, "--trials", "1", "--no-report"]) == 0
    assert main(["train", "--resume", run, "--task", str(folder / "standup.yaml")]) == 2
    assert "--task from the run itself" in capsys.readouterr().err


def test_the_protocol_runs_on_it(model_path, folder, task, capsys):
    """Its task's pendulum hits it where it stands, whoever it is; a rate that does not suit it is one line."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.cli import main

    words = ["evaluate", "nothing", "--no-report", "--model", str(model_path), "--task", str(folder / "standup.yaml")]
    some = ["--trials", "1", "--push-trials", "1"]
    for more in ([], ["--randomize", "--rate", "50"]):
        assert main([*words, *some, *more, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert set(result["standup"]) == {"prone", "supine"}
        pushes = result["push"]
        assert [one["energy_j"] for one in pushes] == [*task.rig.energies_j] * 2
        assert not any(one["missed"] for one in pushes)
        if "--randomize" not in more:  # held commands keep the robot that they were found for
            assert [one["not_standing"] for one in pushes] == [0] * 6
            assert pushes[0]["success_rate"] == pushes[3]["success_rate"] == 1.0
    assert main([*words, *some, "--rate", "20"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].endswith("expected one of 25, 50, 125, 250")


def test_a_pendulum_that_passes_it_by_is_named(model_path, folder, tmp_path, capsys):
    """One line that says how high the bob hangs and what to change."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.cli import main

    path = tmp_path / "standup.yaml"
    path.write_text((folder / "standup.yaml").read_text().replace("height: 1.02", "height: 1.4"))
    words = ["evaluate", "nothing", "--no-report", "--model", str(model_path), "--task", str(path)]
    assert main([*words, "--protocol", "push", "--push-trials", "1"]) == 3
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "bob hangs 0.70 m above the floor, passes the robot without touching it: give the task file's rig" in said[0]


def test_keyframes_are_tuned_for_it(model_path, folder, task, tmp_path, capsys):
    """Another number of joints, one on the midline, one mirrored: the tuner runs and its file is one for this robot."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.cli import main

    start, best = tmp_path / "start.yaml", tmp_path / "best.yaml"
    standing = tuple(one.target_deg for one in task.joints)
    routine = Routine((Key(0.4, (0.0, -60.0, 90.0, -40.0, 0.0, -20.0)),), 0.5)
    names = tuple(one.name for one in task.joints)
    save_keyframes(Keyframes(names, routine, routine, Standing(standing, 0.5, 10.0), Detector()), start)
    words = ["keyframe", "--no-report", "--model", str(model_path), "--task", str(folder / "standup.yaml")]
    tuning = ["--tune", "--minutes", "0.02", "--best", str(best), "--json"]
    assert main([*words, "--keyframes", str(start), *tuning]) == 0
    said = capsys.readouterr()
    assert list(json.loads(said.out)["sides"]) == ["prone", "supine"]  # however little time
    assert f"--task {folder / 'standup.yaml'}" in said.err
    assert load_keyframes(best).joints == names
    assert main([*words, "--keyframes", str(best), "--protocol", "standup", "--trials", "1"]) == 0
    robots = StandUp(model_path, task, randomize=False)
    robots.reset(seed=0, options={"start": "target"})
    for _ in range(3):  # what a key says of the left is mirrored on the right
        robots.step(np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]))
    left, right = robots.core.batch.sim.ctrl[0, robots.robot.actuators[4]]
    assert left == -right > 0.0


def test_a_run_keeps_its_task(model_path, task, tmp_path):
    """run.yaml brings the task back, and training with it learns: updates are made."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.physics import with_physics
    from frasa_rl.plan import Plan, plan_of
    from frasa_rl.settings import Settings
    from frasa_rl.train import train

    settings = Settings(envs=4, rollout_steps=16, pool=8, learning_starts=100, threads=1, evaluate_falls=1)
    plan = Plan(model_path, tmp_path / "run", settings, steps=160, device="cpu", task=task)
    assert train(plan)["updates"] > 0
    again = plan_of(tmp_path / "run")
    assert again == plan
    own = {
        name: getattr(settings, name) for name in ("near_target_share", "near_target_push", "falling_share", "end_gyro")
    }
    reward = settings.reward(task.reward)
    assert again.task == with_physics(replace(task, reward=reward, **own), settings.physics)

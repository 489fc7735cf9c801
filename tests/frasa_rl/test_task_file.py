"""A task as a file: every field can be set, nothing is executed, and every mistake is one clear line."""

import argparse
from dataclasses import fields, replace

import pytest
import yaml

from frasa_rl.cli import main
from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Assumed, Joint, ServoSpread, Task, TaskError
from frasa_rl.settings import PRESETS
from frasa_rl.task_file import load_task, task_from
from frasa_rl.task_text import documented_default, dump_task, task_data

OTHER = replace(
    Task(),
    joints=(Joint("Knee", 60.0), Joint("Waist", 5.0, 1, "Waist", "Waist"), Joint("Arm", 3.0, -1)),
    held_deg=(("roll", 1.5),),
    nominal_voltage=12.0,
    assumed=replace(
        Task().assumed,
        trunk_mass=None,
        damping=ServoSpread(0.5, 1.5, "ratio", "a test: with a colon, and 'quotes'", "joint"),
        gyro_delay=Assumed(0.001, 0.002, "s", "a test"),
    ),
    names=replace(Task().names, trunk="Körper", velocity=None, left="{}.L"),
    physics=replace(
        Task().physics, timestep=0.005, tolerance=1e-8, self_collision=False, friction_law="coulomb_viscous"
    ),
)


@pytest.fixture
def write(tmp_path):
    """Write a task file and return its path."""

    def make(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return make


def test_the_documented_file_is_the_default(robot_model_dir):
    """robot_model/standup.yaml names every field of the default task, with its description, and holds its values."""
    path = robot_model_dir / "standup.yaml"
    assert load_task(path) == Task()
    assert path.read_text(encoding="utf-8") == documented_default()
    lines = documented_default().splitlines()
    for one in (Task(), Task().names, Task().physics, Task().reward, Task().assumed):
        for field in fields(one):
            named = (f"{field.name}:", f"# {field.name}:")
            above = [lines[i - 1].strip() for i, line in enumerate(lines) if line.strip().startswith(named)]
            assert above, field.name
            assert any(line.startswith("# ") for line in above), field.name


def test_a_file_of_all_fields_leaves_presets_theirs(write):
    """What training presets choose is theirs also where a file names everything, unless it was changed."""
    path = write(dump_task(replace(Task(), falling_share=0.3)))
    chosen = replace(Task(), near_target_share=0.2, end_gyro=15.0, reward=replace(Task().reward, gathering=1.5))
    assert load_task(path, chosen) == replace(chosen, falling_share=0.3)


@pytest.mark.parametrize("task", [OTHER, compat_task(Task())])
def test_a_task_comes_back_from_its_text(write, task):
    """From a file as from the plain data of a run.yaml."""
    assert load_task(write(dump_task(task))) == task
    assert task_from(yaml.safe_load(yaml.safe_dump(task_data(task))), "run.yaml") == task


def test_a_file_names_only_what_differs(write):
    """What is not named is the default's, also inside of a part; joints and assumed ranges are given whole."""
    task = load_task(write("reward: {posture: 2}\nassumed: {trunk_com: null}\njoints: [{name: knee, target_deg: 70}]"))
    assert task.reward == replace(Task().reward, posture=2.0)
    assert task.assumed == replace(Task().assumed, trunk_com=None)
    assert task.joints == (Joint("knee", 70.0),)
    assert task.names == Task().names
    base = replace(Task(), near_target_share=0.5)
    assert load_task(write("episode_s: 4"), base) == replace(base, episode_s=4.0)


RANGE = "low: 0.9, high: 1.1, unit: ratio, source: me"
MISTAKES = [
    ("episode: 5", "unknown field 'episode'; did you mean 'episode_s'?"),
    ("reward: {postur: 1}", "reward: unknown field 'postur'; did you mean 'posture'?"),
    ("zzz: 1", "unknown field 'zzz'; there are compat, joints"),
    ("episode_s: 5\nepisode_s: 6", "key 'episode_s' stands twice"),
    ("episode_s: long", "episode_s: found the text 'long', expected a number"),
    ("episode_s: true", "episode_s: found the flag 'True', expected a number"),
    ("physics: {tolerance: 1e-8}", "physics.tolerance: found the text '1e-8', expected a number: write 1.0e-08"),
    ("physics: {iterations: 2.5}", "physics.iterations: found 2.5, expected a whole number"),
    ("physics: {self_collision: 1}", "physics.self_collision: found 1, expected true or false"),
    ("physics: {integrator: heun}", "physics.integrator: found the text 'heun', expected 'euler' or 'implicit'"),
    ("physics: {timestep: 0}", "physics: timestep is 0: expected 1e-05 .. 1 s"),
    ("names: {trunk: 3}", "names.trunk: found 3, expected text"),
    ("names: {left: left}", "names: left is 'left': expected a name with {} once"),
    ('names: {left: "{0.__class__}"}', "expected a name with {} once"),
    ("joints: []", "joints is empty"),
    ("joints: {name: knee}", "joints: found a mapping, expected a list"),
    ("joints: [{name: knee}]", "joints[0]: target_deg missing"),
    ("joints: [{name: knee, target_deg: 5, mirror: 2}]", "joints[0]: mirror of knee is 2: expected 1 or -1"),
    ("joints: [{name: knee, target_deg: 5}, {name: knee, target_deg: 6}]", "joints has left_knee, right_knee twice"),
    ("joints: [{name: w, target_deg: 5, mirror: -1, left: w, right: w}]", "w on both sides with mirror -1"),
    ("held_deg: [1]", "held_deg: found a list, expected actuators with their angles"),
    ("held_deg: {neck: up}", "held_deg.neck: found the text 'up', expected a number"),
    ("near_target_share: 1.2", "near_target_share is 1.2: expected 0 .. 1"),
    ("near_target_share: 0.6\nfalling_share: 0.6", "near_target_share and falling_share are 1.2 together"),
    ("end_gyro: .nan", "end_gyro is nan: expected 0 .. 1000 rad/s"),
    ("end_gyro: .inf", "end_gyro is inf: expected 0 .. 1000 rad/s"),
    ("control_period_s: -0.05", "control_period_s is -0.05: expected more than 0"),
    ("episode_s: 0.01", "control_period_s is 0.05 and episode_s is 0.01"),
    ("still_s: 3", "still_s is 3 and settle_max_s is 2"),
    ("target_pitch_deg: 30\nend_pitch_deg: 20", "expected a standing pose that does not end the episode"),
    ("reward: {posture: 0}", "posture is 0: expected a weight above zero"),
    ("assumed: {trunk_mass: {low: 0.9}}", "assumed.trunk_mass: high, unit, source missing"),
    ("assumed: {trunk_mass: {low: 2, high: 1, unit: ratio, source: me}}", "low is 2 and high is 1"),
    (f"assumed: {{trunk_com: {{{RANGE}}}}}", "trunk_com.unit is 'ratio': expected 'm'"),
    (f"assumed: {{trunk_mass: {{{RANGE}, per: joint}}}}", "assumed.trunk_mass: unknown field 'per'"),
    (f"assumed: {{damping: {{{RANGE}, per: leg}}}}", "damping.per: found the text 'leg', expected 'robot' or 'class'"),
    ("assumed: {gyro_delay: {low: -0.1, high: 1, unit: s, source: me}}", "gyro_delay.low is -0.1: expected 0 .. 1 s"),
    ("rig: {heigth: 1}", "rig: unknown field 'heigth'; did you mean 'height'?"),
    ("rig: {mass: 0}", "rig: mass is 0: expected more than 0 and at most 1000 kg"),
    (
        "rig: {height: 1.2}",
        "rig: height is 1.2 and length 1.28, radius 0.05: expected a bob that hangs above the floor",
    ),
    ("rig: {friction: -1}", "rig: friction is -1: expected 0 .. 10"),
    ("rig: {energies_j: 4}", "rig.energies_j: found 4, expected a list"),
    ("rig: {energies_j: [4, strong]}", "rig.energies_j[1]: found the text 'strong', expected a number"),
    ("rig: {energies_j: []}", "energies_j: expected at least one number, each larger than the one before"),
    ("rig: {energies_j: [5, 4]}", "energies_j: expected at least one number, each larger than the one before"),
    ("rig: {energies_j: [5, .inf]}", "energies_j is inf: expected more than 0 and at most 11.3"),
    ("rig: {energies_j: [12]}", "energies_j is 12: expected more than 0 and at most 11.3"),
    ("schema: frasa.task/9", "schema is 'frasa.task/9': expected 'frasa.task/1'"),
    ("- 1", "found a list, expected fields of a task"),
    ("", "found nothing (null), expected fields of a task"),
    ("a: [", "is not YAML"),
    ("!!python/object/apply:os.getcwd []", "is not YAML"),
    ("joints: &a [*a]", "it holds an alias (*a): write the value out"),
    ("episode_s: 1" + "0" * 400, "episode_s: a number of 401 digits"),
]


@pytest.mark.parametrize(("text", "message"), MISTAKES)
def test_every_mistake_is_one_clear_line(write, text, message):
    """What was found and what was expected, and in which file."""
    path = write(text)
    with pytest.raises(TaskError) as caught:
        load_task(path)
    said = str(caught.value)
    assert message in said
    assert said.startswith(str(path))
    assert "\n" not in said


def test_numbers_are_checked_where_a_task_is_made():
    """Not only in files: Python gets the same refusals."""
    with pytest.raises(TaskError, match="rate_limit is nan"):
        replace(Task(), rate_limit=float("nan"))
    with pytest.raises(TaskError, match="low is nan"):
        Assumed(float("nan"), 1.0, "ratio", "a test")
    with pytest.raises(TaskError, match="source is empty"):
        Assumed(0.0, 1.0, "ratio", " ")


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("joints: [{name: knee, target_deg: 150}]", 3, "target_deg of knee is 150: the ctrlrange of left_knee"),
        ("joints: [{name: knee, target_deg: 5, mirror: -1}]", 3, "is the mirror right"),
        ("joints: [{name: tail, target_deg: 5}]", 3, "the model lacks joint left_tail, right_tail; it has"),
        ("held_deg: {left_knee: 1}", 3, "left_knee is in held_deg, and is one that the policy moves"),
        ("held_deg: {head_yaw: 175}", 3, "held_deg of head_yaw is 175: its ctrlrange allows"),
        ("control_period_s: 0.0333\nphysics: {timestep: 0.002}", 3, "does not divide the control period"),
        ("rate_limit: 0", 3, "rate_limit is 0"),
    ],
)
def test_the_commands_end_with_a_line_and_a_status(write, nominal, capsys, tmp_path, text, code, message):
    """Also where only the model shows that a task cannot be."""
    pytest.importorskip("sb3_contrib")
    words = ["train", "--model", str(nominal), "--steps", "10", "--out", str(tmp_path / "run"), "--no-report"]
    assert main([*words, "--task", str(write(text))]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]


def test_a_missing_file_says_where_to_look(tmp_path):
    """And a folder is no file."""
    with pytest.raises(TaskError, match=r"no task file at .*robot_model/standup\.yaml shows every field"):
        load_task(tmp_path / "none.yaml")
    with pytest.raises(TaskError, match="is a folder, expected a file"):
        load_task(tmp_path)


def test_shares_of_starts_are_the_presets_unless_the_file_says_so(write):
    """And frasa2024 has none that fall, nor rewards that lead; the settings a run keeps say the same as its task."""
    from frasa_rl.commands.training import _SETTINGS, _task_and_settings

    def chosen(text, compat=None):
        args = argparse.Namespace(task=write(text) if text else None, compat=compat, preset="quick")
        task, settings = _task_and_settings(argparse.Namespace(**vars(args), **dict.fromkeys(_SETTINGS), set=None))
        assert (task.near_target_share, task.falling_share) == (settings.near_target_share, settings.falling_share)
        assert task.near_target_push == settings.near_target_push
        assert (task.end_gyro, task.reward.gathering) == (settings.end_gyro, settings.gathering)
        return task

    quick = PRESETS["quick"]
    assert chosen("").falling_share == quick.falling_share
    assert chosen("episode_s: 4").near_target_share == quick.near_target_share
    assert chosen("near_target_share: 0.05").near_target_share == 0.05
    assert chosen("end_gyro: 7").end_gyro == 7.0
    assert chosen("reward: {approach: 0.5}").reward.approach == 0.5
    published = chosen("", "frasa2024")
    assert (published.falling_share, published.end_gyro, published.reward.approach) == (0.0, 5.0, 0.0)
    assert published.near_target_push == 0.0


def test_training_as_the_published_environment_does(nominal, tmp_path, monkeypatch):
    """--compat frasa2024 runs, and run.yaml says what it is."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.plan import plan_of

    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["quick"], pool=2, envs=2, rollout_steps=8, evaluate_falls=1))
    words = ["train", "--model", str(nominal), "--steps", "16", "--out", str(tmp_path / "run"), "--no-report"]
    assert main([*words, "--compat", "frasa2024"]) == 0
    task = plan_of(tmp_path / "run").task
    assert task == compat_task(Task())

"""A file of keyframes is read strictly: whatever is wrong is said in one line."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from frasa_rl.config import Task
from frasa_rl.keyframe_file import load_keyframes, save_keyframes
from frasa_rl.robot import find_robot
from frasa_rl.routine import Detector, Key, KeyframeError, Routine, check_limits
from frasa_sysid.calibration import load_model


@pytest.fixture
def shipped(robot_model_dir):
    return load_keyframes(robot_model_dir / "keyframes.yaml")


def test_the_shipped_file_fits_the_robot(shipped, nominal):
    """Its joints are the task's, and every angle can be commanded."""
    robot = find_robot(load_model(nominal), Task())
    assert shipped.joints == tuple(one.name for one in Task().joints)
    check_limits(shipped, np.degrees(robot.limits))


def test_a_file_comes_back_as_it_was(shipped, tmp_path):
    """Saving and loading changes nothing; the comment stands above."""
    path = tmp_path / "keyframes.yaml"
    save_keyframes(shipped, path, "found by hand\non a Sunday\n")
    assert load_keyframes(path) == shipped
    assert path.read_text().startswith("# found by hand\n# on a Sunday\nschema:")


def broken(change):
    """A named change to the content of a good file."""
    return pytest.param(change, id=change.__name__)


def unknown_field(data):
    data["prone"]["speed"] = 2


def missing_field(data):
    del data["standing"]["gain"]


def other_schema(data):
    data["schema"] = "frasa.keyframes/9"


def too_few_angles(data):
    data["supine"]["keys"][1]["angles_deg"].pop()


def not_a_number(data):
    data["prone"]["keys"][0]["angles_deg"][0] = float("nan")


def a_word(data):
    data["prone"]["keys"][0]["duration_s"] = "soon"


def a_truth(data):
    data["prone"]["rise_s"] = True


def absurd_angle(data):
    data["standing"]["command_deg"][0] = 4000.0


def negative_duration(data):
    data["supine"]["keys"][0]["duration_s"] = -0.1


def endless(data):
    data["supine"]["rise_s"] = float("inf")


def no_keys(data):
    data["prone"]["keys"] = []


def a_joint_twice(data):
    data["joints"][1] = data["joints"][0]


def no_hysteresis(data):
    data["detector"]["upright_deg"] = data["detector"]["fallen_deg"]


def a_list_of_routines(data):
    data["prone"] = [data["prone"]]


CHANGES = (
    unknown_field, missing_field, other_schema, too_few_angles, not_a_number, a_word, a_truth, absurd_angle,
    negative_duration, endless, no_keys, a_joint_twice, no_hysteresis, a_list_of_routines,
)  # fmt: skip


@pytest.mark.parametrize("change", [broken(one) for one in CHANGES])
def test_a_broken_file_is_one_line_of_error(change, robot_model_dir, tmp_path):
    """Unknown and missing fields, wrong counts, numbers that are none or absurd."""
    data = yaml.safe_load((robot_model_dir / "keyframes.yaml").read_text())
    change(data)
    path = tmp_path / "keyframes.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(KeyframeError) as caught:
        load_keyframes(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["", "[1, 2", "just words", "\udcff"])
def test_what_is_no_mapping_is_refused(text, tmp_path):
    """Empty, not YAML, not a mapping, not text."""
    path = tmp_path / "keyframes.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(KeyframeError, match=r"keyframes\.yaml"):
        load_keyframes(path)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(KeyframeError, match="no file of keyframes"):
        load_keyframes(tmp_path / "none.yaml")


def test_angles_beyond_the_limits_are_listed(shipped):
    """Each with its key, its joint and the limits."""
    n = len(shipped.joints)
    limits = np.tile([-170.0, 170.0], (n, 1))
    limits[-1] = (-10.0, 10.0)
    far = replace(shipped, prone=Routine((Key(0.1, (0.0,) * (n - 1) + (11.0,)),), 0.5), supine=shipped.prone)
    with pytest.raises(KeyframeError, match=r"prone key 1 ankle_pitch 11 \(limits -10 to 10\)"):
        check_limits(far, limits)


def test_thresholds_have_defaults_that_hold():
    """A detector made without numbers is a valid one."""
    assert Detector().upright_deg < Detector().fallen_deg

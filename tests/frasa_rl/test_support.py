"""Where the robot's mass is above its feet, found in the model without being told."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.batch import Batch
from frasa_rl.config import Task
from frasa_rl.config_parts import Reward
from frasa_rl.poses import place, standing
from frasa_rl.robot import find_robot
from frasa_rl.simulation import Start, state_of
from frasa_rl.support import Support, feet
from frasa_rl.task_file import load_task
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import hold_history

TASK = replace(Task(), reward=Reward(gathering=1.0))


@pytest.fixture(scope="module")
def model(robot_model_dir):
    return build_model(robot_model_dir / "nominal.xml", TASK)


def test_the_feet_are_what_it_stands_on(model):
    """All eight cleats, and nothing else."""
    names = [model.body(one).name for one in feet(model, find_robot(model, TASK), TASK)]
    assert len(names) == 8
    assert all("_cleat_" in name for name in names)


def test_the_feet_of_another_robot(robot_model_dir):
    """Of which nobody said what its feet are called."""
    folder = robot_model_dir / "small_humanoid"
    own = load_task(folder / "standup.yaml")
    task = replace(own, reward=replace(own.reward, gathering=1.0))
    other = build_model(folder / "small_humanoid.xml", task)
    assert {other.body(one).name for one in feet(other, find_robot(other, task), task)} == {"FootL", "FootR"}


def test_no_sensor_unless_the_task_asks(robot_model_dir):
    plain = build_model(robot_model_dir / "nominal.xml", Task())
    assert find_robot(plain, Task()).support is None


def test_the_truth_is_the_centre_of_mass_above_the_feet(model):
    """As MuJoCo has them, in the standing pose and bent; feet turn with the trunk where the joints stay."""
    robot, data = find_robot(model, TASK), mujoco.MjData(model)
    cleats = [i for i in range(model.nbody) if "_cleat_" in model.body(i).name]
    batch, support = Batch(model, TASK, 1, threads=1), Support(model, robot, TASK)
    joints, pitch = standing(TASK)
    for bent, turn in ((0.0, 0.0), (0.4, 0.0), (0.0, np.pi / 2), (0.0, np.pi)):
        place(model, data, robot, joints + bent, pitch + turn)
        mujoco.mj_forward(model, data)
        hold_history(model, data)
        state, no_delay = state_of(model, data), np.zeros(model.nsensor)
        batch.put(0, Start(model, state, data.ctrl.copy(), data.sensordata.copy(), no_delay, {}))
        truth = data.subtree_com[robot.trunk] - data.xpos[cleats].mean(axis=0)
        numbers = batch.now.support
        np.testing.assert_allclose(support.above(numbers)[0], truth, atol=1e-12)
        if not bent:
            assert support.flat(numbers)[0] == pytest.approx((1.0 + np.cos(turn)) / 2.0, abs=1e-9)
        if not bent and not turn:
            assert support.standing == pytest.approx(truth[2], abs=1e-12)
            assert 0.2 < truth[2] < 0.3
    batch.close()


def test_kneeling_is_no_standing(model):
    """On its shins, the trunk upright above its feet: they are anything but flat."""
    robot, data = find_robot(model, TASK), mujoco.MjData(model)
    angles = {"hip_pitch": -0.3, "knee": 2.0, "ankle_pitch": 0.3}
    joints = np.array([angles.get(one.name, 0.0) for one in TASK.joints])
    place(model, data, robot, joints, 0.0)
    mujoco.mj_forward(model, data)
    assert Support(model, robot, TASK).flat(data.sensordata[robot.support]) < 0.4

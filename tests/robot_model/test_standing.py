"""The neutral pose stands when it leans forward and falls when it leans back."""

import mujoco
import numpy as np
import pytest


def set_pitch(model, data, degrees):
    """The keyframe's joints, the trunk at a pitch, the lowest corner on the ground."""
    mujoco.mj_resetDataKeyframe(model, data, model.key("neutral").id)
    half = np.radians(degrees) / 2
    data.qpos[3:7] = [np.cos(half), 0, np.sin(half), 0]
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= min(lowest(model, data, i) for i in range(1, model.ngeom))


def lowest(model, data, i):
    up, size = np.abs(data.geom_xmat[i].reshape(3, 3)[2]), model.geom_size[i]
    if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX:
        return data.geom_xpos[i, 2] - up @ size
    return data.geom_xpos[i, 2] - np.hypot(up[0], up[1]) * size[0] - up[2] * size[1]


def pitch(data):
    rotation = data.body("trunk").xmat.reshape(3, 3)
    return np.degrees(np.arctan2(-rotation[2, 0], rotation[2, 2]))


def run(model, data, seconds=5.0):
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)


def test_keyframe_is_the_neutral_pose(nominal):
    """The keyframe leans forward by 8.5 deg, touches the ground, and commands its own joint angles."""
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, nominal.key("neutral").id)
    mujoco.mj_forward(nominal, data)
    assert pitch(data) == pytest.approx(8.5, abs=1e-5)
    assert min(lowest(nominal, data, i) for i in range(1, nominal.ngeom)) == pytest.approx(0, abs=1e-8)
    assert data.site("trunk").xpos[2] == pytest.approx(0.3324, abs=5e-5)
    degrees = {"elbow": -49.5, "shoulder_pitch": 19.5, "hip_pitch": -52, "knee": 79, "ankle_pitch": -36.5}
    for i in range(nominal.nu):
        name = nominal.actuator(i).name
        expected = degrees.get(name.split("_", 1)[1], 0)
        assert np.degrees(data.joint(name).qpos[0]) == pytest.approx(expected, abs=1e-6)
        assert data.ctrl[i] == data.joint(name).qpos[0]


def test_stands_leaning_forward(nominal):
    """From +8.5 deg it stands for 5 s and ends at the height, pitch and knee angle measured on the source."""
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, nominal.key("neutral").id)
    run(nominal, data)
    assert data.site("trunk").xpos[2] == pytest.approx(0.3253, abs=2e-4)
    assert pitch(data) == pytest.approx(-2.45, abs=0.1)
    assert np.degrees(data.joint("left_knee").qpos[0]) == pytest.approx(88.1, abs=0.1)
    assert not data.sensor("self_contact").data.any()


def test_feet_carry_the_weight(nominal):
    """Standing, the foot sensors read the weight, less the cleats' own, as forces downwards on the feet."""
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, nominal.key("neutral").id)
    run(nominal, data)
    names = [nominal.sensor(i).name for i in range(nominal.nsensor)]
    total = sum(data.sensor(name).data[2] for name in names if "cleat" in name)
    assert total == pytest.approx(-76.3, abs=0.3)


def test_falls_leaning_back(nominal):
    """From -8.5 deg it falls on its back."""
    data = mujoco.MjData(nominal)
    set_pitch(nominal, data, -8.5)
    run(nominal, data)
    assert data.site("trunk").xpos[2] == pytest.approx(0.1279, abs=5e-3)
    assert pitch(data) == pytest.approx(-92, abs=3)

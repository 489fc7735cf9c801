"""Key facts of the robot, kept here so that they are tested where the source's tables are not at hand."""

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration.apply import actuators_of, delayed_sensors, number, read, servo_classes


def test_totals(nominal):
    """Mass and counts are the source's: 7.80477 kg, 20 hinges, 51 boxes, 14 cylinders, 13 sites."""
    assert nominal.body_subtreemass[0] == pytest.approx(7.8047726360182, abs=1e-12)
    assert (nominal.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).sum() == 20
    assert (nominal.geom_type == mujoco.mjtGeom.mjGEOM_BOX).sum() == 51
    assert (nominal.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER).sum() == 14
    assert (nominal.nbody, nominal.ngeom, nominal.nsite, nominal.nu) == (39, 66, 13, 20)


def test_masses_of_the_limbs(nominal):
    """Arms weigh 0.575452 kg and legs 1.533482 kg, left and right."""
    for side in ("left", "right"):
        assert nominal.body(f"{side}_shoulder").subtreemass[0] == pytest.approx(0.575452, abs=1e-6)
        assert nominal.body(f"{side}_hip_yaw_link").subtreemass[0] == pytest.approx(1.533482, abs=1e-6)


def test_servo_classes(nominal):
    """Ten mx106 drive the legs but for hip yaw; ten mx64 the rest."""
    assert servo_classes(nominal) == ("mx64", "mx106")
    legs = {f"{side}_{joint}" for side in ("left", "right") for joint in ("hip_roll", "hip_pitch", "knee")}
    legs |= {f"{side}_ankle_{axis}" for side in ("left", "right") for axis in ("pitch", "roll")}
    assert {nominal.actuator(i).name for i in actuators_of(nominal, "mx106")} == legs
    assert actuators_of(nominal, "mx64").size == 10


def test_servo_numbers(nominal):
    """The nominal servos are the source's at firmware gain 12, at 15 V, without delay."""
    fields = ("kp", "forcerange", "damping", "frictionloss", "armature", "delay")
    assert [read(nominal, f"mx64.{field}") for field in fields] == [12.5, 5, 0.66, 0.09, 0.012, 0]
    assert [read(nominal, f"mx106.{field}") for field in fields] == [21, 8, 1.7, 0.10, 0.025, 0]
    assert number(nominal, "servo_supply_voltage") == 15
    assert number(nominal, "servo_firmware_gain") == 12


def test_measurements_and_their_delays(nominal):
    """All 20 joints, the gyro and the orientation are measured, with the nominal delays and room for 80 ms."""
    counts = {"position": 20, "velocity": 20, "gyro": 1, "orientation": 1}
    delays = {"position": 0, "velocity": 0.030, "gyro": 0.050, "orientation": 0.050}
    for name, count in counts.items():
        sensors = delayed_sensors(nominal, f"{name}_delay")
        assert sensors.size == count
        assert set(nominal.sensor_delay[sensors]) == {delays[name]}
        assert (nominal.sensor_history[sensors, 0] * nominal.opt.timestep).min() == pytest.approx(0.080)
    for i in range(1, nominal.njnt):
        joint = nominal.joint(i).name
        for quantity in ("position", "velocity"):
            assert nominal.sensor(f"{joint}.{quantity}").objid[0] == i
    for name in ("gyro", "orientation", "self_contact"):
        assert nominal.sensor_history[nominal.sensor(name).id, 0] == 0


def test_mirrored_pose_is_mirrored(nominal):
    """With mirrored joint angles every left body is the right one's mirror image to 1 um."""
    signs = {"shoulder_pitch": 1, "shoulder_roll": -1, "elbow": 1, "hip_yaw": -1, "hip_roll": -1, "hip_pitch": 1}
    signs |= {"knee": 1, "ankle_pitch": 1, "ankle_roll": -1}
    data = mujoco.MjData(nominal)
    for angle, (joint, sign) in zip(np.linspace(-0.5, 0.6, len(signs)), signs.items(), strict=True):
        data.joint(f"left_{joint}").qpos = angle
        data.joint(f"right_{joint}").qpos = sign * angle
    mujoco.mj_kinematics(nominal, data)
    for name in ("left_forearm", "left_shank", "left_foot"):
        left, right = data.body(name).xpos, data.body(name.replace("left", "right")).xpos
        np.testing.assert_allclose(left, right * [1, -1, 1], rtol=0, atol=1e-6)


def test_self_contact_measures_the_forces_between_limbs(nominal):
    """The slots hold the 8 largest forces between parts of the robot, none of the floor's, and are zero when clear."""
    data = mujoco.MjData(nominal)
    mujoco.mj_resetDataKeyframe(nominal, data, 0)
    mujoco.mj_forward(nominal, data)
    assert data.ncon > 0
    assert not data.sensor("self_contact").data.any()
    data.joint("left_hip_roll").qpos = -0.22
    mujoco.mj_forward(nominal, data)
    force, norms = np.zeros(6), []
    for i, contact in enumerate(data.contact):
        if nominal.geom("floor").id not in contact.geom:
            mujoco.mj_contactForce(nominal, data, i, force)
            norms.append(np.linalg.norm(force[:3]))
    slots = data.sensor("self_contact").data.reshape(-1, 3)
    largest = np.sort(norms)[-8:]
    assert largest.size == 8
    assert largest.max() > 1
    np.testing.assert_allclose(np.sort(np.linalg.norm(slots, axis=1)), largest)

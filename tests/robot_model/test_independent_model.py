"""The nominal model against a second one, built from the tables by other code."""

import mujoco
import numpy as np
import pytest


def numbers(row, prefix, axes):
    return [float(row[f"{prefix}_{axis}"]) for axis in axes]


@pytest.fixture(scope="module")
def rebuilt(table):
    """A model from the tables alone: no XML, no classes, no delays."""
    spec = mujoco.MjSpec()
    spec.option.noslip_iterations = 1
    bodies = {"world": spec.worldbody}
    for row in table("bodies"):
        body = bodies[row["parent"]].add_body(
            name=row["alias"], pos=numbers(row, "pos", "xyz"), quat=numbers(row, "quat", "wxyz")
        )
        bodies[row["name"]] = body
        if row["inertia_source"] != "from_geom":
            body.explicitinertial = True
            body.mass, body.ipos = float(row["mass"]), numbers(row, "com", "xyz")
            body.iquat, body.inertia = numbers(row, "iquat", "wxyz"), numbers(row, "inertia", "123")
    for row in table("joints"):
        kind = mujoco.mjtJoint.mjJNT_FREE if row["type"] == "free" else mujoco.mjtJoint.mjJNT_HINGE
        joint = bodies[row["body"]].add_joint(name=row["name"], type=kind)
        if row["type"] == "hinge":
            joint.axis, joint.pos = numbers(row, "axis", "xyz"), numbers(row, "pos", "xyz")
            joint.damping = [float(row["damping"]), *joint.damping[1:]]
            joint.armature, joint.frictionloss = float(row["armature"]), float(row["frictionloss"])
    for row in table("geoms"):
        bodies[row["body"]].add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{row['type'].upper()}"),
            size=[float(row[f"size_{k}"] or 0) for k in (1, 2, 3)],
            pos=numbers(row, "pos", "xyz"),
            quat=numbers(row, "quat", "wxyz"),
        )
    for row in table("sites"):
        bodies[row["body"]].add_site(
            name=row["name"], pos=numbers(row, "pos", "xyz"), quat=numbers(row, "quat", "wxyz")
        )
    for row in table("actuators"):
        actuator = spec.add_actuator(name=row["name"], target=row["joint"], trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=float(row["kp"]))
        actuator.forcerange, actuator.forcelimited = numbers(row, "force", ("lo", "hi")), True
        actuator.ctrlrange, actuator.ctrllimited = numbers(row, "ctrl", ("lo", "hi")), True
    return spec.compile()


def random_state(model, data, rng):
    mujoco.mj_resetData(model, data)
    attitude = rng.normal(size=4)
    data.qpos[:3] = rng.uniform(-1, 1, 3)
    data.qpos[3:7] = attitude / np.linalg.norm(attitude)
    data.qpos[7:] = rng.uniform(-2, 2, model.nq - 7)
    data.qvel[:] = rng.normal(0, 2, model.nv)


def test_dynamics_and_kinematics(nominal, rebuilt):
    """Mass matrix, bias forces and every frame agree to 1e-6 at random states."""
    for seed in range(8):
        both = []
        for model in (nominal, rebuilt):
            data = mujoco.MjData(model)
            random_state(model, data, np.random.default_rng(seed))
            mujoco.mj_forward(model, data)
            mass = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, mass)
            frames = [data.xpos, data.xmat, data.xipos, data.ximat, data.geom_xpos, data.geom_xmat, data.site_xpos]
            both.append([mass, data.qfrc_bias, *(frame.copy() for frame in frames), data.site_xmat])
        for ours, theirs in zip(*both, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


def test_fall_is_the_same(nominal, rebuilt):
    """Dropped tilted with moving commands, both fall alike: names, sensors and history change no motion."""
    end = []
    for model in (nominal, rebuilt):
        data = mujoco.MjData(model)
        data.qpos[:7] = [0, 0, 0.45, np.cos(0.5), 0, np.sin(0.5), 0]
        for step in range(500):
            data.ctrl[:] = 0.4 * np.sin(0.01 * step + np.arange(model.nu))
            mujoco.mj_step(model, data)
        end.append(data.qpos.copy())
    np.testing.assert_allclose(end[0], end[1], rtol=0, atol=1e-9)
    assert np.abs(end[0][7:]).max() > 0.2

"""The model of a task is the file's, in every physical number, less what no one looks at."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.config import Names, Physics, Task
from frasa_rl.robot import ADDED_SELF_CONTACT, find_robot, sensor_names
from frasa_rl.standup_env import StandUp
from frasa_rl.task_model import build_model, substeps
from frasa_sysid.calibration import InputError, ModelError, hold_history, load_model, stepping

# What speaks of sensors, pictures, and where things stand in memory; all else is the robot.
LESS = ("sensor_", "mat_", "tex_", "name_", "names", "geom_matid", "nsensor", "nuser_sensor", "nmat", "ntex", "nnames",
        "nbuffer", "nhistory", "paths", "npaths", "nM", "signature", "actuator_historyadr", "text", "numeric", "tuple",
        "nJmom")  # fmt: skip


@pytest.fixture(params=["nominal", "calibrated"])
def both(request, robot_model_dir):
    """A file's own model and the task's."""
    path = robot_model_dir / f"{request.param}.xml"
    return load_model(path), build_model(path, Task())


def run(model, pose, steps=200):
    """Positions on the way down from a crouch in the air, commands waving."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] += 0.1
    data.qpos[7:] += pose
    data.ctrl[:] = model.key_ctrl[0]
    hold_history(model, data)
    found, touched = [], 0
    for k in range(steps):
        data.ctrl[:] = model.key_ctrl[0] + 0.3 * np.sin(0.05 * k + np.arange(model.nu))
        mujoco.mj_step(model, data)
        found.append(np.concatenate([data.qpos, data.qvel]))
        touched += data.ncon > 0
    return np.array(found), touched


def test_no_number_of_the_robot_changes(both):
    """Every array of the model and every option, but what is of sensors and pictures."""
    whole, pruned = both
    compared = []
    for name in dir(whole):
        value = getattr(whole, name)
        if name.startswith(("_", *LESS)) or not isinstance(value, np.ndarray | int):
            continue
        np.testing.assert_array_equal(getattr(pruned, name), value, err_msg=name)
        compared.append(name)
    assert {"body_mass", "dof_armature", "geom_size", "actuator_gainprm", "dof_invweight0", "qpos0"} <= set(compared)
    assert len(compared) > 200
    for name in dir(whole.opt):
        if not name.startswith("_") and not callable(getattr(whole.opt, name)):
            np.testing.assert_array_equal(getattr(pruned.opt, name), getattr(whole.opt, name), err_msg=name)
    for name in ("numeric_data", "text_data", "tuple_objid", "tuple_objprm"):
        np.testing.assert_array_equal(getattr(pruned, name), getattr(whole, name))
    assert (whole.actuator_history[:, 0] == pruned.actuator_history[:, 0]).all()


def test_the_sensors_left_are_the_files(both):
    """The ones the task reads, with type, object, delay and noise as they were, and no other."""
    whole, pruned = both
    kept = set(sensor_names(Task()))
    assert {pruned.sensor(i).name for i in range(pruned.nsensor)} == kept
    assert pruned.nsensor < whole.nsensor
    for name in kept:
        a, b = whole.sensor(name).id, pruned.sensor(name).id
        for field in (
            "type",
            "objtype",
            "objid",
            "reftype",
            "refid",
            "dim",
            "cutoff",
            "noise",
            "delay",
            "history",
            "intprm",
        ):
            np.testing.assert_array_equal(getattr(pruned, f"sensor_{field}")[b], getattr(whole, f"sensor_{field}")[a])
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    assert mujoco.mj_stateSize(pruned, full) < 0.7 * mujoco.mj_stateSize(whole, full)


def test_it_moves_as_the_files(both):
    """The same motion through falls and contacts, to 1e-12."""
    (a, touched), (b, _) = (run(model, 0.05 * np.sin(np.arange(20))) for model in both)
    np.testing.assert_allclose(b, a, rtol=0, atol=1e-12)
    assert touched > 20


def test_pictures_keep_their_textures(nominal):
    """Asked for, the model looks as its file says."""
    whole, seen = load_model(nominal), build_model(nominal, Task(), textures=True)
    np.testing.assert_array_equal(seen.geom_matid, whole.geom_matid)
    assert (seen.nmat, seen.ntex) == (whole.nmat, whole.ntex)
    bare = build_model(nominal, Task())
    assert (bare.nmat, bare.ntex) == (0, 0)
    assert (bare.geom_matid == -1).all()


def test_the_added_self_contact_is_the_files_own(nominal):
    """Where the task names no sensor, the one that is added says what the file's says."""
    task = replace(Task(), names=replace(Names(), self_contact=None))
    models = [build_model(nominal, Task()), build_model(nominal, task)]
    assert models[1].sensor(ADDED_SELF_CONTACT).dim == models[0].sensor("self_contact").dim
    rng, seen = np.random.default_rng(0), []
    for _ in range(40):
        pose = rng.uniform(-0.5, 0.5, 20)
        forces = []
        for model, one in zip(models, (Task(), task), strict=True):
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            data.qpos[7:] = pose
            mujoco.mj_forward(model, data)
            slots = data.sensordata[find_robot(model, one).self_contact].reshape(-1, 3)
            forces.append(np.linalg.norm(slots, axis=1).sum())
        assert forces[1] == pytest.approx(forces[0], rel=1e-12)
        seen.append(forces[0] > 0.0)
    assert 5 < sum(seen) < 40


def pairs_of(model, qpos):
    """Bodies in contact, the floor's as 0."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return {tuple(sorted(model.geom_bodyid[one.geom].tolist())) for one in data.contact}


def ball(spec):
    """A ball in the robot's chest and the floor; it can go anywhere."""
    body = spec.worldbody.add_body(name="ball", pos=[0.05, 0, 0.1])
    body.add_freejoint()
    body.add_geom(size=[0.15, 0, 0])


@pytest.mark.parametrize("add", [None, ball])
def test_without_self_collision_the_rest_is_still_touched(nominal, add):
    """The same contacts with the floor and whatever else there is, and none between parts of the robot."""
    usual = build_model(nominal, Task(), add=add)
    loose = build_model(nominal, replace(Task(), physics=Physics(self_collision=False)), add=add)
    same = build_model(nominal, replace(Task(), physics=Physics(self_collision=True)), add=add)
    others = {usual.geom_bodyid[usual.geom("floor").id]} | ({usual.body("ball").id} if add else set())
    rng, crossed = np.random.default_rng(1), 0
    for _ in range(30):
        qpos = np.concatenate([[0, 0, rng.uniform(0.0, 0.2), 1, 0, 0, 0], rng.uniform(-1.5, 1.5, 20), usual.qpos0[27:]])
        before, after = pairs_of(usual, qpos), pairs_of(loose, qpos)
        assert after == {pair for pair in before if others & set(pair)}
        assert pairs_of(same, qpos) == before
        assert after
        crossed += len(before) > len(after)
    assert crossed > 10


@pytest.mark.parametrize("timestep", [0.003, 0.1, 0.0501])
def test_steps_must_divide_the_period(nominal, timestep):
    """A time step that does not divide the control period is refused, in the file or in the task."""
    task = replace(Task(), physics=Physics(timestep=timestep))
    with pytest.raises(ModelError, match="does not divide the control period"):
        build_model(nominal, task)
    model = build_model(nominal, Task())
    assert substeps(model, 0.05) == 25
    with pytest.raises(ModelError, match="does not divide"):
        substeps(model, 0.0)


@pytest.mark.parametrize("timestep", [0.0, -0.002, np.nan, np.inf])
def test_a_time_step_that_is_none(nominal, timestep):
    """Zero, negative, not finite: refused as such, not taken for the file's."""
    with pytest.raises(InputError, match="timestep"):
        build_model(nominal, replace(Task(), physics=Physics(timestep=timestep)))


def test_every_setting_arrives(robot_model_dir):
    """All physics settings of a task are in the model that steps, and what is None is the file's."""
    path = robot_model_dir / "calibrated.xml"
    physics = Physics(0.005, "implicitfast", "elliptic", 7, 1e-4, 3, False)
    option = build_model(path, replace(Task(), physics=physics)).opt
    assert option.timestep == 0.005
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert (option.iterations, option.tolerance, option.noslip_iterations) == (7, 1e-4, 3)
    longer = build_model(path, replace(Task(), physics=Physics(timestep=0.005)))
    assert stepping.lead(longer) == 0.0025
    usual = build_model(path, Task())
    for dof in range(6, usual.nv):
        assert stepping.armature_of(longer, dof) == pytest.approx(stepping.armature_of(usual, dof), rel=1e-12)


def test_another_step_has_room_for_the_same_delays(nominal):
    """Buffers of another time step hold at least as long a delay as the file's, and little more."""
    usual = build_model(nominal, Task())
    for timestep in (0.001, 0.0025, 0.005, 0.01):
        model = build_model(nominal, replace(Task(), physics=Physics(timestep=timestep)))
        delayed = usual.sensor_history[:, 0] > 0
        room = model.sensor_history[delayed, 0] * timestep
        assert (room >= usual.sensor_history[delayed, 0] * 0.002 - 1e-12).all()
        assert (room <= 0.08 + 2 * timestep + 1e-9).all()
        assert (model.sensor_history[~delayed, 0] == 0).all()


def test_something_can_be_added_to_the_scene(nominal):
    """A ball is in the model with the robot, which is as it was."""
    model = build_model(nominal, Task(), add=ball)
    assert model.body("ball").id == model.nbody - 1
    assert find_robot(model, Task()).qpos.shape == (5, 2)


@pytest.mark.parametrize("content", [None, "<mujoco><worldbody>", "<mujoco><worldbody><body/></worldbody></mujoco>"])
def test_broken_files_are_said_to_be_broken(tmp_path, content):
    """Missing, not XML, no robot: one clear error each."""
    path = tmp_path / "model.xml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ModelError, match=r"no model at|is not XML|cannot compile|lacks joint"):
        StandUp(path)

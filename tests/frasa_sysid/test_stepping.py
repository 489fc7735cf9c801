"""Trapezoidal stepping: second order in the step, friction that holds, and the same numbers read as written."""

import json

import mujoco
import numpy as np
import pytest

from frasa_sysid import stored_fit
from frasa_sysid.calibration import ModelError, actuators_of, apply, dofs_of, load_model, read, servo_classes
from frasa_sysid.calibration.errors import CalibrationError
from frasa_sysid.calibration.stepping import EULER, TRAPEZOIDAL, lead, make_trapezoidal, stepping_of
from frasa_sysid.errors import InputError
from frasa_sysid.publish import publish, write
from frasa_sysid.robot_body import bare


@pytest.fixture(scope="module")
def fits(robot_model_dir):
    return [stored_fit.load(robot_model_dir / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]


@pytest.fixture
def models(robot_model_dir, tmp_path):
    """A copy of the robot's files."""
    for source in robot_model_dir.glob("*.xml"):
        (tmp_path / source.name).write_text(source.read_text())
    return tmp_path


def swing(bench, step, trapezoidal):
    """Angles [rad] every 2 ms of a servo that swings its pendulum up, at another step, without dry friction."""
    model = bench
    model.opt.timestep = step
    if trapezoidal:
        make_trapezoidal(model, [0])
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    found = []
    for k in range(round(1.0 / step)):
        # The torque of a step makes the speed of its middle: the goal of half a step later belongs to it.
        data.ctrl[0] = np.sin(6.0 * k * step)
        if k % round(0.002 / step) == 0:
            found.append(data.qpos[0])
        mujoco.mj_step(model, data)
    return np.array(found)


def test_it_is_of_second_order_where_mujocos_own_is_of_first(bench_files):
    """A swing at 2 and 1 ms against one at 0.02 ms: a quarter of a small error, against half of a large one."""
    exact = swing(load_model(bench_files[EULER]), 0.00002, True)
    errors = {}
    for trapezoidal in (False, True):
        found = [swing(load_model(bench_files[EULER]), step, trapezoidal) for step in (0.002, 0.001)]
        errors[trapezoidal] = [float(np.abs(one - exact).max()) for one in found]
    coarse, fine = errors[False]
    assert 1.7 < coarse / fine < 2.4
    assert errors[True][0] < 0.15 * coarse
    assert errors[True][0] > 2.5 * errors[True][1]


def test_numbers_read_as_they_are_written(bench_files):
    """Damping leaves armature as it is, in whichever order both are set; what stands in the model holds both."""
    model = load_model(bench_files[TRAPEZOIDAL])
    assert (stepping_of(model), lead(model)) == (TRAPEZOIDAL, 0.001)
    for values in ({"mx106.armature": 0.03, "mx106.damping": 2.5}, {"mx106.damping": 1.5, "mx106.armature": 0.02}):
        apply(model, values)
        for name, value in values.items():
            assert read(model, name) == pytest.approx(value, rel=1e-12)
        total = values["mx106.armature"] + 0.001 * values["mx106.damping"]
        assert model.dof_armature[0] == pytest.approx(total, rel=1e-12)
    before = read(model, "mx106.armature")
    apply(model, {"mx106.damping": 9.0})
    assert read(model, "mx106.armature") == pytest.approx(before, rel=1e-12)
    again = model.dof_armature.copy()
    make_trapezoidal(model, [0])
    np.testing.assert_array_equal(model.dof_armature, again)
    assert stepping_of(load_model(bench_files[EULER])) == EULER


def test_a_published_joint_is_held_by_its_friction(robot_model_dir):
    """Torque within the friction's bound turns no joint of the published robot; one of the nominal robot creeps."""
    crept = {}
    for name in ("nominal", "calibrated"):
        model = bare(robot_model_dir / f"{name}.xml", held=True)
        model.opt.gravity[:] = 0.0
        model.actuator_gainprm[:, 0] = model.actuator_biasprm[:, 1] = 0.0
        model.dof_frictionloss[:] = 0.1
        data = mujoco.MjData(model)
        data.qfrc_applied[:] = 0.05
        mujoco.mj_step(model, data, 1000)
        crept[name] = float(np.abs(data.qpos - model.qpos0).max())
    assert crept["calibrated"] < 0.1 * crept["nominal"]
    assert crept["calibrated"] < 1e-4


def test_the_published_model_steps_as_the_bench(robot_model_dir, models, fits):
    """Flag, friction rows and armatures of all servos are there, also of those that no fit speaks of."""
    out = models / "calibrated.xml"
    nominal = load_model(models / "nominal.xml")
    for given in (fits, fits[:1]):
        write(publish(given, models / "nominal.xml", out), models / "nominal.xml", out)
        model = load_model(out)
        assert stepping_of(model) == TRAPEZOIDAL
        for servo in servo_classes(model):
            dofs = dofs_of(model, actuators_of(model, servo))
            told = {one.servo: one.parameters for one in given}.get(servo)
            expected = told[f"{servo}.armature"]["value"] if told else read(nominal, f"{servo}.armature")
            assert read(model, f"{servo}.armature") == pytest.approx(expected, rel=1e-12)
            np.testing.assert_allclose(model.dof_armature[dofs], expected + 0.001 * model.dof_damping[dofs])
            assert (model.dof_solref[dofs] == [0.004, 1.0]).all()
            assert (model.dof_solimp[dofs, 0] == 0.99).all()


def test_older_fits_are_published_as_they_were_made(robot_model_dir, models, fits, tmp_path):
    """Without a word on stepping a fit was made with MuJoCo's own; it does not go together with a new one."""
    data = json.loads((robot_model_dir / "fits" / "mx106.json").read_text())
    del data["stepping"]
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = stored_fit.load(tmp_path / "old.json")
    out = models / "calibrated.xml"
    write(publish([old], models / "nominal.xml", out), models / "nominal.xml", out)
    assert stepping_of(load_model(out)) == EULER
    assert load_model(out).opt.disableflags == 0
    with pytest.raises(CalibrationError, match=r"mx106 euler, mx64 trapezoidal.*fit the older one again"):
        publish([old, fits[1]], models / "nominal.xml", out)
    data["stepping"] = "sideways"
    (tmp_path / "old.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="stepping = 'sideways'"):
        stored_fit.load(tmp_path / "old.json")


def test_a_robot_with_another_integrator_is_refused(models, fits):
    """It takes damping in another way than the bench that the numbers come from."""
    path = models / "nominal.xml"
    path.write_text(path.read_text().replace('integrator="Euler"', 'integrator="implicitfast"'))
    with pytest.raises(ModelError, match="integrator Euler, the model has implicitfast"):
        publish(fits, path, models / "calibrated.xml")

"""Another time step or integrator for a published model: the same joints, as heavy and as rough as they were."""

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import ModelError, compile_model, load_model, load_spec
from frasa_sysid.calibration.stepping import HARD_STEPS, armature_of, lead, restep, stepping_of
from frasa_sysid.robot_body import bare

EULER, IMPLICIT = int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)


@pytest.fixture(params=["nominal", "calibrated"])
def model(request, robot_model_dir):
    return load_model(robot_model_dir / f"{request.param}.xml")


def servos(model):
    return np.unique(model.jnt_dofadr[model.actuator_trnid[:, 0]])


@pytest.mark.parametrize(
    ("timestep", "integrator"), [(0.001, None), (0.005, None), (None, IMPLICIT), (0.004, IMPLICIT)]
)
def test_inertia_stays(model, timestep, integrator):
    """What a joint weighs does not depend on step and integrator; there and back again is where it was."""
    before = [armature_of(model, int(dof)) for dof in servos(model)]
    raw, old, way = model.dof_armature.copy(), model.opt.timestep, stepping_of(model)
    soft = model.dof_solref.copy()
    restep(model, timestep, integrator)
    assert model.opt.timestep == (timestep or old)
    assert model.opt.integrator == (EULER if integrator is None else integrator)
    np.testing.assert_allclose([armature_of(model, int(dof)) for dof in servos(model)], before, rtol=1e-12)
    assert (lead(model) > 0.0) == (way == "trapezoidal" and integrator is None)
    others = np.setdiff1d(np.arange(model.nv), servos(model))
    np.testing.assert_array_equal(model.dof_armature[others], raw[others])
    restep(model, old, EULER)
    np.testing.assert_allclose(model.dof_armature, raw, rtol=1e-12)
    np.testing.assert_allclose(model.dof_solref, soft, rtol=1e-12)


def test_hard_friction_rows_follow_the_step(robot_model_dir):
    """Rows as hard as the step allows stay so; MuJoCo's soft ones are not the step's affair."""
    hard, soft = (load_model(robot_model_dir / f"{name}.xml") for name in ("calibrated", "nominal"))
    before = soft.dof_solref.copy()
    for timestep in (0.001, 0.005, 0.0025):
        restep(hard, timestep)
        restep(soft, timestep)
        np.testing.assert_allclose(hard.dof_solref[servos(hard), 0], HARD_STEPS * timestep, rtol=1e-12)
        np.testing.assert_array_equal(soft.dof_solref, before)


def test_a_joint_moves_alike_at_one_and_two_milliseconds(robot_model_dir):
    """A published robot, held by its trunk, waves its joints without dry friction: the paths agree to 0.4 mrad.

    Armature as it stands in the file, with the other step's half damping in it, is well apart. The waves begin
    smoothly: the first step of a sudden torque is another one at every time step.
    """

    def wave(timestep, wrong=False):
        model = bare(robot_model_dir / "calibrated.xml", held=True)
        model.opt.gravity[:] = 0.0
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        model.actuator_delay[:] = model.dof_frictionloss[:] = 0.0
        if wrong:
            model.opt.timestep = timestep
        else:
            restep(model, timestep)
        data, found = mujoco.MjData(model), []
        for k in range(round(0.6 / timestep)):
            data.ctrl[:] = 0.3 * (1.0 - np.cos(8.0 * k * timestep)) * np.cos(np.arange(model.nu))
            mujoco.mj_step(model, data)
            if (k + 1) % round(0.02 / timestep) == 0:
                found.append(data.qpos.copy())
        return np.array(found)

    fine = wave(0.00025)
    errors = {step: np.abs(wave(step) - fine).max() for step in (0.001, 0.002)}
    assert np.ptp(fine, axis=0).max() > 0.5
    assert errors[0.002] < 0.0004
    assert errors[0.001] < 0.6 * errors[0.002]
    assert np.abs(wave(0.001, wrong=True) - fine).max() > 4 * errors[0.001]


@pytest.mark.parametrize("timestep", [0.0, -0.001, np.nan, np.inf])
def test_a_time_step_that_is_none_is_refused(model, timestep):
    """And the model is as it was."""
    before = model.dof_armature.copy()
    with pytest.raises(ModelError, match="expected a positive number"):
        restep(model, timestep)
    np.testing.assert_array_equal(model.dof_armature, before)
    assert model.opt.timestep == 0.002


def test_reading_and_compiling_keep_their_errors(tmp_path, robot_model_dir):
    """A missing file, one that is not MuJoCo's, one that does not compile: named, in MuJoCo's own words."""
    with pytest.raises(ModelError, match=r"no model at .*gone\.xml: expected a MuJoCo XML file"):
        load_spec(tmp_path / "gone.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><nonsense/></worldbody></mujoco>")
    with pytest.raises(ModelError, match=r"broken\.xml: MuJoCo cannot compile it: .*nonsense"):
        load_spec(broken)
    massless = tmp_path / "massless.xml"
    massless.write_text("<mujoco><worldbody><body><freejoint/></body></worldbody></mujoco>")
    spec = load_spec(massless)
    with pytest.raises(ModelError, match=r"massless\.xml: MuJoCo cannot compile it: .*mass"):
        compile_model(spec, massless)
    path = robot_model_dir / "calibrated.xml"
    bad = load_spec(path)
    (law,) = [one for one in bad.numerics if one.name == "mx106_friction"]
    law.data = [np.nan] * len(law.data)
    with pytest.raises(ModelError, match=r"calibrated\.xml: .*mx106"):
        compile_model(bad, path)

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.calibration import stepping
from frasa_sysid.cost import misfit
from frasa_sysid.errors import ModelError
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.servo_values import ServoValues


@pytest.fixture(scope="module")
def values(kit):
    return ServoValues(**kit.truth)


@pytest.fixture(scope="module")
def runs(kit, recordings):
    return kit.runs(recordings)


def powered_share(run, delay, k, dt):
    """Share of step k during which the torque flag, late by the delay, is on."""
    fine = (k + (np.arange(2000) + 0.5) / 2000) * dt
    turns = np.searchsorted(run.switches + delay, fine, side="right")
    return float(np.mean((turns % 2 == 0) == run.powered_first))


def plain(model_path, run, values):
    """The same run in a plain `mj_step` loop, with a model configured by hand."""
    model = mujoco.MjModel.from_xml_path(str(model_path))
    dt = model.opt.timestep
    distance = 0.9 * run.inertia * 9.81 / run.gravity_torque
    model.body_mass[1] = run.gravity_torque / (9.81 * distance)
    model.body_ipos[1] = (0, 0, -distance)
    model.body_inertia[1] = run.inertia - model.body_mass[1] * distance**2
    trapezoidal = stepping.lead(model) > 0.0
    model.dof_armature[0] = values.armature
    model.dof_frictionloss[0] = values.frictionloss
    model.actuator_delay[0] = values.delay
    limit = values.forcerange * run.force_scale
    model.actuator_forcerange[0] = (-limit, limit)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = run.q0 - values.offset, run.dq0
    times = (np.arange(16) - 16) * dt
    mujoco.mj_initCtrlHistory(model, data, 0, times, np.full(16, run.command[0] - values.offset))
    angle = [data.qpos[0]]
    near = {int((turn + values.delay) / dt) for turn in run.switches}
    on = float(run.powered_first)
    for k in range(run.steps):
        if k in near or k - 1 in near:
            on = powered_share(run, values.delay, k, dt)
        gain = on * values.kp * run.kp_scale
        model.actuator_gainprm[0, 0], model.actuator_biasprm[0, 1] = gain, -gain
        damping = on * values.damping + (1 - on) * values.damping_off
        model.dof_damping[0] = damping
        model.dof_armature[0] = values.armature + (dt / 2 * damping if trapezoidal else 0.0)
        data.ctrl[0] = run.command[k] - values.offset
        mujoco.mj_step(model, data)
        angle.append(data.qpos[0])
    return np.interp(run.t, np.arange(run.steps + 1) * dt, angle) + values.offset


@pytest.mark.parametrize("i", [0, 3, 5])
@pytest.mark.parametrize("delay", [0.0, 0.008, 0.0105])
def test_equals_plain_steps(kit, values, runs, robot_model_dir, i, delay):
    """A rollout is the plain loop of MuJoCo steps: delay, offset, saturation and a torque switch included."""
    at = replace(values, delay=delay)
    # `powered_share` counts microseconds, so the switch stands on one.
    run = replace(runs[i], switches=np.round(runs[i].switches * 1e6) * 1e-6)
    found = kit.simulator.simulate([run], [at])[0][0]
    np.testing.assert_allclose(found, plain(robot_model_dir / "bench_pendulum.xml", run, at), atol=1e-12)


def test_batches_and_neighbours_change_nothing(kit, values, runs):
    """A run gives the same answer alone, in company, in any order and at any length of the others."""
    other = replace(values, kp=10.0, delay=0.02)
    together = kit.simulator.simulate(runs, [values, other, values])
    for i, run in enumerate(runs):
        np.testing.assert_array_equal(kit.simulator.simulate([run], [other])[0][0], together[1][i])
        np.testing.assert_array_equal(together[0][i], together[2][i])
    backwards = kit.simulator.simulate(runs[::-1], [values])[0]
    for one, two in zip(backwards[::-1], together[0], strict=True):
        np.testing.assert_array_equal(one, two)
    assert kit.simulator.simulate([], [values]) == [[]]


def test_nothing_to_fit_costs_nothing(kit, values, runs):
    """Logs made by the simulator itself, compared with their own truth, have no residual."""
    own = [replace(run, y=y) for run, y in zip(runs, kit.simulator.simulate(runs, [values])[0], strict=True)]
    again = kit.simulator.simulate(own, [values])[0]
    assert misfit(own, again).mae_rad == 0.0
    assert misfit(own, kit.simulator.simulate(own, [replace(values, damping=1.5)])[0]).mae_rad > 1e-3
    # The compiled kernel sees the very same bench.
    kernel = kit.session.kernel(own)
    assert kernel.costs(np.array([values.array()]))[0] < 1e-12
    assert kernel.costs(np.array([replace(values, damping=1.5).array()]))[0] > 1e-3


@pytest.mark.parametrize("i", [0, 5])
def test_continuous_in_the_delay(kit, values, runs, i):
    """A slightly longer delay changes the readings slightly: at step boundaries, and where it moves a torque switch."""
    run = runs[i]
    dt = kit.simulator.timestep
    edges = [k * dt for k in (1, 4, 15)] + [dt - run.switches[0] % dt + k * dt for k in (0, 3) if run.switches.size]
    eps = 1e-8
    pairs = [replace(values, delay=edge + side * eps) for edge in edges for side in (-1, 1)]
    found = kit.simulator.simulate([run], pairs)
    for before, after in zip(found[::2], found[1::2], strict=True):
        np.testing.assert_allclose(before[0], after[0], atol=2e-6)


def test_a_delay_is_time(kit, values, runs):
    """Delaying by whole steps is the same as goals written that much later; the offset is taken off and put back."""
    run = runs[0]
    whole = 5
    later = replace(run, command=np.concatenate([np.full(whole, run.command[0]), run.command[:-whole]]))
    one = kit.simulator.simulate([run], [replace(values, delay=whole * kit.simulator.timestep)])[0][0]
    two = kit.simulator.simulate([later], [replace(values, delay=0.0)])[0][0]
    np.testing.assert_allclose(one, two, atol=1e-9)


@pytest.mark.filterwarnings("ignore")
def test_a_diverged_run_says_so(kit, values, runs, tmp_path, monkeypatch):
    """A simulation that blows up is NaN from there on, in every later phase, and leaves its neighbours alone."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log beside the caller
    wild = replace(values, damping=-50.0)
    found = kit.simulator.simulate(runs, [wild, values])
    for i in (0, 5):
        bad = np.isnan(found[0][i])
        assert bad[-1]
        assert not bad[0]
        assert (np.diff(bad.astype(int)) >= 0).all()
        assert np.isfinite(found[1][i]).all()
    assert np.isfinite(misfit(runs, found[0]).mae_rad)
    assert np.isfinite(kit.session.kernel(runs).costs(np.array([wild.array()]))[0])


def test_torque_off_is_a_free_pendulum(kit, values, runs):
    """With the motor off neither gain nor powered damping has any say."""
    free = replace(runs[5], switches=np.zeros(0), powered_first=False, q0=0.9)
    wild = replace(values, kp=90.0, damping=4.0, forcerange=20.0, delay=0.03)
    one, two = (found[0] for found in kit.simulator.simulate([free], [values, wild]))
    np.testing.assert_array_equal(one, two)
    assert np.ptp(one) > 0.8


def test_any_other_model_is_refused(robot_model_dir, tmp_path):
    """A model that is not one delayed servo on a hinge is named as such."""
    with pytest.raises(ModelError, match="one hinge"):
        BenchSimulator(robot_model_dir / "nominal.xml", 1.0)
    with pytest.raises(ModelError, match="no model at"):
        BenchSimulator(tmp_path / "none.xml", 1.0)

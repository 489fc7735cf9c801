"""Batches of candidates: the same bits in any company, costs as numpy has them, and divergence that stays finite."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid.bench_kernel import kernel_options
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import load_model
from frasa_sysid.cost import DIVERGED, ROBUST_WIDTH
from frasa_sysid.errors import ModelError
from frasa_sysid.rig import BenchRun
from frasa_sysid.servo import servo
from frasa_sysid.servo_values import COLUMN, ServoValues

STEP = 0.002
VALUES = ServoValues(
    kp=20.0, forcerange=5.0, damping=0.9, damping_off=0.1, frictionloss=0.1, armature=0.02, delay=0.007, offset=0.01
)
M6 = {
    "stribeck": 0.05, "load_motor": 0.1, "load_external": 0.08, "load_motor_stribeck": 0.1,
    "load_external_stribeck": 0.07, "quad_motor": 0.02, "quad_external": 0.03, "stribeck_speed": 0.4,
    "stribeck_exponent": 1.3,
}  # fmt: skip
EFFECTS = {
    "sag": 0.2, "follow": 0.8, "punch": 0.004, "dead_zone": 0.003, "collapse_at": 0.2, "collapse_to": 0.8,
    "bias": 0.02, "goal_speed": 4.0,
}  # fmt: skip


def run(rng, i):
    """A run of its own length, load, switches and course of supply."""
    steps = int(rng.integers(200, 900))
    at = np.arange(steps) * STEP
    t = np.sort(np.append(rng.uniform(0.0, at[-1], 60), 0.0))
    cells = np.floor(t / STEP)
    return BenchRun(
        name=f"run{i}", group="", rig="", trajectory="", control="position", inertia=float(rng.uniform(0.002, 0.05)),
        gravity_torque=float(rng.uniform(0.1, 2.0)), kp_scale=1.0, force_scale=1.0,
        command=np.where(at % 0.5 < 0.25, 0.8, -0.5) + 0.1 * i, lead=0, supply=1.0 + 0.1 * np.sin(9.0 * at),
        switches=rng.uniform(0.2, 1.5, i % 2), powered_first=True, q0=0.1, dq0=0.0,
        t=t, y=0.5 * np.sin(3.0 * t), step=cells, weight=t / STEP - cells,
    )  # fmt: skip


@pytest.fixture(scope="module")
def runs():
    rng = np.random.default_rng(0)
    return [run(rng, i) for i in range(7)]


@pytest.fixture(scope="module", params=[1, 3])
def session(request, robot_model_dir):
    with BenchSession(robot_model_dir / "bench_pendulum.xml", servo("mx106"), request.param) as one:
        yield one


@pytest.fixture(scope="module")
def kernel(session, runs):
    return session.kernel(runs)


def candidates(count, seed=1):
    """Of all kinds: the first M1, then M6, with effects, with both, and so on."""
    rng = np.random.default_rng(seed)
    kinds = [{}, M6, EFFECTS, {**M6, **EFFECTS}]
    servos = [replace(VALUES, **kinds[i % 4]).array() for i in range(count)]
    moved = np.array(servos) * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, (count, len(servos[0]))))
    moved[:, COLUMN["collapse_to"]] = np.array(servos)[:, COLUMN["collapse_to"]]
    return moved


def test_company_changes_no_bit(session, runs, kernel):
    """Alone or in a batch, in any order, with other runs: M1's own loop gives what the full one gives."""
    many = candidates(21)
    together = kernel.readings(many)
    np.testing.assert_array_equal(kernel.readings(many[::-1]), together[::-1])
    for i in range(0, 21, 4):  # M1 alone takes the shortest loop
        for j in range(i, min(i + 4, 21)):
            np.testing.assert_array_equal(kernel.readings(many[j : j + 1])[0], together[j])
    np.testing.assert_array_equal(kernel.readings(many[::4]), together[::4])
    split = session.split(kernel, many)
    for i, one in enumerate(runs):
        alone = session.kernel([one]).readings(many)
        for j in range(21):
            np.testing.assert_array_equal(alone[j], split[j][i])


def test_threads_change_no_bit(robot_model_dir, runs):
    found = []
    for threads in (1, 2, 5):
        with BenchSession(robot_model_dir / "bench_pendulum.xml", servo("mx106"), threads) as session:
            kernel = session.kernel(runs)
            many = candidates(13)
            found.append((kernel.readings(many), kernel.costs(many), kernel.rooted(many)))
    for other in found[1:]:
        for one, first in zip(other, found[0], strict=True):
            np.testing.assert_array_equal(one, first)


def test_costs_are_numpys(runs, kernel):
    many = candidates(9)
    measured = np.concatenate([one.y for one in runs])
    losses = np.hypot(1.0, (kernel.readings(many) - measured) / ROBUST_WIDTH) - 1.0
    expected = [ROBUST_WIDTH * np.mean([part.mean() for part in kernel.split(row)]) for row in losses]
    np.testing.assert_allclose(kernel.costs(many), expected, rtol=1e-9)
    rooted = kernel.rooted(many)
    np.testing.assert_allclose((rooted**2).sum(axis=1) / (2.0 * ROBUST_WIDTH), expected, rtol=1e-9)
    np.testing.assert_array_equal(np.sign(rooted), np.sign(kernel.readings(many) - measured))


def test_offsets_and_starts_move_each_run(runs, kernel):
    """A zero offset of a run is one of its candidate; a start is one of its run."""
    rng = np.random.default_rng(2)
    many, offsets = candidates(5), rng.normal(0.0, 0.05, (5, 7))
    starts = rng.normal(0.0, 0.1, (5, 7, 2))
    found = kernel.readings(many, offsets, starts)
    for j in range(5):
        for i, one in enumerate(runs):
            moved = replace(one, q0=one.q0 + starts[j, i, 0], dq0=one.dq0 + starts[j, i, 1])
            shifted = many[j : j + 1].copy()
            shifted[0, COLUMN["offset"]] += offsets[j, i]
            others = [moved if k == i else other for k, other in enumerate(runs)]
            again = kernel.__class__(others, kernel.options, 1.0, 15.0, kernel._pool, 1).readings(shifted)[0]
            np.testing.assert_allclose(kernel.split(found[j])[i], kernel.split(again)[i], atol=1e-13)


@pytest.mark.parametrize("wrong", [{"damping": -30.0}, {"kp": 1e9, "forcerange": 1e9}, {"damping": np.nan},
                                   {"armature": -0.0021}, {"frictionloss": np.inf}])  # fmt: skip
@pytest.mark.parametrize("kind", [{}, {**M6, **EFFECTS}])
def test_divergence_is_no_number_and_costs_a_finite_one(kernel, wrong, kind):
    many = np.array([replace(VALUES, **kind).array(), replace(VALUES, **kind, **wrong).array()])
    readings = kernel.readings(many)
    assert np.isfinite(readings[0]).all()
    np.testing.assert_array_equal(readings[0], kernel.readings(many[:1])[0])
    assert (np.isnan(readings[1]) | (np.abs(readings[1]) < 1e3)).all()
    costs, rooted = kernel.costs(many), kernel.rooted(many)
    assert np.isfinite(costs).all()
    assert np.isfinite(rooted).all()
    if np.isnan(readings[1]).mean() > 0.9:
        assert costs[1] == pytest.approx(DIVERGED, rel=0.15)
    assert costs[1] <= DIVERGED


def test_no_candidates_give_no_readings(kernel):
    none = np.empty((0, len(COLUMN)))
    assert kernel.readings(none).shape == (0, kernel.size)
    assert kernel.costs(none).shape == (0,)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda model: setattr(model.opt, "integrator", mujoco.mjtIntegrator.mjINT_IMPLICIT), "integrator"),
        (lambda model: setattr(model.opt, "noslip_iterations", 0), "noslip_iterations"),
        (lambda model: setattr(model.opt, "disableflags", 2), "disable flags 2"),
        (lambda model: model.dof_solref.__setitem__(0, (-100.0, -10.0)), "direct format"),
    ],
)
def test_a_model_with_other_equations_is_refused(robot_model_dir, change, said):
    model = load_model(robot_model_dir / "bench_pendulum.xml")
    assert kernel_options(model).timestep == STEP
    change(model)
    with pytest.raises(ModelError, match=said):
        kernel_options(model)

"""Leaving logs out, drawing them again, and holding numbers away from the fit."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.bootstrap import full_bootstrap
from frasa_sysid.evidence import evidence
from frasa_sysid.finish import finish
from frasa_sysid.readers import read_log
from frasa_sysid.resampling import leave_one_out, one_step_bootstrap, profile_likelihoods, worst_pairs
from frasa_sysid.restarts import solve
from frasa_sysid.spread import Spread

STEP = 1e-4  # of the unit cube


def derivatives(kernel, problem, x):
    """Residuals and Jacobian of each run by central differences, without anything of the package's own evidence."""
    points = np.concatenate([x + STEP * np.eye(x.size), x - STEP * np.eye(x.size)])
    rows = kernel.readings(problem.candidates(points))
    whole = (rows[: x.size] - rows[x.size :]).T / (2.0 * STEP)
    residual = kernel.readings(problem.candidates(x[None]))[0] - np.concatenate([run.y for run in kernel.runs])
    ends = np.cumsum([run.t.size for run in kernel.runs])[:-1]
    return np.split(residual, ends), np.split(whole, ends)


@pytest.fixture(scope="module")
def linear(kit, robot_model_dir):
    """Six runs of a servo that is a little another one in each, and two free numbers: near linear."""
    runs = kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[1:36:6])
    problem = kit.problem(runs)
    problem = replace(problem, free=tuple(one for one in problem.free if one.field in ("damping", "offset")))
    x = problem.to_unit(problem.nominal_values())
    own = x + np.random.default_rng(2).normal(0.0, 0.001, (len(runs), x.size))
    kernel = kit.session.kernel(runs)
    disturbed = tuple(
        replace(run, y=kernel.split(row)[i])
        for i, (run, row) in enumerate(zip(runs, kernel.readings(problem.candidates(own)), strict=True))
    )
    problem = replace(problem, train=disturbed)
    kernel = kit.session.kernel(disturbed)
    x = finish(problem, kernel, x, step=STEP).x
    residual, jacobians = derivatives(kernel, problem, x)
    curvatures = [J.T @ J / len(J) for J in jacobians]
    gradients = [J.T @ r / len(J) for J, r in zip(jacobians, residual, strict=True)]
    return problem, x, curvatures, gradients


def test_leaving_a_log_out_is_what_fitting_without_it_does(kit, linear):
    problem, x, curvatures, gradients = linear
    steps = leave_one_out(np.sum(curvatures, axis=0), np.zeros((2, 2)), curvatures, gradients)
    refits = []
    for i in range(len(problem.train)):
        kept = problem.train[:i] + problem.train[i + 1 :]
        refits.append(finish(replace(problem, train=kept), kit.session.kernel(kept), x, step=STEP).x - x)
    largest = np.abs(refits).max(axis=0)
    assert (largest > 5e-5).all()
    assert (np.abs(steps - refits) < 0.1 * largest).all()


def test_leaving_out_says_nothing_where_the_logs_are_silent():
    """Of a number that no log speaks of; and where one log alone speaks, the fit's own curvature is taken."""
    curvatures = [np.diag([2.0, 0.0, 3.0]), np.diag([1.0, 0.0, 0.0])]
    gradients = [np.array([0.4, 0.0, 0.6]), np.array([-0.4, 0.0, 0.0])]
    silent = np.diag([0.0, 1.0, 0.0])
    steps = leave_one_out(np.sum(curvatures, axis=0), silent, curvatures, gradients)
    np.testing.assert_allclose(steps[1], [-0.4 / 2.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(steps[0], [0.4 / 3.0, 0.0, 0.6 / 3.0], atol=1e-12)


def test_drawing_logs_is_what_fitting_the_draws_does(kit, linear):
    """One step of Gauss and Newton for each draw against full fits: the same spread."""
    problem, x, curvatures, gradients = linear
    inverse = np.linalg.inv(np.sum(curvatures, axis=0))
    draws = one_step_bootstrap(x, curvatures, gradients, inverse, np.zeros((2, 2)), seed=5)
    assert np.array_equal(draws, one_step_bootstrap(x, curvatures, gradients, inverse, np.zeros((2, 2)), seed=5))
    assert ((draws >= 0.0) & (draws <= 1.0)).all()
    quick = problem.from_unit(np.quantile(draws, 0.975, axis=0)) - problem.from_unit(np.quantile(draws, 0.025, axis=0))
    full = full_bootstrap(problem, kit.session, problem.from_unit(x), 60, Spread())
    assert quick == pytest.approx(full[:, 1] - full[:, 0], rel=0.3)
    assert (full[:, 0] < problem.from_unit(x)).all()
    assert (full[:, 1] > problem.from_unit(x)).all()


@pytest.fixture(scope="module")
def fitted(kit, robot_model_dir):
    """M1 on half the runs of an M4 servo: model error makes the logs disagree."""
    runs = kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[:36:2])
    problem = kit.problem(runs)
    solved = solve(problem, kit.session, budget=150)
    kernel = kit.session.kernel(runs)
    return problem, kernel, solved, evidence(problem, kernel, problem.from_unit(solved.x))


def test_bootstrap_and_jackknife_agree(fitted):
    """Two looks at one spread: neither is a multiple of the other, where the logs say anything at all."""
    problem, _, _, weighed = fitted
    compared = 0
    for one, (low, high) in zip(weighed.estimates, weighed.bootstrap, strict=True):
        assert low <= one.value <= high
        if one.high - one.low < 0.5 * abs(one.value):
            compared += 1
            assert 0.25 < (high - low) / (one.high - one.low) < 2.5, one
    assert compared >= 4
    assert len(weighed.bootstrap) == len(problem.free)


def test_a_profile_rises_on_both_sides(kit, fitted):
    """Held away from the fit on either side, and all others following, the cost is higher, and more so further out."""
    problem, kernel, solved, weighed = fitted
    names = [one.field for one in problem.free]
    pair = (names.index("damping"), names.index("kp"))
    _, jacobians = derivatives(kernel, problem, solved.x)
    A = np.sum([J.T @ J / len(J) for J in jacobians], axis=0)
    bounds = np.array([one.high - one.low for one in problem.free])
    half = np.array([(one.high - one.low) / 2.0 for one in weighed.estimates]) / bounds
    found = profile_likelihoods(problem, kernel, solved.x, A, half, [pair])
    assert [one.name for one in found] == [problem.free[i].name for i in sorted(pair)]
    for one in found:
        middle = one.values.index(pytest.approx(problem.from_unit(solved.x)[names.index(one.name.partition(".")[2])]))
        assert 0 < middle < len(one.values) - 1
        assert one.values == tuple(sorted(one.values))
        assert one.rise[middle] == 0.0
        falling, rising = one.rise[: middle + 1], one.rise[middle:]
        assert falling == tuple(sorted(falling, reverse=True))
        assert rising == tuple(sorted(rising))
        assert min(falling[0], rising[-1]) > 0.0
        assert one.low is None or one.values[0] <= one.low < one.values[middle]
        assert one.high is None or one.values[middle] < one.high <= one.values[-1]


def test_only_strong_pairs_are_profiled():
    correlation = np.eye(4)
    for i, j, value in ((1, 0, -0.99), (2, 0, 0.95), (3, 0, 0.8), (2, 1, 0.91), (3, 1, 0.5), (3, 2, 0.99)):
        correlation[i, j] = correlation[j, i] = value
    assert worst_pairs(correlation, np.full(4, 0.1)) == [(3, 2), (1, 0), (2, 0)]
    # A number whose interval is the whole box is not worth it.
    assert worst_pairs(correlation, np.array([0.1, 0.1, 0.1, 1.0])) == [(1, 0), (2, 0), (2, 1)]
    assert worst_pairs(np.eye(3), np.full(3, 0.1)) == []

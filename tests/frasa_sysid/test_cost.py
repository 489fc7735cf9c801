import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from frasa_sysid.cost import (
    DIVERGED,
    ROBUST_WIDTH,
    misfit,
    residuals,
    robust_costs,
    robust_weights,
    rooted_residuals,
)


def run(name, y):
    return SimpleNamespace(name=name, y=np.asarray(y, dtype=float))


def laid_out(parts):
    """Readings of one candidate whose residuals are given run by run, what was measured, and where each run starts."""
    y = np.concatenate([np.linspace(-1.0, 1.0, len(part)) for part in parts])
    return np.concatenate(parts)[None] + y, y, np.cumsum([0, *(len(part) for part in parts)])


def robust_cost(parts):
    readings, y, starts = laid_out(parts)
    costs = np.empty(1)
    robust_costs(np.arange(1), readings, y, starts, costs)
    return float(costs[0])


def test_costs_of_some_of_many():
    """A thread computes the candidates it is given, each from its own row, and no other."""
    rng = np.random.default_rng(0)
    y, starts = rng.normal(size=50), np.array([0, 20, 50])
    readings = y + rng.normal(0.0, 0.01, (5, 50))
    costs = np.full(5, -1.0)
    robust_costs(np.array([3, 1]), readings, y, starts, costs)
    for i in (1, 3):
        assert costs[i] == pytest.approx(robust_cost(np.split(readings[i] - y, [20])), rel=1e-12)
    assert (costs[[0, 2, 4]] == -1.0).all()


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf, -np.inf, 1e300])
def test_rooted_residuals_sum_to_the_cost(bad):
    """Least squares minimises the same cost: signed roots, finite, whose squares sum to it times twice the width."""
    parts = [np.array([0.3, -0.02, bad, 1e-5]), np.array([-0.004, 0.0])]
    readings, y, starts = laid_out(parts)
    rooted_residuals(np.arange(1), readings, y, starts)
    assert np.isfinite(readings).all()
    assert np.sum(readings**2) == pytest.approx(2 * ROBUST_WIDTH * robust_cost(parts), rel=1e-12)
    np.testing.assert_array_equal(np.sign(readings[0, [0, 1, 3, 4]]), [1, -1, 1, -1])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_cost_is_always_finite(bad):
    """Whatever a simulation did, its cost is a finite number, larger than that of any that ran."""
    sound = robust_cost([np.full(10, 3.0), np.zeros(5)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        broken = robust_cost([np.full(10, bad), np.zeros(5)])
    assert np.isfinite(broken)
    assert broken > sound


def test_cost_is_quadratic_near_zero_and_linear_far_away():
    """Below the width a residual counts squared, far beyond it by its size."""
    small = 0.01 * ROBUST_WIDTH
    assert robust_cost([np.array([small])]) == pytest.approx(small**2 / (2 * ROBUST_WIDTH), rel=1e-3)
    assert robust_cost([np.array([1.0])]) == pytest.approx(1.0 - ROBUST_WIDTH, rel=1e-4)
    assert robust_cost([np.zeros(4)]) == 0.0


def test_weights_are_the_slope_of_the_cost():
    """The weight times the residual is the derivative of the loss times its width."""
    r = np.linspace(-0.05, 0.05, 31)
    eps = 1e-7
    slope = np.array([robust_cost([np.array([x + eps])]) - robust_cost([np.array([x - eps])]) for x in r]) / (2 * eps)
    np.testing.assert_allclose(robust_weights(r) * r / ROBUST_WIDTH, slope, atol=1e-6)


def test_every_run_has_equal_weight():
    """A long run counts as much as a short one, in the cost and in the misfit."""
    short, long = np.full(3, 0.1), np.full(3000, 0.3)
    alone = [robust_cost([part]) for part in (short, long)]
    assert robust_cost([short, long]) == pytest.approx(np.mean(alone))
    found = misfit([run("a", np.zeros(3)), run("b", np.zeros(3000))], [short, -long])
    assert found.mae_rad == pytest.approx(0.2)
    assert found.rmse_rad == pytest.approx(np.sqrt((0.01 + 0.09) / 2))
    assert found.by_run == {"a": pytest.approx(0.1), "b": pytest.approx(0.3)}


def test_misfit_of_nothing_and_of_a_diverged_run():
    """No runs have no misfit; a diverged sample counts as stated."""
    assert np.isnan(misfit([], []).mae_rad)
    assert misfit([run("a", np.zeros(2))], [np.array([np.nan, 0.0])]).mae_rad == pytest.approx(DIVERGED / 2)
    np.testing.assert_array_equal(residuals([run("a", [1.0])], [np.array([3.0])])[0], [2.0])

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from frasa_sysid.cost import DIVERGED, ROBUST_WIDTH, misfit, residuals, robust_cost, robust_weights


def run(name, y):
    return SimpleNamespace(name=name, y=np.asarray(y, dtype=float))


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

"""Several starts and the ladder of friction laws: nothing that is richer may end worse."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.fit import ladder, with_law
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.restarts import Restart, Solved, point_of, solve, subset
from frasa_sysid.search import Stop

BELOW = {"m2": ("m1",), "m3": ("m1",), "m4": ("m2", "m3"), "m5": ("m4",), "m6": ("m5",)}


def first(recording, seconds):
    position = recording.signals["position"]
    kept = position.t < seconds
    short = Signal("position", "rad", position.t[kept], position.y[kept])
    return replace(recording, signals={**recording.signals, "position": short})


@pytest.fixture(scope="module")
def runs(kit, robot_model_dir):
    """Eight short runs of an M4 servo, simulated by other code than the kernel's."""
    recordings = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    return kit.runs([first(one, 3.0) for one in [*recordings[0:4], *recordings[28:32]]])


@pytest.fixture(scope="module")
def climbed(kit, runs):
    return ladder(kit.problem(runs), kit.session, LAWS, 40, None, lambda *told: None)


def test_a_richer_law_never_fits_worse(climbed):
    for law, simpler in BELOW.items():
        for below in simpler:
            assert climbed[law][1].cost <= climbed[below][1].cost
    # And where the logs have it in them, far better.
    assert climbed["m4"][1].cost < 0.3 * climbed["m1"][1].cost


def test_costs_are_of_the_points_they_stand_with(kit, runs, climbed):
    """The best start comes first, and its cost is what the kernel says of it on all runs."""
    kernel = kit.session.kernel(runs)
    for problem, solved in climbed.values():
        costs = [float(kernel.costs(problem.candidates(one.x[None]))[0]) for one in solved.restarts]
        assert [one.cost for one in solved.restarts] == pytest.approx(costs, rel=1e-9)
        assert (solved.x is solved.restarts[0].x, solved.cost) == (True, min(one.cost for one in solved.restarts))
        assert ((solved.x >= 0.0) & (solved.x <= 1.0)).all()


@pytest.mark.parametrize(("below", "law"), [(one, law) for law, simpler in BELOW.items() for one in simpler])
def test_a_simpler_solution_is_a_point_of_the_richer_cube(kit, runs, below, law):
    """At any point, effects and zeros of single rigs included, the readings are the very same."""
    effects = ("offsets", "punch", "profile")
    simple, rich = (with_law(kit.problem(runs), one, effects) for one in (below, law))
    rng = np.random.default_rng(3)
    kernel = kit.session.kernel(runs)
    for x in rng.uniform(0.1, 0.9, (5, len(simple.free))):
        point = point_of(rich, simple, x)
        a, b = (
            kernel.readings(one.candidates(at[None]), one.offsets(at[None], runs))
            for one, at in ((simple, x), (rich, point))
        )
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-8)
        assert np.abs(a - kernel.readings(simple.candidates(x[None]))).max() > 1e-4  # the zeros of rigs count here


@pytest.mark.parametrize("effect", ["punch", "backlash", "collapse", "loop", "offsets", "bias"])
def test_a_solution_without_an_effect_is_one_with_it(kit, runs, effect):
    simple, rich = kit.problem(runs, law="m4"), kit.problem(runs, law="m4", effects=(effect,))
    kernel = kit.session.kernel(runs)
    x = np.random.default_rng(4).uniform(0.1, 0.9, len(simple.free))
    point = point_of(rich, simple, x)
    a = kernel.readings(simple.candidates(x[None]))
    b = kernel.readings(rich.candidates(point[None]), rich.offsets(point[None], runs))
    np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-8)


def test_never_worse_than_what_was_known(kit, runs, climbed):
    """A search that is too short to find anything keeps the solution it was given."""
    problem, best = climbed["m4"]
    again = solve(problem, kit.session, budget=1, nested=[best.x])
    assert again.cost <= best.cost
    assert {one.start for one in again.restarts} == {"seed 0", "nested"}
    alone = solve(problem, kit.session, budget=1, optimizer="cmaes")
    assert alone.cost > best.cost


def solved_with(*costs, nested=()):
    point = np.zeros(1)
    starts = [Restart(f"seed {i}", point, cost) for i, cost in enumerate(costs)]
    starts = sorted([*starts, *(Restart("nested", point, cost) for cost in nested)], key=lambda one: one.cost)
    return Solved(point, starts[0].cost, tuple(starts), 1, Stop.FINISHED, ())


@pytest.mark.parametrize(
    ("seeds", "nested", "several"),
    [((1.0,), (), False), ((1.0, 1.009), (), False), ((1.009, 1.0, 1.02), (), True), ((1.0,), (0.5,), False),
     ((1.0, 1.0), (0.9,), True), ((1.0, 1.0), (1.5,), False), ((1.2e-4, 1.3e-4), (), False)],
)  # fmt: skip
def test_several_answers(seeds, nested, several):
    """Searches that end more than 1 % apart, or above what was known, did not find the same; rounding aside."""
    assert solved_with(*seeds, nested=nested).multimodal == several


def test_fitted_starts_are_no_second_answer():
    """Multiple shooting lowers the cost by what the starts take up; the searches before it agreed all the same."""
    assert not replace(solved_with(1.0, 1.001), cost=0.2).multimodal


def test_searches_agree_where_there_is_one_answer(kit, recordings):
    """M1 logs and a rich set of motions: three searches of their own, one result."""
    problem = kit.problem(kit.runs(recordings))
    found = solve(problem, kit.session, budget=200, restarts=3)
    assert [one.start for one in sorted(found.restarts, key=lambda one: one.start)] == ["seed 0", "seed 1", "seed 2"]
    assert not found.multimodal
    assert np.ptp([one.x for one in found.restarts], axis=0).max() < 0.02


def test_a_subset_is_spread_over_everything(runs):
    some = subset(runs, 4)
    assert len(some) == 4
    assert len({run.trajectory for run in some}) == 4
    assert len({run.rig for run in some}) == 2
    assert subset(runs, 20) == sorted(
        runs, key=lambda run: (run.trajectory, run.gravity_torque, run.kp_scale, run.name)
    )

"""M1 in place of a richer law: what it costs, and that it costs nothing where there is nothing to replace."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from frasa_sysid.fit import fit, ladder
from frasa_sysid.readers import read_log
from frasa_sysid.servo_values import NO_LIMIT, ServoValues
from frasa_sysid.stand_in import stand_in, without_effects


@pytest.fixture(scope="module")
def runs(kit, robot_model_dir):
    return kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[::6])


@pytest.fixture(scope="module")
def rich(kit, runs):
    """M4 on logs of an M4 servo, and the M1 fit below it."""
    climbed = ladder(kit.problem(runs), kit.session, ("m1", "m2", "m3", "m4"), 60, None, lambda *told: None)
    results = {}
    for law in ("m1", "m4"):
        problem, solved = climbed[law]
        results[law] = fit(problem, kit.session, {}, evaluations=30, restarts=1, known=(solved.x,))
    return results


def test_m1_in_place_of_m4(kit, runs, rich):
    """It costs something, yet no more than M1 fitted to the logs themselves; and it holds where the logs are."""
    assert rich["m4"].fitted.mae_rad < 0.3 * rich["m1"].fitted.mae_rad
    one = stand_in(rich["m4"], kit.session)
    own = rich["m1"].fitted.mae_rad
    assert 0.3 * own < one.penalty.mae_rad < own + rich["m4"].fitted.mae_rad
    assert set(one.penalty.by_run) == {run.name for run in runs}
    assert one.loads == (min(run.gravity_torque for run in runs), max(run.gravity_torque for run in runs))
    assert 5.0 < one.speed < 30.0
    assert without_effects(one.values) == one.values
    assert one.values.friction() == replace(
        one.values.friction(), stribeck=0.0, load_motor=0.0, load_external=0.0, load_motor_stribeck=0.0
    )
    # All its friction is in one number, so that number is larger than the law's Coulomb part.
    assert one.values.frictionloss > rich["m4"].problem.servo_values(rich["m4"].values).frictionloss
    # And what M1 found in the logs is about what it finds in the law that was fitted to them.
    ours, theirs = one.values, rich["m1"].problem.servo_values(rich["m1"].values)
    for field in ("kp", "damping", "armature"):
        assert getattr(ours, field) == pytest.approx(getattr(theirs, field), rel=0.1), field


def test_m1_in_its_own_place(kit, runs):
    """Made of the fit itself, so there is nothing to pay and every number comes back."""
    problem = kit.problem(runs)
    x = np.full(len(problem.free), 0.35)
    result = fit(problem, kit.session, {}, evaluations=10, restarts=1, known=(x,))
    one = stand_in(result, kit.session)
    assert one.penalty.mae_rad < 2e-5
    truth = asdict(problem.servo_values(result.values))
    for field, value in asdict(one.values).items():
        assert value == pytest.approx(truth[field], rel=0.01, abs=2e-4), field


def test_effects_stay_while_the_law_goes(kit, runs):
    """A bias is no friction: M1 is fitted beside the effects of the fit, and then stands alone."""
    problem = kit.problem(runs[:4], law="m2", effects=("bias", "profile"))
    x = problem.to_unit(problem.start_values())
    x[[one.field for one in problem.free].index("bias")] = 0.56
    result = fit(problem, kit.session, {}, evaluations=10, restarts=1, known=(x,))
    one = stand_in(replace(result, values=problem.from_unit(x)), kit.session)
    # With the bias left out of the imitation, an arm at rest would hang some 50 mrad beside.
    assert one.penalty.mae_rad < 3e-3
    assert (one.values.bias, one.values.goal_speed) == (0.0, NO_LIMIT)


def test_without_effects_switches_everything_off(kit, runs):
    on = ServoValues(
        **kit.nominal, sag=0.2, rest=1.0, follow=1.0, goal_speed=2.0, punch=0.01, dead_zone=0.01, collapse_at=0.1,
        collapse_to=0.5, loop_lag=0.002, bias=0.1,
    )  # fmt: skip
    kernel = kit.session.kernel(runs)
    plain, off, some = kernel.readings(
        np.array([one.array() for one in (ServoValues(**kit.nominal), without_effects(on), on)])
    )
    np.testing.assert_array_equal(off, plain)
    assert np.abs(some - plain).max() > 0.1

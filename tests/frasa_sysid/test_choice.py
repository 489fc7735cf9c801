"""The choice of law and effects: what is held out stays out, what is in the logs is found, and nothing else."""

import math
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.choice import WORTH, Fold, choose, folds_of, held_out_error
from frasa_sysid.finish import finish
from frasa_sysid.readers import read_log
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.spread import Spread

COUNT = 2.0 * np.pi / 4096


@pytest.fixture(scope="module")
def whole(kit, robot_model_dir):
    """All 36 runs of the project's bench log."""
    return kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap"))


def made(kit, runs, values, seed=0):
    """Runs of a known servo: the kernel's readings with an encoder's steps and a little noise, half of each run."""
    kernel = kit.session.kernel(runs)
    rng = np.random.default_rng(seed)
    cut = []
    for run, y in zip(runs, kernel.split(kernel.readings(values.array()[None])[0]), strict=True):
        seen = np.round((y + rng.normal(0.0, 3e-4, y.size)) / COUNT) * COUNT
        kept = run.t < 3.5
        steps = int(run.step[kept][-1]) + 2
        cut.append(
            replace(run, t=run.t[kept], y=seen[kept], step=run.step[kept], weight=run.weight[kept],
                    command=run.command[:steps], supply=np.ones(steps), q0=float(y[0]), dq0=0.0, rest=1.0)
        )  # fmt: skip
    return cut


def servo_of(kit, **change):
    """An M1 servo beside the nominal one."""
    plain = {**kit.nominal, "damping": 1.4, "damping_off": 0.1, "armature": 0.03, "delay": 0.006, "offset": 0.01}
    return ServoValues(**{**plain, **change})


def chosen(kit, runs, laws, effects):
    return choose(kit.problem(runs), kit.session, laws, effects, Spread(), lambda *told: None)


def test_folds_hold_out_what_they_say(whole):
    """By rig, gain and trajectory, each run once a kind, and no label that another fold of the kind has too."""
    folds = folds_of(whole)
    assert [fold.kind for fold in folds] == ["rig"] * 3 + ["gain"] * 3 + ["trajectory"] * 4
    of_run = {
        "rig": lambda run: run.rig,
        "gain": lambda run: f"P{run.kp_scale / run.force_scale:.4g}",
        "trajectory": lambda run: run.trajectory,
    }
    for fold in folds:
        assert {of_run[fold.kind](whole[i]) for i in fold.held} == {fold.label}
    for kind in of_run:
        assert sorted(i for fold in folds if fold.kind == kind for i in fold.held) == list(range(36))


def test_many_groups_become_four_folds(whole):
    runs = [replace(run, rig=f"rig {i % 7}") for i, run in enumerate(whole)]
    folds = [fold for fold in folds_of(runs) if fold.kind == "rig"]
    assert len(folds) == 4
    for fold in folds:
        assert {runs[i].rig for i in fold.held} == set(fold.label.split(", "))
    assert sorted(i for fold in folds for i in fold.held) == list(range(36))


def test_repetitions_are_held_out_where_there_is_nothing_else(whole):
    runs = [replace(whole[0], name=f"take {i}") for i in range(3)]
    assert folds_of(runs) == [Fold("run", f"take {i}", (i,)) for i in range(3)]
    assert folds_of(runs[:1]) == []


def test_what_is_held_out_is_not_seen(kit, whole):
    """However far away the held-out angles are put, the fit stays: only the error moves, by just as much."""
    runs = made(kit, whole[0:4], servo_of(kit))
    problem = kit.problem(runs)
    fold = Fold("run", "", (1, 3))
    # As `choose` has it, from the solution on all runs: from afar the few iterations of a fold do not arrive.
    x = finish(problem, kit.session.kernel(runs), problem.to_unit(problem.nominal_values())).x
    far = [
        replace(
            problem, train=tuple(replace(run, y=run.y + away) if i in fold.held else run for i, run in enumerate(runs))
        )
        for away in (10.0, 30.0)
    ]
    errors = [held_out_error(one, x, fold, kit.session) for one in far]
    assert errors[1] - errors[0] == pytest.approx(20.0, abs=1e-9)
    # The runs that are kept do count.
    bent = replace(
        problem, train=tuple(run if i in fold.held else replace(run, y=0.8 * run.y) for i, run in enumerate(runs))
    )
    ours, theirs = (held_out_error(one, x, fold, kit.session) for one in (problem, bent))
    assert ours < 0.003 < theirs


def sane(choice, laws):
    """What holds for every table."""
    assert [one.law for one in choice.laws] == list(laws)
    assert math.isnan(choice.laws[0].p_value)
    assert choice.laws[0].against == ""
    for one in choice.laws:
        assert len(one.by_fold) == len(choice.folds)
        assert one.held_out == pytest.approx(np.exp(np.mean(np.log(one.by_fold))))
    for one in choice.laws[1:]:
        assert 0.0 <= one.p_value <= 1.0
        assert one.against
    assert choice.reason.startswith(choice.problem.law)
    assert len(choice.x) == len(choice.problem.free)


def test_a_load_dependent_law_is_found(kit, whole):
    friction = PUBLISHED_M4["mx106"].friction
    names = ("stribeck", "load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck",
             "stribeck_speed", "stribeck_exponent")  # fmt: skip
    truth = servo_of(kit, frictionloss=1e-6, damping_off=friction.viscous, **{n: getattr(friction, n) for n in names})
    runs = made(kit, [*whole[0:4], *whole[28:32]], truth)
    choice = chosen(kit, runs, ("m1", "m4"), ())
    sane(choice, ("m1", "m4"))
    assert choice.problem.law == "m4"
    assert choice.laws[1].p_value < 0.05
    assert choice.laws[1].against == "m1"
    assert choice.laws[1].held_out < 0.5 * choice.laws[0].held_out
    found = choice.problem.servo_values(choice.problem.from_unit(choice.x))
    assert found.load_motor + found.load_motor_stribeck == pytest.approx(0.2315, abs=0.03)


def test_m1_stays_where_nothing_speaks_for_more(kit, whole):
    runs = made(kit, [*whole[0:4], *whole[28:32]], servo_of(kit))
    choice = chosen(kit, runs, ("m1", "m2", "m3"), ())
    sane(choice, ("m1", "m2", "m3"))
    assert choice.problem.law == "m1"
    for one in choice.laws[1:]:
        assert one.against == "m1"
        assert one.train <= 1.02 * choice.laws[0].train  # it can do what M1 does, and was not taken all the same
        assert one.p_value >= 0.05 or one.held_out >= (1.0 - WORTH) * choice.laws[0].held_out


def test_the_effect_that_is_there_is_found_and_no_other(kit, whole):
    """A firmware that lets its goal move at 2 rad/s at most."""
    runs = made(kit, [whole[i] for i in (1, 2, 9, 10, 14, 21)], servo_of(kit, goal_speed=2.0))
    choice = chosen(kit, runs, ("m1",), None)
    assert choice.problem.effects == ("profile",)
    values = choice.problem.servo_values(choice.problem.from_unit(choice.x))
    assert values.goal_speed == pytest.approx(2.0, rel=0.02)
    assert values.damping == pytest.approx(1.4, rel=0.03)
    first, *others = choice.effects
    assert (first.effects, first.against) == ((), "")
    taken = [one for one in others if one.effects == ("profile",)]
    assert len(taken) == 1
    assert taken[0].p_value < 0.05
    assert taken[0].against == "m1"
    assert all(0.0 <= one.p_value <= 1.0 for one in others)


def test_one_run_gives_nothing_to_choose_by(kit, whole):
    choice = chosen(kit, made(kit, whole[:1], servo_of(kit)), ("m1", "m2"), ())
    assert choice.problem.law == "m1"
    assert choice.folds == ()
    assert "one run only" in choice.reason

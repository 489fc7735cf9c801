"""The table of laws' and effects' numbers: bounds, starts, and what "off" means in the kernel."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration.friction import COEFFICIENTS, LAWS
from frasa_sysid.effects import AUTOMATIC, EFFECTS, FIELDS_OF_EFFECTS, law_numbers
from frasa_sysid.errors import UsageError
from frasa_sysid.evidence import RECORD
from frasa_sysid.problem import possible
from frasa_sysid.readers import read_log
from frasa_sysid.servo_values import FIELDS, ServoValues

NUMBERS = [one for law in LAWS for one in law_numbers(law)[0]] + [n for one in EFFECTS.values() for n in one.numbers]

SIGNED = ("bias", "drag")  # those that may have either sign begin at nothing


@pytest.fixture(scope="module")
def runs(kit, robot_model_dir):
    """Two rigs, three gains and all trajectories, on a supply that moves; none began unloaded."""
    found = kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[0:24:5])
    assert len({run.rig for run in found}) == 2
    return [
        replace(run, rest=1.0, supply=1.0 + 0.1 * np.sin(0.01 * np.arange(run.steps)), switches=np.zeros(0))
        for run in found
    ]


def readings(kit, runs, problem, values):
    x = problem.to_unit(values)[None]
    return kit.session.kernel(runs).readings(problem.candidates(x), problem.offsets(x, runs))[0]


def without(kit, runs, **change):
    """Readings of the nominal M1 servo; the shortest delay of the search, for its own is none at all."""
    nominal = {**kit.nominal, "delay": kit.session.delay_range[0], **change}
    return kit.session.kernel(runs).readings(ServoValues(**nominal).array()[None])[0]


def test_bounds_hold_their_starts():
    """For a small and a large servo, at slow and fast goals; every number has a unit and a log to record."""
    for one in NUMBERS:
        assert one.field in FIELDS
        assert one.field in RECORD
        assert one.unit
        assert one.owner in ("servo", "bench")
        for force in (0.3, 9.0):
            for speed in (1.0, 12.0):
                low, high, start = one.bounds(force, speed)
                assert low < high
                assert low <= start <= high
                assert (start != 0.0) == (one.field not in SIGNED)
                assert (low < 0.0) == (one.field in SIGNED)


def test_the_table_is_whole():
    assert set(AUTOMATIC) < set(EFFECTS)
    assert all(name == one.name and one.meaning for name, one in EFFECTS.items())
    fields = [number.field for one in EFFECTS.values() for number in one.numbers]
    assert len(fields) == len(set(fields)) == len(FIELDS_OF_EFFECTS)
    assert FIELDS_OF_EFFECTS["collapse_to"] == "collapse"
    for law in LAWS:
        numbers, ties = law_numbers(law)
        names = [*(one.field for one in numbers), *ties]
        assert sorted(names) == sorted(name.partition("=")[0] for name in COEFFICIENTS[law])
        assert set(ties.values()) <= {one.field for one in numbers}


@pytest.mark.parametrize("law", LAWS[1:])
def test_laws_begin_without_effect(kit, runs, law):
    """Nominal values of a richer law are M1 to the bit."""
    problem = kit.problem(runs, law=law)
    np.testing.assert_array_equal(readings(kit, runs, problem, problem.nominal_values()), without(kit, runs))
    assert len(problem.free) == 8 - 1 + len(law_numbers(law)[0])  # the torque is never off here


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_begin_without_effect_and_have_one(kit, runs, name):
    """Off, a servo moves as if there were no such effect; on, at the start of a search already, otherwise."""
    problem, plain = kit.problem(runs, effects=(name,)), without(kit, runs)
    off = problem.nominal_values()
    if name == "supply":  # no number: it is on as soon as it is named
        assert np.abs(readings(kit, runs, problem, off) - plain).max() > 1e-3
        still = [replace(run, supply=np.ones(run.steps)) for run in runs]
        np.testing.assert_array_equal(
            readings(kit, still, kit.problem(still, effects=(name,)), off),
            without(kit, still),
        )
        return
    free = problem.free
    on = np.array([one.start or (0.3 * one.high if one.rig or one.field in SIGNED else 0.0) for one in free])
    change = np.abs(readings(kit, runs, problem, on) - plain)
    assert change.max() > 2e-4
    apart = np.abs(readings(kit, runs, problem, off) - plain)
    # "No speed limit" is outside all bounds: at the highest one the jumps between two writes are ramps already.
    assert apart.max() < (0.25 * change.max() if name == "profile" else 1e-12)


def test_a_sag_states_the_gain_of_the_unloaded_supply(kit, runs):
    """Beside a sag that is zero, gain and limit are as much higher as the supply was before it gave way."""
    loaded = [replace(run, rest=1.04) for run in runs]
    problem = kit.problem(loaded, effects=("sag",))
    higher = {name: 1.04 * kit.nominal[name] for name in ("kp", "forcerange")}
    np.testing.assert_allclose(
        readings(kit, loaded, problem, problem.nominal_values()),
        without(kit, runs, **higher),
        rtol=0.0,
        atol=1e-9,
    )


def test_only_what_logs_can_show_is_tried(runs):
    assert possible(runs) == AUTOMATIC
    assert "offsets" not in possible(runs[:1])
    assert "supply" not in possible([replace(run, supply=np.ones(run.steps)) for run in runs])
    # Without a firmware: what the supply and the gears do.
    assert set(possible([replace(run, control="voltage") for run in runs])) <= {"sag", "drag"}
    assert possible([replace(run, control="force") for run in runs]) == ()


def test_unknown_names(kit, runs):
    with pytest.raises(UsageError, match="unknown effect 'wind': known are profile"):
        kit.problem(runs, effects=("wind",))
    with pytest.raises(UsageError, match="unknown friction law 'm7'"):
        kit.problem(runs, law="m7")

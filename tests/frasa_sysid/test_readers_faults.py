import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from frasa_sysid.errors import LogError
from frasa_sysid.readers.faults import FAILED_READS, check_radians, clean, failed_reads, unwrap
from frasa_sysid.readers.sampling import make_signal
from frasa_sysid.recording import RigFacts, Signal

T = np.arange(300) * 0.01


def signal(name, y, t=None, unit=None):
    units = {"position": "rad", "velocity": "rad/s", "goal": "rad", "supply_voltage": "V"}
    return Signal(name, unit or units.get(name, "raw"), T[: len(y)] if t is None else t, np.asarray(y, dtype=float))


def cleaned(*signals, rig=None):
    result, faults = clean({one.name: one for one in signals}, rig or RigFacts())
    return result, {fault.code: fault.count for fault in faults}


@pytest.mark.parametrize("value", FAILED_READS)
@pytest.mark.parametrize("at", [0, 150, 299])
def test_failed_read_is_dropped_with_its_velocity(value, at):
    """A lone -pi far from its neighbours is no position; its packet's velocity goes with it."""
    y = 0.5 * np.sin(T)
    y[at] = value
    result, codes = cleaned(signal("position", y), signal("velocity", np.cos(T)), signal("goal", y * 0))
    assert codes == {"failed_read": 1}
    assert T[at] not in result["position"].t
    assert T[at] not in result["velocity"].t
    assert result["goal"].t.size == 300


def test_averaged_read_before_a_missed_slot_is_dropped():
    """A sample that is the mean of the two before, at a missed slot, is no reading; elsewhere it may be."""
    y = 0.5 * np.sin(T)
    y[100] = (y[99] + y[98]) / 2
    assert cleaned(signal("position", y))[1] == {}
    late = T + 0.01 * (T > 1.0)
    result, codes = cleaned(signal("position", y, late), signal("velocity", np.cos(T), late))
    assert codes["averaged_read"] == 1
    assert late[100] not in result["position"].t
    assert late[100] not in result["velocity"].t


def test_an_arm_that_stands_upside_down_is_no_failed_read():
    """Resting at -pi, or passing through it, is a place an arm can be."""
    passing = np.linspace(-2.9, -3.4, 300)
    passing[150] = FAILED_READS[0]
    assert not failed_reads(passing).any()
    assert not failed_reads(np.full(300, FAILED_READS[1])).any()
    long = np.zeros(300)
    long[100:120] = FAILED_READS[0]
    assert not failed_reads(long).any()


@given(
    steps=hnp.arrays(np.float64, st.integers(2, 60), elements=st.floats(-0.9, 0.9)),
    start=st.floats(-3, 3),
    period=st.sampled_from([2 * np.pi, 4096.0]),
)
def test_unwrap_undoes_any_wrapping(steps, start, period):
    """Wrapping a continuous motion and unwrapping gives it back, up to whole turns."""
    true = (start + np.cumsum(steps)) * period / (2 * np.pi)
    wrapped = np.mod(true, period)
    back, count = unwrap(wrapped, period)
    np.testing.assert_allclose(back - back[0], true - true[0], atol=1e-9 * period)
    assert count == np.count_nonzero(np.abs(np.diff(wrapped)) > period / 2)


def test_wrapped_position_is_unwrapped_and_reported():
    """A position that wraps comes back continuous, each joint by itself."""
    true = np.stack([4 * np.sin(T), 0.1 * T], axis=1)
    wrapped = np.mod(true + np.pi, 2 * np.pi) - np.pi
    given_signal = Signal("position", "rad", T, wrapped, ("a", "b"))
    result, faults = clean({"position": given_signal}, RigFacts())
    np.testing.assert_allclose(result["position"].y, true, atol=1e-9)
    assert [fault.code for fault in faults] == ["encoder_wrap"]


def test_unsigned_load_is_made_signed():
    """A load stored as unsigned 16 bit is -1 where it says 65535; one that has no such value is let be."""
    y = np.round(100 * np.sin(6 * T))
    result, codes = cleaned(signal("load", np.mod(y, 65536)))
    np.testing.assert_array_equal(result["load"].y, y)
    assert codes == {"unsigned_load": int((y < 0).sum())}
    assert cleaned(signal("load", np.abs(y)))[1] == {}
    assert cleaned(signal("load", np.abs(y) * 655.5))[1] == {}


def test_declared_voltage_is_held_against_the_measured():
    """A declared supply that the measured one contradicts is reported; sag within a tenth is none."""
    measured = signal("supply_voltage", np.full(300, 12.0))
    assert cleaned(measured, rig=RigFacts(supply_voltage=15))[1] == {"voltage_contradicted": 1}
    assert cleaned(measured, rig=RigFacts(supply_voltage=12.5))[1] == {}
    assert cleaned(measured)[1] == {}


def test_mixed_rates_and_gaps_are_reported_once():
    """Two rates in one log, and gaps, are told with their numbers and not once a signal."""
    t = np.concatenate([np.arange(150) * 0.0053, 150 * 0.0053 + np.arange(150) * 0.0035])
    signals = {name: signal(name, np.sin(t), t) for name in ("position", "velocity", "goal")}
    _, faults = clean(signals, RigFacts())
    assert [fault.code for fault in faults] == ["mixed_rates"]
    assert "every 5.30 ms and every 3.50 ms" in faults[0].message
    t = np.delete(T, slice(100, 110))
    _, faults = clean({"position": signal("position", np.sin(t), t)}, RigFacts())
    assert [(fault.code, fault.count) for fault in faults] == [("gap", 1)]


def test_jitter_is_no_fault():
    """A jittering loop at one rate has nothing to report."""
    rng = np.random.default_rng(0)
    t = np.cumsum(0.01 + rng.exponential(0.0005, 300))
    assert cleaned(signal("position", np.sin(t), t))[1] == {}


def test_make_signal_orders_and_drops():
    """NaN is dropped, time sorted, repeats dropped; nothing left gives no signal."""
    t = np.array([0.0, 2.0, 1.0, 1.0, 3.0])
    made, faults = make_signal("load", "raw", t, np.array([0.0, 2.0, 1.0, 9.0, np.inf]))
    np.testing.assert_array_equal(made.t, [0, 1, 2])
    np.testing.assert_array_equal(made.y, [0, 1, 2])
    assert {fault.code for fault in faults} == {"not_finite", "time_order", "repeated_time"}
    made, faults = make_signal("load", "raw", t, np.full(5, np.nan))
    assert made is None
    assert faults[0].count == 5


def test_degrees_only_where_a_goal_commands_an_arm():
    """Goals two turns away are degrees; a wheel without goals, voltage benches and robots are not judged."""
    far = np.linspace(0, 90, 300)
    both = {"goal": signal("goal", far), "position": signal("position", far)}
    with pytest.raises(LogError, match="looks like degrees: it reaches 90"):
        check_radians(both, RigFacts(), "a.mcap", "mcap")
    check_radians(both, RigFacts(control="voltage"), "a.mcap", "mcap")
    check_radians({"position": both["position"]}, RigFacts(), "a.mcap", "mcap")
    check_radians({"goal": signal("goal", far / 10)}, RigFacts(), "a.mcap", "mcap")

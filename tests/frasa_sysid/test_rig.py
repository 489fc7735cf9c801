from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.errors import LogError
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.rig import GRAVITY, bench_run
from frasa_sysid.servo import servo

DT = 0.002
MX106 = servo("mx106")
RIG = RigFacts(servo="mx106", mass=0.5, length=0.15, firmware_gain=24, supply_voltage=12.0)
T = np.arange(100) * 0.01


def recording(rig=RIG, **signals):
    columns = {"position": ("rad", T, np.sin(T)), "goal": ("rad", T, np.sin(T))} | signals
    made = {key: Signal(key, *column) for key, column in columns.items() if column is not None}
    return Recording("r", made, rig, "real", "r.mcap", "0", "header")


def run(rig=RIG, **signals):
    return bench_run(recording(rig, **signals), MX106, DT)


def held(times, values, at):
    """Zero-order hold, the first value before the first command."""
    return values[np.maximum(np.searchsorted(times, at, side="right") - 1, 0)]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5), st.integers(1, 200))
def test_commands_are_means_of_the_hold(seed, start, count):
    """Each step's command is the mean of the held goal over that step, also before the first and after the last."""
    rng = np.random.default_rng(seed)
    times = start + np.cumsum(rng.uniform(1e-4, 0.02, count))
    values = rng.uniform(-1, 1, count)
    command = run(goal=("rad", times, values)).command
    fine = (np.arange(command.size * 1000) + 0.5) * DT / 1000
    expected = held(times, values, fine).reshape(-1, 1000).mean(axis=1)
    np.testing.assert_allclose(command, expected, atol=2 * 21 / 1000)
    assert np.abs(command).max() <= np.abs(values).max() + 1e-12


def test_a_later_goal_is_a_later_command():
    """Goals written d later give the same integral d later: exactly, whatever part of a step d is."""
    rng = np.random.default_rng(0)
    times, values = T[5:80] + rng.uniform(0, 0.005, 75), rng.uniform(-1, 1, 75)
    values[0] = 0.0
    total = np.cumsum(run(goal=("rad", times, values)).command) * DT
    for whole in (1, 7):
        later = np.cumsum(run(goal=("rad", times + whole * DT, values)).command) * DT
        np.testing.assert_allclose(later[whole:], total[:-whole], atol=1e-12)
    for d in (0.0003, 0.0011, 0.0137):
        # The held goal is constant after the last write, so there the integrals differ by d times that value.
        later = np.cumsum(run(goal=("rad", times + d, values)).command) * DT
        assert total[-1] - later[-1] == pytest.approx(d * values[-1], abs=1e-12)


def test_measured_times_lie_on_the_grid():
    """Each measured time is `step` cells and `weight` of one more, up to the end."""
    t = np.sort(np.random.default_rng(1).uniform(0.3, 1.7, 40))
    one = run(position=("rad", t, np.sin(t)))
    np.testing.assert_allclose((one.step + one.weight) * DT, t - t[0], atol=1e-12)
    assert one.weight.min() >= 0
    assert one.weight.max() <= 1 + 1e-9
    assert one.step.max() + 1 <= one.steps


def test_gain_and_force_scale_with_supply_and_firmware_gain():
    """Both scale with the supply while powered, only the gain with P; the measured supply has precedence."""
    one = run()
    assert one.kp_scale == pytest.approx(24 / MX106.firmware_gain * 12 / MX106.supply_voltage)
    assert one.force_scale == pytest.approx(12 / MX106.supply_voltage)
    volts = np.where(T < 0.5, 14.0, 16.0)
    enable = (T < 0.5).astype(float)
    one = run(supply_voltage=("V", T, volts), torque_enable=("1", T, enable))
    assert one.force_scale == pytest.approx(14 / MX106.supply_voltage)
    assert one.powered_first
    np.testing.assert_allclose(one.switches, [0.5])


def test_load_of_a_point_mass_on_a_rod():
    """Mass and length give inertia and gravity; declared ones replace them; gravity is the model's."""
    one = run(replace(RIG, arm_mass=0.06))
    assert one.inertia == pytest.approx((0.5 + 0.02) * 0.15**2)
    assert one.gravity_torque == pytest.approx((0.5 + 0.03) * 9.81 * 0.15)
    one = run(replace(RIG, inertia=0.5, gravity_torque=2.0))
    assert (one.inertia, one.gravity_torque) == (0.5, 2.0)
    assert run(replace(RIG, mass=0.0, length=0.0)).inertia > 0


def test_gravity_is_that_of_the_model(robot_model_dir):
    """The constant here and the gravity of the bench model are one number."""
    model = mujoco.MjModel.from_xml_path(str(robot_model_dir / "bench_pendulum.xml"))
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -GRAVITY])


def test_starting_speed():
    """A run that starts in motion starts with its speed; encoder noise on a still arm is not speed."""
    t = np.arange(400) * 0.002
    moving = run(position=("rad", t, 0.3 + 1.7 * t - 2 * t**2))
    assert moving.dq0 == pytest.approx(1.7, abs=1e-6)
    still = np.random.default_rng(0).integers(0, 2, 400) * 0.0015
    assert run(position=("rad", t, still)).dq0 == 0.0


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"goal": None}, "no 'goal' signal"),
        ({"position": None}, "no 'position' signal"),
        ({"rig": replace(RIG, firmware_gain=None)}, "--firmware-gain"),
        ({"rig": replace(RIG, firmware_gain=0.0)}, "--firmware-gain"),
        ({"rig": replace(RIG, supply_voltage=None)}, "--supply-voltage"),
        ({"rig": replace(RIG, mass=None)}, "--mass"),
        ({"supply_voltage": ("V", T, np.zeros(100))}, "no servo runs on that"),
        ({"position": ("rad", T[:2], T[:2])}, "at least 3"),
        ({"position": ("rad", T, 3000 * np.sin(T))}, "--unit deg"),
        ({"position": ("rad", T, np.zeros((100, 2)), ("a", "b"))}, "expects one"),
    ],
)
def test_what_a_bench_cannot_use(changes, complaint):
    """A log without what the fit needs says what it is and what to do."""
    with pytest.raises(LogError, match=complaint):
        run(**changes)


def test_voltage_benches_need_neither_gain_nor_load():
    """Open-loop benches are driven by volts; no firmware, no declared load."""
    rig = RigFacts(servo="mx106", control="voltage")
    one = run(rig, goal=None, voltage_command=("V", T, np.full(100, 3.0)))
    assert one.voltage_driven
    assert one.kp_scale == one.force_scale * MX106.supply_voltage == 1.0
    np.testing.assert_allclose(one.command, 3.0)

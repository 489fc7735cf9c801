import math
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid import trajectories
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.readers import read_log
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.simulate import ENCODER_COUNT, simulate_bench
from frasa_sysid.simulated_bench import BENCHES, Bench, bench_of

MX64 = PUBLISHED_M4["mx64"]
STEADY = Bench(
    loads=((0.535, 0.15),),
    gains=(16.0,),
    arm_mass=0.036,
    supply_voltage=15.0,
    supply_resistance=0.25,
    command_delay=0.0115,
    zero_offset=-0.021,
    read_jitter=0.0,
    stamp_jitter=0.0,
)


@pytest.mark.parametrize("name", sorted(BENCHES))
def test_the_stored_logs_are_what_is_made_now(name, robot_model_dir):
    """The logs in bench_logs/ are those of today's simulator: facts exactly, readings within one encoder count."""
    stored = read_log(robot_model_dir.parent / "bench_logs" / f"{name}.mcap")
    made = simulate_bench(PUBLISHED_M4[name], BENCHES[name], f"{name}.mcap")
    assert [one.name for one in made] == [one.name for one in stored]
    for one, two in zip(made, stored, strict=True):
        assert one.rig == two.rig
        assert one.truth == pytest.approx(two.truth)
        assert two.origin == "simulated"
        for signal in one.signals.values():
            other = two.signal(signal.name)
            np.testing.assert_allclose(other.t, signal.t, rtol=0, atol=1e-9)
            allowed = {"rad": 1.01 * ENCODER_COUNT, "V": 0.101, "1": 0.0}[signal.unit]
            np.testing.assert_allclose(other.y, signal.y, rtol=0, atol=allowed)


def scalar(name):
    """Position readings and supply of one run of `STEADY`, one number at a time."""
    friction = MX64.friction
    mass, length = STEADY.loads[0]
    inertia = (mass + 0.036 / 3) * length**2 + MX64.armature
    weight = (mass + 0.036 / 2) * 9.81 * length
    q = dq = duty = 0.0
    volts, on, dt = 15.0, 1.0, 0.0002
    angles, supply = [], []
    goals = trajectories.goal(name, np.arange(600) * 0.01)
    enables = trajectories.torque_enabled(name, np.arange(600) * 0.01)
    for k in range(30000):
        if k % 50 == 0:
            angles.append(q)
            supply.append(volts)
        if k % 5 == 0:
            cycle = max(math.floor((k * dt - 0.0115) / 0.01 + 1e-6), 0)
            on = enables[cycle]
            duty = on * min(max(MX64.error_gain * 16 * (goals[cycle] - q + 0.021), -MX64.max_duty), MX64.max_duty)
        current = on * (duty * volts - MX64.kt * dq) / MX64.R
        volts = 15.0 - 0.25 * duty * current
        motor, gravity = MX64.kt * current, -weight * math.sin(q)
        load = abs(motor - gravity)
        fade = math.exp(-((abs(dq) / friction.stribeck_speed) ** friction.stribeck_exponent))
        bound = friction.viscous * abs(dq) + friction.coulomb + friction.load_motor * load
        bound += fade * (friction.stribeck + friction.load_motor_stribeck * load)
        stop = -(inertia * dq / dt + motor + gravity)
        dq += dt * (motor + gravity + min(max(stop, -bound), bound)) / inertia
        q += dt * dq
    return np.array(angles) - 0.021, np.array(supply)


def test_equals_a_scalar_program():
    """All runs side by side are each what one written out number by number gives, M4 friction and sag included."""
    for one in simulate_bench(MX64, STEADY, "x.mcap"):
        if one.rig.trajectory in ("sin_time_square", "lift_and_drop"):
            angle, volts = scalar(one.rig.trajectory)
            np.testing.assert_allclose(one.signal("position").y, angle, atol=0.51 * ENCODER_COUNT)
            np.testing.assert_allclose(one.signal("supply_voltage").y, volts, atol=0.051)
            assert volts.min() < 14.98


def test_a_free_pendulum_keeps_its_energy():
    """Without friction and with the motor off, every swing rises as high as the first, within 1 % of the energy."""
    bench = replace(STEADY, zero_offset=0.0)
    smooth = replace(MX64, friction=Friction(0.0, 0.0))
    runs = {one.rig.trajectory: one for one in simulate_bench(smooth, bench, "x.mcap")}
    t, q = runs["lift_and_drop"].signal("position").t, runs["lift_and_drop"].signal("position").y
    swing = q[t > trajectories.DROP_TIME + 0.03]
    high = np.abs(swing)
    tops = high[1:-1][(high[1:-1] >= np.maximum(high[:-2], high[2:])) & (high[1:-1] > 1)]
    start = 1 - np.cos(np.abs(q[(t > 1.9) & (t < 2.0)]).mean())
    assert len(tops) > 5
    np.testing.assert_allclose(1 - np.cos(tops), start, rtol=0.03)
    early, late = np.mean(1 - np.cos(tops[:3])), np.mean(1 - np.cos(tops[-3:]))
    assert late == pytest.approx(early, rel=0.01)


def test_the_faults_of_a_log():
    """Readings are encoder counts, stamps strictly increasing microseconds, jitter and delay as told."""
    noisy = replace(STEADY, read_jitter=0.0004, stamp_jitter=0.0001)
    one = simulate_bench(MX64, noisy, "x.mcap")[1]
    position = one.signal("position")
    counts = position.y / ENCODER_COUNT
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert position.t[0] == 0.0
    assert np.diff(position.t).min() > 0
    assert 0.0002 < np.std(np.diff(position.t)) < 0.001
    assert one.truth["mx64.delay"] == 0.0115


def test_another_delay_or_seed():
    """Delay and seed are those asked for; the same seed gives the same log, another one another."""
    assert bench_of(MX64, None, None) == BENCHES["mx64"]
    assert bench_of(MX64, 0.002, 5) == replace(BENCHES["mx64"], command_delay=0.002, seed=5)
    noisy = replace(STEADY, read_jitter=0.0004)
    one, two, other = (simulate_bench(MX64, replace(noisy, seed=seed), "x")[0].signal("position") for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.y, two.y)
    np.testing.assert_array_equal(one.t, two.t)
    assert not np.array_equal(one.t[:500], other.t[:500])


def test_trajectories_are_those_of_the_bench():
    """Four trajectories, continuous, inside half a turn, and only one drops the arm."""
    t = np.arange(0, trajectories.DURATION, 1e-3)
    for name in trajectories.GOALS:
        goal = trajectories.goal(name, t)
        assert np.abs(np.diff(goal)).max() < 0.015
        assert np.abs(goal).max() < np.pi
        off = t[trajectories.torque_enabled(name, t) == 0]
        assert (off.size > 0) == (name == "lift_and_drop")
        assert off.size == 0 or off[0] == trajectories.DROP_TIME

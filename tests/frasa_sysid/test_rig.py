from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.errors import LogError
from frasa_sysid.pieces import segments
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.rig import GRAVITY, bench_run
from frasa_sysid.servo import servo
from frasa_sysid.servo_values import ServoValues

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
    assert run(position=("rad", t * 5, 0.3 + 1.7 * t * 5)).dq0 == 0.0  # too few samples to say


def test_the_speed_is_that_of_the_first_dozen_samples():
    """At 1 kHz a step that sets in after twelve samples is not yet a speed, and what comes later changes nothing."""
    t = np.arange(400) * 0.001
    late = np.where(t < 0.012, 0.0, 100.0 * (t - 0.012) ** 2)
    assert run(position=("rad", t, late)).dq0 == 0.0
    moving = np.where(t < 0.0115, 0.9 * t, 5.0)
    assert run(position=("rad", t, moving)).dq0 == pytest.approx(0.9, abs=1e-6)


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
    assert (one.control, one.absolute) == ("voltage", True)
    assert one.kp_scale == one.force_scale == one.rest == 1.0
    np.testing.assert_allclose(one.command, 3.0)
    force = run(RigFacts(servo="mx106", control="force"), goal=None, force=("N", T, np.full(100, -2.0)))
    assert (force.control, force.absolute, force.gravity_torque) == ("force", True, 0.0)
    np.testing.assert_allclose(force.command, -2.0)
    goal = run()
    assert (goal.control, goal.absolute) == ("position", False)


@pytest.mark.parametrize(
    ("control", "name"), [("position", "goal"), ("voltage", "voltage_command"), ("force", "force")]
)
def test_each_control_has_its_own_drive(control, name):
    """A run without the commands of its control says which signal it lacks."""
    with pytest.raises(LogError, match=f"no '{name}' signal"):
        run(replace(RIG, control=control), goal=None)


def test_a_run_is_whole():
    """A run of a recording has no commands before its start, and the name of its rig says its load alone."""
    one = run()
    assert (one.lead, one.steps, one.free_start) == (0, one.command.size, False)
    assert one.steps * DT >= one.t[-1]
    assert one.supply.shape == (one.steps,)
    assert one.rig == run(replace(RIG, firmware_gain=8, trajectory="sin_sin")).rig
    assert one.rig != run(replace(RIG, mass=0.6)).rig
    assert one.group != run(replace(RIG, firmware_gain=8)).group


def test_the_course_of_the_supply():
    """A supply that is measured often enough is followed, smoothed and relative to its median; else it is flat."""
    falling = 12.6 - 1.2 * T
    one = run(supply_voltage=("V", T, falling))
    at = (np.arange(one.steps) + 0.5) * DT
    inside = (at > 0.1) & (at < T[-1] - 0.1)
    np.testing.assert_allclose(one.supply[inside], (12.6 - 1.2 * at[inside]) / np.median(falling), rtol=1e-3)
    ripple = 12.0 + 0.5 * (-1.0) ** np.arange(100)
    np.testing.assert_allclose(run(supply_voltage=("V", T, ripple)).supply[inside], 1.0, atol=0.006)
    seldom = np.where(T < 0.3, 12.0, np.where(T < 0.6, 11.9, 12.1))
    np.testing.assert_array_equal(run(supply_voltage=("V", T, seldom)).supply, 1.0)
    np.testing.assert_array_equal(run().supply, 1.0)
    volts = RigFacts(servo="mx106", control="voltage")
    drive = ("V", T, np.full(100, 3.0))
    np.testing.assert_array_equal(
        run(volts, goal=None, voltage_command=drive, supply_voltage=("V", T, falling)).supply, 1.0
    )


def test_the_supply_at_rest():
    """The unloaded supply is what was measured at the smallest errors, or the declared one where that agrees."""
    pulled = np.where(T < 0.3, 0.0, 0.5)
    goal = ("rad", T, np.sin(T) + pulled)
    volts = ("V", T, np.where(T < 0.3, 12.5, 11.5))
    bare = replace(RIG, supply_voltage=None)
    assert run(bare, goal=goal, supply_voltage=volts).rest == pytest.approx(12.5 / 11.5)
    assert run(replace(RIG, supply_voltage=12.6), goal=goal, supply_voltage=volts).rest == pytest.approx(12.6 / 11.5)
    assert run(replace(RIG, supply_voltage=14.0), goal=goal, supply_voltage=volts).rest == pytest.approx(12.5 / 11.5)
    assert run().rest == 1.0


SERVO = ServoValues(20.0, 6.0, 1.3, 0.1, 0.12, 0.03, 0.0073, 0.01)


@pytest.fixture(scope="module")
def session(robot_model_dir):
    with BenchSession(robot_model_dir / "bench_pendulum.xml", MX106, threads=1) as one:
        yield one


def swinging(off=(), **changes):
    """A run with readings at every step, the torque off between the given times."""
    t = np.arange(1200) * DT
    enable = np.array([sum(one <= at + 1e-9 for one in off) % 2 == 0 for at in t], dtype=float)
    signals = {"goal": ("rad", T * 2.4, np.sign(np.sin(4 * T * 2.4))), "torque_enable": ("1", t, enable)}
    return replace(run(RIG, position=("rad", t, np.zeros(t.size)), **signals), **changes)


@pytest.mark.parametrize("delay", [0.0, 0.0073, 0.03])
def test_pieces_go_on_where_the_run_was(session, delay):
    """Started from the run's own states, its pieces simulate to the run, with what was still under way."""
    whole = swinging(off=(0.598, 1.005, 1.79))
    values = replace(SERVO, delay=delay).array()[None]
    y = session.kernel([whole]).readings(values)[0]
    whole = replace(whole, y=y)
    assert np.ptp(y) > 1.0
    pieces = segments(whole, 0.3, DT)
    assert len(pieces) == 8
    first = 0
    for piece in pieces:
        np.testing.assert_array_equal(piece.y, whole.y[first : first + piece.y.size])
        # On the grid of a semi-implicit step the speed is the last difference of angles.
        speed = (y[first] - y[first - 1]) / DT if first else 0.0
        exact = replace(piece, q0=float(y[first]), dq0=float(speed))
        found = session.kernel([exact]).readings(values)[0]
        np.testing.assert_allclose(found, piece.y, atol=1e-9)
        first += piece.y.size - 1


def test_pieces_cover_the_run():
    """Every sample is in a piece, neighbours share one, lengths are alike, and each start is free and as measured."""
    t = np.sort(np.random.default_rng(2).uniform(0.0, 3.0, 300))
    whole = run(position=("rad", t, 0.4 * np.sin(2 * (t - t[0]))))
    pieces = segments(whole, 0.5, DT)
    assert [piece.name for piece in pieces] == [f"r@{i}" for i in range(6)]
    np.testing.assert_array_equal(np.concatenate([pieces[0].y[:1], *(piece.y[1:] for piece in pieces)]), whole.y)
    begin = 0.0
    for i, piece in enumerate(pieces):
        assert piece.free_start
        assert piece.t[0] == 0.0
        assert piece.t[-1] == pytest.approx(0.5, abs=0.1)
        assert piece.y[0] == whole.y[np.argmin(np.abs(whole.t - begin))]
        assert (piece.lead, piece.command.size) == (0 if i == 0 else 50, piece.lead + piece.steps)
        np.testing.assert_allclose((piece.step + piece.weight) * DT, piece.t, atol=1e-12)
        if i:
            assert piece.q0 == pytest.approx(0.4 * np.sin(2 * begin), abs=1e-4)
            assert piece.dq0 == pytest.approx(0.8 * np.cos(2 * begin), abs=5e-3)
        begin += piece.t[-1]
    assert (pieces[0].q0, pieces[0].dq0) == (whole.q0, whole.dq0)
    assert [piece.y.size for piece in segments(whole, 100.0, DT)] == [300]


def test_commands_of_a_piece_are_those_of_its_time():
    """A piece's grid starts at its first sample: its commands are the held goal from there, and before it."""
    rng = np.random.default_rng(3)
    t = np.sort(np.append(rng.uniform(0.0, 2.0, 150), 0.0))
    goal = np.cumsum(rng.uniform(-0.1, 0.1, 200))
    written = np.arange(200) * 0.01
    whole = run(position=("rad", t, np.sin(t)), goal=("rad", written, goal))
    for piece in segments(whole, 0.4, DT)[1:]:
        begin = t[np.flatnonzero(np.sin(t) == piece.y[0])[0]]
        at = begin + (np.arange(-piece.lead, piece.steps)[:, None] + (np.arange(100) + 0.5) / 100) * DT
        expected = held(written, goal, at).mean(axis=1)
        # Moved by part of a step, a jump within a step is shared between two: times agree, not single steps.
        difference = np.cumsum(piece.command - expected)[: -round(0.01 / DT)] * DT
        assert np.abs(difference).max() < 0.3 * DT * 0.1


def test_torque_of_a_piece():
    """A turn of the torque flag before a piece, but no longer ago than commands are kept, is still to come."""
    whole = swinging(off=(0.2, 0.45, 0.56))
    at = [0.0, 0.6, 1.2, 1.8]
    pieces = segments(whole, 0.6, DT)
    for begin, piece in zip(at, pieces, strict=True):
        turns = np.array([0.2, 0.45, 0.56])
        kept = turns[turns > begin - piece.lead * DT + 1e-9] - begin
        np.testing.assert_allclose(piece.switches, kept, atol=3e-3)
        assert piece.powered_first == ((3 - kept.size) % 2 == 0)

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.joint_checks import checks
from frasa_sysid.readers import read_log
from frasa_sysid.readers.bam import read_bam
from frasa_sysid.readers.harold import read_harold
from frasa_sysid.readers.kbot import read_kbot
from frasa_sysid.readers.rostopic_csv import read_rostopic_csv
from frasa_sysid.readers.upkie import read_upkie
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap

T = np.arange(0, 10, 0.01)
Q = 0.5 * np.sin(3 * T) + 0.2 * np.sin(7 * T)
DQ = 1.5 * np.cos(3 * T) + 1.4 * np.cos(7 * T)


def robot(t=T, **changes):
    y = {"position": [Q, Q], "goal": [np.interp(T + 0.03, T, Q)] * 2, "velocity": [DQ, DQ]} | changes
    units = {"position": "rad", "goal": "rad", "velocity": "rad/s"}
    signals = {
        name: Signal(name, units[name], t, np.stack(both, axis=1)[: t.size], ("hip", "knee"))
        for name, both in y.items()
        if both is not None
    }
    return Recording("robot", signals, RigFacts(), "real", "none", "", "header")


def codes(recording):
    return {(one.code, one.joint, one.level) for one in checks(recording)}


def test_a_sound_log_has_nothing_to_say():
    """A joint that follows its goal late raises nothing."""
    assert codes(robot()) == set()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"position": [Q, -Q], "velocity": [DQ, -DQ]}, ("wrong_sign", "knee", "refuse")),
        ({"position": [Q, Q + 0.6]}, ("wrong_zero", "knee", "refuse")),
        ({"position": [Q, 2 * Q], "velocity": [DQ, 2 * DQ]}, ("wrong_scale", "knee", "warn")),
        ({"position": [Q, 0.05 * np.sin(11 * T)], "velocity": None}, ("does_not_follow", "knee", "warn")),
        ({"velocity": [DQ, -DQ]}, ("velocity_sign", "knee", "refuse")),
        ({"velocity": [DQ, np.rad2deg(DQ)]}, ("velocity_scale", "knee", "refuse")),
        ({"velocity": [DQ, 0.4 * DQ]}, ("velocity_scale", "knee", "warn")),
        ({"velocity": [DQ, np.sin(50 * T)]}, ("velocity_unlike", "knee", "warn")),
        ({"goal": None}, ("no_goal", "", "refuse")),
    ],
)
def test_what_is_wrong_is_named(changes, expected):
    """Each mistake by its name and joint, and nothing else."""
    assert codes(robot(**changes)) == {expected}


def test_degrees_are_guessed():
    """The likely unit of a velocity stands in the message."""
    text = checks(robot(velocity=[DQ, np.rad2deg(DQ)]))[0].message
    assert "deg/s" in text


def test_rates():
    """100 Hz passes, 20 Hz is warned of, 5 Hz refused."""
    for dt, level in ((0.05, "warn"), (0.2, "refuse")):
        t = np.arange(0, 10, dt)
        q = np.interp(t, T, Q)
        slow = Recording(
            "slow",
            {name: Signal(name, "rad", t, np.stack([q, q], axis=1), ("hip", "knee")) for name in ("position", "goal")},
            RigFacts(),
            "real",
            "none",
            "",
            "header",
        )
        assert codes(slow) == {("slow_rate", "", level)}


def test_still_joints_are_not_judged():
    """Signs and scales of a joint that does not move are unknown, not wrong."""
    still = robot(position=[Q * 0, Q * 0], goal=[Q * 0, Q * 0], velocity=[DQ * 0, DQ * 0])
    assert codes(still) == set()
    assert codes(robot(t=T[:2])) == {("too_short", "", "refuse")}


def test_real_robots(shared_dir):
    """What the public robot logs lack is named: signs, a scale, rates, goals, joints."""
    folder = shared_dir / "data"
    if not (folder / "robots").exists():
        pytest.skip("no robot logs in the shared data")
    kbot = codes(read_kbot(folder / "robstride" / "kbot_squat_real_data.json.gz")[0])
    assert {("wrong_sign", "dof_left_knee_04", "refuse"), ("wrong_sign", "dof_left_ankle_02", "refuse")} <= kbot
    assert ("wrong_scale", "dof_right_knee_04", "warn") in kbot
    first, *others = (codes(read_harold(path)[0]) for path in sorted((folder / "robots").glob("harold*")))
    assert first == {("slow_rate", "", "refuse"), ("no_goal", "", "refuse")}
    assert all(one == {("slow_rate", "", "refuse")} for one in others)
    upkie = codes(read_upkie(folder / "robots" / "upkie_robot.json")[0])
    assert upkie == {("slow_rate", "", "warn"), ("no_goal", "", "warn")}
    spirit = codes(read_rostopic_csv(folder / "robots" / "spirit40_imu.csv.gz")[0])
    assert spirit == {("no_joints", "", "refuse")}


def test_a_joint_without_torque_is_not_held_against_its_goal():
    """An arm that was let go falls where it likes; what it does under power is judged as ever."""
    goal = np.where(T < 5, Q, Q[500])
    fallen = np.where(T < 5, Q, Q[500] + 1.2 * (1 - np.cos(9 * (T - 5))))
    enable = Signal("torque_enable", "1", T, (T < 5).astype(float))
    log = robot(position=[fallen, Q], goal=[goal, Q], velocity=None)
    assert ("does_not_follow", "hip", "warn") in codes(log)
    assert codes(replace(log, signals={**log.signals, "torque_enable": enable})) == set()
    of_one = Signal("torque_enable", "1", T, np.stack([T < 5, T < 99], axis=1).astype(float), ("hip", "knee"))
    assert codes(replace(log, signals={**log.signals, "torque_enable": of_one})) == set()
    turned = robot(position=[np.where(T < 5, -Q, fallen), Q], goal=[goal, Q], velocity=None)
    assert ("wrong_sign", "hip", "refuse") in codes(
        replace(turned, signals={**turned.signals, "torque_enable": enable})
    )


def test_our_own_bench_log_has_nothing_to_say(robot_model_dir):
    """The log of this repository, drops without torque included, raises no check."""
    recordings = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    assert [check for recording in recordings for check in checks(recording)] == []


def bench(goal, position, rig=None):
    signals = {name: Signal(name, "rad", T, y) for name, y in (("goal", goal), ("position", position))}
    return Recording("bench", signals, rig or RigFacts(mass=0.5, length=0.1), "real", "none", "", "header")


LIFT = np.interp(T, [0, 4, 8, 10], [0.0, 1.5, 1.0, 1.0])


@pytest.mark.parametrize(
    ("recording", "expected"),
    [
        (bench(LIFT, 0.6 * LIFT), {("hangs_below", "", "warn")}),
        (bench(-LIFT, -0.6 * LIFT), {("hangs_below", "", "warn")}),
        (bench(LIFT, 0.6 * LIFT, RigFacts()), {("hangs_below", "", "warn")}),
        # As far as it is told, and elsewhere: by a load's weight perhaps, without one not.
        (bench(LIFT + 0.5, LIFT), {("hangs_below", "", "warn")}),
        (bench(LIFT + 0.5, LIFT, RigFacts()), {("wrong_zero", "", "refuse")}),
        (bench(LIFT + 0.5, LIFT, RigFacts(mass=0.0, length=0.0)), {("wrong_zero", "", "refuse")}),
        # No weight lifts, or draws beyond the vertical.
        (bench(LIFT, LIFT + 0.5), {("wrong_zero", "", "refuse")}),
        (bench(LIFT, LIFT - 2.0), {("wrong_zero", "", "refuse")}),
        (bench(LIFT, -LIFT), {("wrong_sign", "", "refuse")}),
        (bench(LIFT, -0.6 * LIFT), {("wrong_sign", "", "refuse")}),
        # A robot's joint is strong enough to hold it.
        (bench(LIFT, 0.6 * LIFT, RigFacts(mass=0.5, length=0.1, base="fixed")), {("wrong_zero", "", "refuse")}),
        (robot(goal=[Q, Q + 0.6], position=[Q, 0.6 * Q], velocity=None), {("wrong_zero", "knee", "refuse")}),
    ],
)
def test_an_arm_that_hangs_below_its_goal(recording, expected):
    """A soft bench is warned of in its own words; wrong signs, other zeros and robots are refused as ever."""
    assert codes(recording) == expected


def test_soft_runs_of_a_real_bench(shared_dir):
    """Runs at low gain, which published results rest on, are good logs."""
    folder = shared_dir / "data" / "xl330"
    if not folder.is_dir():
        pytest.skip("no XL330 logs: expected shared/data/xl330 beside the repository")
    found = [check for path in sorted(folder.glob("*.json*")) for one in read_bam(path) for check in checks(one)]
    assert {one.level for one in found} == {"warn"}
    hanging = [one for one in found if one.code == "hangs_below"]
    assert len(hanging) == 7
    assert "little strength at this gain, or a wrong zero" in hanging[0].message


@pytest.mark.parametrize(
    ("names", "code"),
    [(("goal",), "no_positions"), (("goal", "gyro"), "no_joints"), (("supply_voltage",), "no_positions")],
)
def test_a_log_without_positions(names, code, tmp_path, capsys):
    """It is refused, with what to record; an IMU is worth something by itself."""
    units = {"goal": "rad", "gyro": "rad/s", "supply_voltage": "V"}
    signals = {name: Signal(name, units[name], T, np.sin(T)) for name in names}
    recording = Recording("a", signals, RigFacts(), "real", "none", "", "header")
    assert codes(recording) == {(code, "", "refuse")}
    write_mcap(tmp_path / "a.mcap", [recording])
    assert run_command(build_parser(), ["inspect", str(tmp_path / "a.mcap")]) == 0
    text = " ".join(capsys.readouterr().err.split())
    assert "refused a.mcap#00:" in text
    assert ("record /joint_states (or add a 'position' entry to the map)" in text) is (code == "no_positions")


def test_goals_in_metres_and_no_position():
    """A linear axis needs its position as well."""
    goal = Signal("goal", "m", T, np.sin(T))
    assert codes(Recording("a", {"goal": goal}, RigFacts(), "real", "none", "", "header")) == {
        ("no_positions", "", "refuse")
    }

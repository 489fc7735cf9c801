import argparse
import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.commands import inspect
from frasa_sysid.evidence import RECORD
from frasa_sysid.identifiability import findings, next_logs
from frasa_sysid.identifiability_effects import direction, goal_profile, sag, small_errors, stribeck, zero_offset
from frasa_sysid.inspection import gravity_torque, is_bench, motion, quantum, summarise
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.writer import write_mcap

COUNT = 2 * np.pi / 4096
T = np.arange(600) * 0.01
RIG = RigFacts(servo="mx106", mass=0.5, length=0.1, firmware_gain=32)


def run_of(goal=None, position=None, rig=RIG, clock="header", t=T, **others):
    goal = 0.8 * np.sin(5 * t) if goal is None else goal
    position = 0.95 * goal if position is None else position
    position = np.round(position / COUNT) * COUNT
    signals = {"position": Signal("position", "rad", t, position), "goal": Signal("goal", "rad", t, goal)}
    for name, (unit, y) in others.items():
        signals[name] = Signal(name, unit, t, y)
    return Recording("r", signals, rig, "real", "", "", clock)


def verdicts(*recordings):
    return {one.parameter.split(" (")[0]: one.verdict for one in findings([motion(one) for one in recordings])}


def test_quantum_of_a_reading():
    """Readings on a grid show its step, however gappy; others show none."""
    rng = np.random.default_rng(0)
    assert quantum(rng.integers(-2000, 2000, 300) * COUNT) == pytest.approx(COUNT, rel=1e-6)
    assert quantum(rng.normal(size=300)) is None
    assert quantum(np.array([0.0, 1.0] * 10)) is None
    assert quantum(np.sin(T)) is None


def test_summary_of_a_signal():
    """Rates are median, 99 % and maximum of the sampling period."""
    t = np.append(T, T[-1] + 0.05)
    one = summarise(Signal("load", "raw", t, np.arange(601.0)))
    assert one.period_median == pytest.approx(0.01)
    assert one.period_max == pytest.approx(0.05)
    assert (one.low, one.high, one.samples, one.quantum) == (0, 600, 601, 1)
    assert summarise(Signal("load", "raw", np.zeros(1), np.zeros(1))).period_max == 0


def test_gravity_of_a_rig():
    """Declared gravity has precedence; mass, length and half the arm give it otherwise."""
    assert gravity_torque(run_of(rig=RigFacts(gravity_torque=1.5, mass=1, length=1))) == 1.5
    assert gravity_torque(run_of(rig=RigFacts(mass=1, length=0.1, arm_mass=0.2))) == pytest.approx(9.81 * 0.11)
    assert gravity_torque(run_of(rig=RigFacts(mass=1))) is None


def test_gain_needs_a_drive_and_a_known_torque():
    """Without goals no gain, without a known load only ratios, with an error of a count nearly nothing."""
    assert verdicts(run_of())["gain"] == "yes"
    assert verdicts(run_of(rig=RigFacts()))["gain"] == "weak"
    assert verdicts(run_of(position=0.8 * np.sin(5 * T)))["gain"] == "weak"
    quiet = run_of()
    no_goal = replace(quiet, signals={"position": quiet.signals["position"]})
    assert verdicts(no_goal)["gain"] == "no"
    assert verdicts(no_goal)["command delay"] == "no"


def test_force_limit_needs_saturation():
    """The limit shows where the law asks for more than there is."""
    step = np.where(T % 1 < 0.5, 0.0, 1.5)
    assert verdicts(run_of(goal=step, position=np.full(600, 0.75) + 0.1 * np.sin(T)))["force limit"] == "yes"
    assert verdicts(run_of())["force limit"] == "no"
    unknown = RigFacts(mass=0.5, length=0.1)
    assert verdicts(run_of(goal=step, position=0.7 + 0.1 * np.sin(T), rig=unknown))["force limit"] == "weak"


def test_damping_is_told_from_back_emf_with_the_motor_off():
    """Only a segment with the torque off tells viscous friction from back-EMF."""
    off = run_of(torque_enable=("1", (T < 3).astype(float)))
    assert verdicts(off)["damping"] == "yes"
    assert verdicts(run_of())["damping"] == "weak"


def test_friction_armature_delay_and_supply():
    """Slow still arms show no friction, no inertia and no delay; swings show them."""
    still = run_of(goal=np.full(600, 0.5) + 1e-3 * T)
    found = verdicts(still)
    assert (found["friction loss"], found["armature"], found["command delay"]) == ("no", "no", "no")
    found = verdicts(run_of(supply_voltage=("V", np.full(600, 12.0))))
    assert found["friction loss"] == found["armature"] == found["command delay"] == found["supply voltage"] == "yes"
    assert verdicts(run_of(clock="log"))["command delay"] == "weak"
    slow = np.arange(200) * 0.03
    assert verdicts(run_of(t=slow, goal=0.8 * np.sin(5 * slow)))["command delay"] == "weak"


def test_load_friction_needs_two_loads():
    """Friction that grows with the load needs two loads that differ."""
    heavy = replace(RIG, mass=1.0)
    assert verdicts(run_of())["load-dependent friction"] == "no"
    assert verdicts(run_of(), run_of(rig=heavy))["load-dependent friction"] == "yes"
    assert verdicts(run_of(), run_of(rig=replace(RIG, mass=0.55)))["load-dependent friction"] == "weak"


def test_a_bare_horn_is_declared_already():
    """A load of zero is known: the advice is to hang one, never to declare one; beside a load it is a second load."""
    bare = run_of(rig=RigFacts(servo="mx106", mass=0.0, length=0.0, firmware_gain=32))
    found = findings([motion(bare)])
    by_name = {one.parameter: one for one in found}
    assert by_name["gain (kp)"].verdict == by_name["armature"].verdict == "weak"
    assert not any("declare" in one.record for one in found)
    assert "hang a load of known mass and length on the arm" in next_logs(found)
    assert "declare" in " ".join(one.record for one in findings([motion(run_of(rig=RigFacts()))]))
    assert verdicts(bare, run_of())["load-dependent friction"] == "yes"


def test_stribeck_needs_several_slow_speeds():
    """Slow motion at several speeds through standstill shows the curve; one speed, or none, does not."""
    slow = 1.5 * np.sin(2 * np.pi * T / 6)
    mixed = run_of(goal=slow + 0.5 * np.sin(4 * T))
    assert verdicts(mixed)["Stribeck friction"] == "weak"
    assert verdicts(mixed, run_of(goal=0.1 * np.sin(2 * T)))["Stribeck friction"] == "yes"
    assert verdicts(run_of(goal=0.05 * np.sin(4 * T), position=0.05 * np.sin(4 * T)))["Stribeck friction"] == "weak"
    assert verdicts(run_of(goal=np.full(600, 0.5)))["Stribeck friction"] == "no"
    off = run_of(goal=slow + 0.5 * np.sin(4 * T), torque_enable=("1", np.zeros(600)))
    assert verdicts(off)["Stribeck friction"] == "no"


def test_direction_needs_lifting_and_lowering():
    """Motor and load are told apart where the servo lifts and lowers under power."""
    name = "friction by direction of the load"
    assert verdicts(run_of(goal=1.2 * np.sin(2 * T)))[name] == "yes"
    up = run_of(goal=np.minimum(0.25 * T, 1.4), torque_enable=("1", np.ones(600)))
    one = next(one for one in findings([motion(up)]) if one.parameter == name)
    assert (one.verdict, one.record) == ("no", RECORD["load_external"])
    assert verdicts(run_of(rig=RigFacts()))[name] == "no"


def test_sag_needs_a_fast_voltmeter():
    """Sag shows where the supply is measured at every cycle and changes."""
    name = "supply sag"
    assert verdicts(run_of())[name] == "weak"
    assert verdicts(run_of(supply_voltage=("V", np.full(600, 12.0))))[name] == "weak"
    assert verdicts(run_of(supply_voltage=("V", 12.0 + 0.01 * np.sin(9 * T))))[name] == "no"
    assert verdicts(run_of(supply_voltage=("V", 12.0 + np.sin(9 * T))))[name] == "yes"


def test_goal_profile_needs_a_step():
    """A speed limit shows in steps, or in goals that run away from the arm."""
    name = "goal profile"
    assert verdicts(run_of(goal=np.where(T < 3, 0.0, 1.2), position=np.minimum(T, 1.2)))[name] == "yes"
    assert verdicts(run_of())[name] == "weak"
    assert verdicts(run_of(goal=0.2 * np.sin(2 * T)))[name] == "no"


def test_zero_offset_needs_both_sides():
    """Gravity tells the zero where the arm hangs to both sides."""
    assert verdicts(run_of())["zero offset"] == "yes"
    assert verdicts(run_of(goal=0.8 + 0.3 * np.sin(5 * T)))["zero offset"] == "weak"
    assert verdicts(run_of(rig=RigFacts(mass=0.0, length=0.0)))["zero offset"] == "no"


def test_punch_and_backlash_need_small_errors():
    """They act on errors of some counts, which a coarse encoder does not show."""
    name = "punch and backlash"
    near = run_of(goal=0.8 * np.sin(5 * T), position=0.8 * np.sin(5 * T) + 0.008)
    assert verdicts(near)[name] == "yes"
    assert verdicts(run_of(position=0.8 * np.sin(5 * T) + 0.3))[name] == "no"


def test_one_log_has_one_name_before_and_after_a_fit():
    """The rules on laws and effects advise in the words of the evidence, but for what a fit cannot know."""
    still = [motion(run_of(goal=np.full(600, 0.5)))]
    rules = (stribeck, direction, sag, goal_profile, zero_offset, small_errors)
    advice = {rule(still).record for rule in rules}
    assert advice - {""} <= set(RECORD.values())
    assert len(advice) == len(rules)


def test_next_logs_are_what_is_missing():
    """What is missing is asked for once, the missing before the weak; a complete set asks for nothing."""
    found = findings([motion(run_of())])
    wanted = next_logs(found)
    assert len(wanted) == len(set(wanted)) > 0
    first = next(one for one in found if one.verdict == "no" and one.record)
    assert wanted[0] == first.record
    assert findings([]) == []


def frasa(*words):
    parser = argparse.ArgumentParser(prog="frasa-sysid")
    inspect.add_parser(parser.add_subparsers(required=True))
    return run_command(parser, [str(word) for word in words])


def test_inspect_says_it_to_people_and_machines(tmp_path, capsys):
    """One object on standard output, tables on standard error."""
    write_mcap(tmp_path / "a.mcap", [run_of()])
    assert frasa("inspect", tmp_path / "a.mcap", "--json") == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result["schema"] == "frasa.inspect/1"
    assert result["recordings"][0]["rig"]["servo"] == "mx106"
    assert {one["verdict"] for one in result["identifiable"]} <= {"yes", "weak", "no"}
    for word in ("position", "header clock", "force limit", "Record next"):
        assert word in err
    assert frasa("inspect", tmp_path / "a.mcap") == 0
    assert capsys.readouterr().out == ""


def test_many_logs_stay_compact(tmp_path, capsys):
    """A hundred runs of one bench are a line a rig, unless asked for one by one."""
    runs = [run_of(rig=replace(RIG, mass=mass, firmware_gain=gain)) for mass in (0.5, 1) for gain in range(5)]
    write_mcap(tmp_path / "a.mcap", runs)
    assert frasa("inspect", tmp_path / "a.mcap") == 0
    short = capsys.readouterr().err
    assert len(short.splitlines()) < 60
    assert "10 recordings, header clock" in short
    assert frasa("inspect", tmp_path / "a.mcap", "--verbose") == 0
    assert len(capsys.readouterr().err.splitlines()) > 80


def test_each_servo_has_its_own_verdicts(tmp_path, capsys):
    """Logs of one servo type say nothing about another."""
    heavy = replace(RIG, servo="mx64", mass=1.0)
    write_mcap(tmp_path / "a.mcap", [run_of(), run_of(rig=heavy)])
    assert frasa("inspect", tmp_path / "a.mcap", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    loads = {one["servo"]: one["verdict"] for one in result["identifiable"] if one["parameter"].startswith("load")}
    assert loads == {"mx106": "no", "mx64": "no"}
    assert {one["servo"] for one in result["next"]} == {"mx106", "mx64"}


def test_robot_logs_get_no_bench_verdict(tmp_path, capsys):
    """A log of several joints is shown, and the rules are those of a robot: without goals it tells no delay."""
    robot = Signal("position", "rad", T, np.zeros((600, 2)), ("a", "b"))
    recording = Recording("r", {"position": robot}, RigFacts(), "real", "", "", "header")
    assert not is_bench(recording)
    write_mcap(tmp_path / "a.mcap", [recording])
    assert frasa("inspect", tmp_path / "a.mcap", "--json") == 0
    out, err = capsys.readouterr()
    found = {one["parameter"]: one for one in json.loads(out)["identifiable"]}
    assert {one["servo"] for one in found.values()} == {"robot"}
    assert (found["command delay"]["verdict"], found["command delay"]["reason"]) == ("no", "no goals in the log")
    assert "not of a single joint" not in err


def test_bad_log_is_one_line(tmp_path, capsys):
    """A log that cannot be read ends with one line and exit status 3."""
    (tmp_path / "a.mcap").write_bytes(b"text")
    assert frasa("inspect", tmp_path / "a.mcap") == 3
    assert capsys.readouterr().err.count("\n") == 1


def test_the_sts3215_bench_can_identify_everything(shared_dir):
    """The main bench has loads, gains, drops and fast goals: everything can be told but sag, with a slow voltmeter."""
    folder = shared_dir / "data" / "sts3215"
    if not folder.is_dir():
        pytest.skip("no STS3215 logs in the shared data")
    from frasa_sysid.readers.bam import read_bam

    recordings = [read_bam(path)[0] for path in sorted(folder.glob("*.json.gz"))]
    found = verdicts(*recordings)
    assert found.pop("supply sag") == "weak"
    assert set(found.values()) == {"yes"}
    assert all(motion(one).quantum == pytest.approx(COUNT, rel=1e-3) for one in recordings)

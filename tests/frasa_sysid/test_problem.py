import shutil
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.errors import LogError, ModelError, UsageError
from frasa_sysid.hold_out import split
from frasa_sysid.logged_servo import servo_name, stands_in
from frasa_sysid.problem import stated_servo
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.servo import servo
from frasa_sysid.servo_values import ServoValues

T = np.arange(5) * 0.01
POSITION = {"position": Signal("position", "rad", T, T)}


def recordings():
    made = []
    for mass, length in ((0.5, 0.15), (0.969, 0.1)):
        for gain in (8.0, 24.0, 32.0):
            for name in ("sin_sin", "up_and_down"):
                rig = RigFacts("mx106", mass=mass, length=length, firmware_gain=gain, trajectory=name)
                made.append(Recording(f"r{len(made)}", POSITION, rig, "real", "", "", "header"))
    return made


@pytest.mark.parametrize(
    ("rule", "count", "held"),
    [
        ("none", 0, None),
        ("kp=24", 4, lambda rig: rig.firmware_gain == 24),
        ("kp=24.0", 4, lambda rig: rig.firmware_gain == 24),
        ("kp", 4, lambda rig: rig.firmware_gain == 32),
        ("mass=0.969", 6, lambda rig: rig.mass == 0.969),
        ("mass", 6, lambda rig: rig.mass == 0.969),
        ("length=0.15", 6, lambda rig: rig.length == 0.15),
        ("rig", 6, lambda rig: rig.mass * rig.length == pytest.approx(0.0969)),
        ("trajectory=sin_sin", 6, lambda rig: rig.trajectory == "sin_sin"),
        ("trajectory", 6, lambda rig: rig.trajectory == "up_and_down"),
    ],
)
def test_hold_out_rules(rule, count, held):
    """Each rule holds out exactly the runs it names; every run is on one side, in order."""
    every = recordings()
    train, out = split(every, rule)
    assert len(out) == count
    assert all(held(one.rig) for one in out)
    assert not any(held(one.rig) for one in train if held)
    assert sorted([*train, *out], key=every.index) == every


@pytest.mark.parametrize(
    "rule", ["", "=", "speed", "none=3", "kp=99", "kp=fast", "kp=nan", "mass=1", "trajectory=drop", "rig=9", "source"]
)
def test_rules_that_hold_out_nothing(rule):
    """An unknown rule, or one that leaves a side empty, is a usage error that says what the logs have."""
    with pytest.raises(UsageError, match="--hold-out"):
        split(recordings(), rule)


def test_a_rule_that_holds_out_everything():
    """One gain only, or a fact that no log has, cannot be held out."""
    one_gain = [one for one in recordings() if one.rig.firmware_gain == 8]
    bare = [replace(one, rig=RigFacts("mx106")) for one in recordings()]
    for logs, rule in ((one_gain, "kp"), (bare, "kp"), (bare, "trajectory"), (bare, "rig")):
        with pytest.raises(UsageError, match="leaves 0 runs to fit"):
            split(logs, rule)


def test_logs_are_of_one_servo():
    """The servo is what the logs say; the command line fills a gap, and only a table stands for what they name."""
    logs = recordings()
    assert servo_name(logs, None) == "mx106"
    assert servo_name(logs, "mx106") == "mx106"
    silent = [replace(one, rig=RigFacts()) for one in logs]
    assert servo_name(silent, "mx64") == "mx64"
    with pytest.raises(LogError, match="--servo"):
        servo_name(silent, None)
    for some in (logs, [*logs[:1], *silent[1:]]):
        with pytest.raises(UsageError, match="the logs say mx106, --servo says mx64"):
            servo_name(some, "mx64")
    assert servo_name(logs, "mine", own_table=True) == "mine"
    assert stands_in(logs, "mine", "mine.toml") == "the logs say mx106; the numbers are those of mine, from mine.toml"
    assert stands_in(logs, "mx106", "mx106.toml") == stands_in(silent, "mine", "mine.toml") == ""
    other = replace(logs[0], rig=replace(logs[0].rig, servo="mx64"))
    for given, table in ((None, False), ("mx64", False), ("mine", True)):
        with pytest.raises(LogError, match="several servos, mx106, mx64"):
            servo_name([*logs, other], given, table)


def test_nominal_values_come_from_the_model(robot_model_dir):
    """A servo the robot has starts from the robot's numbers, another from its published ones."""
    known, nominal = stated_servo("mx106", robot_model_dir / "nominal.xml")
    assert (known.supply_voltage, known.firmware_gain) == (15.0, 12.0)
    assert (nominal["kp"], nominal["forcerange"], nominal["damping"]) == (21.0, 8.0, 1.7)
    known, nominal = stated_servo("xl330", robot_model_dir / "nominal.xml")
    assert nominal["kp"] == servo("xl330").kp()
    assert known == servo("xl330")


def test_what_a_fit_cannot_start_from(robot_model_dir, tmp_path):
    """A missing model, a calibrated one, one without its supply and one with a zero are errors of the model."""
    for path in robot_model_dir.glob("*.xml"):
        shutil.copy(path, tmp_path)
    nominal, servos = tmp_path / "nominal.xml", tmp_path / "servos_nominal.xml"
    original = servos.read_text()
    with pytest.raises(ModelError, match="no model at"):
        stated_servo("mx106", tmp_path / "typo.xml")
    (tmp_path / "cal.xml").write_text('<mujoco><custom><text name="calibration_id" data="1"/></custom></mujoco>')
    with pytest.raises(ModelError, match="calibrated already"):
        stated_servo("mx106", tmp_path / "cal.xml")
    servos.write_text(original.replace("servo_firmware_gain", "gain"))
    with pytest.raises(ModelError, match="servo_firmware_gain"):
        stated_servo("mx106", nominal)
    servos.write_text(original.replace('frictionloss="0.10"', 'frictionloss="0"'))
    with pytest.raises(ModelError, match="frictionloss of 'mx106'"):
        stated_servo("mx106", nominal)
    with pytest.raises(UsageError, match="unknown servo"):
        stated_servo("mx28", nominal)


def test_the_unit_cube(kit, recordings):
    """Values and points of the cube turn into each other; nominal lies inside, but for no delay."""
    problem = kit.problem(kit.runs(recordings))
    x = problem.to_unit(problem.nominal_values())
    delay = np.array([one.field == "delay" for one in problem.free])
    assert ((x >= 0) == ~delay).all()
    assert (x <= 1).all()
    np.testing.assert_allclose(problem.from_unit(x)[~delay], problem.nominal_values()[~delay], rtol=1e-12)
    low, high = problem.from_unit(np.full(x.size, -1.0)), problem.from_unit(np.full(x.size, 2.0))
    assert (low == [one.low for one in problem.free]).all()
    np.testing.assert_allclose(high, [one.high for one in problem.free])
    values = vars(problem.servo_values(problem.nominal_values()))
    assert {name: values[name] for name in problem.nominal} == problem.nominal
    # What is not nominal is switched off, as in the bare servo.
    assert values == vars(ServoValues(**problem.nominal))
    # The kernel's rows are the same numbers.
    points = np.random.default_rng(0).uniform(0.0, 1.0, (5, x.size))
    for row, point in zip(problem.candidates(points), points, strict=True):
        np.testing.assert_array_equal(row, problem.servo_values(problem.from_unit(point)).array())


def test_what_is_free_depends_on_the_logs(kit, recordings):
    """Volts say nothing of force limit and offset; an unpowered start speaks of the switched-off damping."""
    runs = kit.runs(recordings[:2])
    fields = {one.field for one in kit.problem(runs).free}
    assert fields == {"kp", "damping", "frictionloss", "armature", "delay", "forcerange", "offset"}
    volts = [replace(run, control="voltage") for run in runs]
    assert {one.field for one in kit.problem(volts).free} == fields - {"forcerange", "offset"}
    forces = [replace(run, control="force") for run in runs]
    assert {one.field for one in kit.problem(forces).free} == {"damping", "frictionloss", "armature"}
    off = [replace(run, powered_first=False) for run in runs]
    assert {one.field for one in kit.problem(off).free} == fields | {"damping_off"}

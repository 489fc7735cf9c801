"""Facts of the command line fill what logs leave open; what contradicts all of them is refused, not ignored."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.given_facts import with_facts
from frasa_sysid.errors import UsageError
from frasa_sysid.recording import Recording, RigFacts, Signal

FULL = RigFacts("mx64", mass=1.0, length=0.15, arm_mass=0.03, firmware_gain=16.0, supply_voltage=15.0)


def runs(*rigs, **signals):
    t = np.linspace(0.0, 1.0, 50)
    position = Signal("position", "rad", t, np.sin(t))
    more = {"position": position, **{name: Signal(name, "V", t, np.full(50, value)) for name, value in signals.items()}}
    return [Recording(f"r{i}", more, rig, "real", "a.mcap", "0" * 64, "log") for i, rig in enumerate(rigs)]


@pytest.mark.parametrize(
    ("rigs", "given", "line"),
    [
        ([FULL], {"mass": 99.0}, "--mass 99: the 1 run says its own mass, 1 kg, which counts"),
        ([FULL, replace(FULL, mass=2.0)], {"mass": 3.0}, "--mass 3: all 2 runs say their own mass, 1 to 2 kg, which"),
        ([FULL, replace(FULL, mass=2.0)], {"mass": 1.0}, "--mass 1: 1 of 2 runs says its own mass, 2 kg, which counts"),
        ([FULL], {"firmware_gain": 1.0}, "--firmware-gain 1: the 1 run says its own firmware gain, 16, which counts"),
        ([FULL], {"supply_voltage": 5.0}, "--supply-voltage 5: the 1 run says its own supply voltage, 15 V, which"),
        (
            [RigFacts("mx64", inertia=0.02, gravity_torque=1.0)],
            {"length": 0.1},
            "--length 0.1: the 1 run says inertia and gravity torque in its place, which counts",
        ),
    ],
)
def test_what_contradicts_all_logs_is_refused(rigs, given, line):
    """It would change nothing; the line says what counts instead."""
    with pytest.raises(UsageError) as error:
        with_facts(runs(*rigs), given)
    assert str(error.value).startswith(line)


def test_the_logs_own_value_is_no_contradiction(capsys):
    """The same numbers again, and a supply that agrees with the measured one, pass without a word."""
    own = {name: getattr(FULL, name) for name in ("mass", "length", "arm_mass", "firmware_gain", "supply_voltage")}
    assert [one.rig for one in with_facts(runs(FULL, FULL), own)] == [FULL, FULL]
    silent = replace(FULL, supply_voltage=None)
    (measured,) = with_facts(runs(silent, supply_voltage=14.9), {"supply_voltage": 15.0})
    assert measured.rig.supply_voltage == 15.0
    assert capsys.readouterr().err == ""


def test_a_measured_supply_counts():
    """It has precedence in a fit, so another one given is refused."""
    with pytest.raises(UsageError, match="measures the supply, 12 V, which counts"):
        with_facts(runs(replace(FULL, supply_voltage=None), supply_voltage=12.0), {"supply_voltage": 15.0})


def test_gaps_are_filled_and_the_rest_is_told(capsys):
    """A fact that some logs need holds for those; that others contradict it is one line."""
    bare = replace(FULL, mass=None)
    filled = with_facts(runs(bare, FULL, replace(FULL, mass=2.0)), {"mass": 3.0})
    assert [one.rig.mass for one in filled] == [3.0, 1.0, 2.0]
    line = (
        "--mass 3 holds for the 1 of 3 runs without it; 2 of 3 runs say their own mass, 1 to 2 kg, which counts there"
    )
    assert capsys.readouterr().err.strip() == line
    assert [one.rig.mass for one in with_facts(runs(bare, replace(FULL, mass=3.0)), {"mass": 3.0})] == [3.0, 3.0]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("command", ["fit", "compare"])
def test_one_line_on_the_command_line(command, model_dir, robot_model_dir, capsys):
    """Exit 2 and one line, before anything is fitted."""
    log, model = robot_model_dir.parent / "bench_logs" / "mx106.mcap", model_dir / "nominal.xml"
    assert run_command(build_parser(), [command, str(log), "--model", str(model), "--mass", "99"]) == 2
    err = capsys.readouterr().err
    assert "--mass 99: all 36 runs say their own mass, 0.535 to 2 kg, which counts" in err
    assert err.count("\n") == 1

"""What people are told of a log's faults: nothing that was counted is left out."""

import io

import numpy as np
import pytest
from rich.console import Console

from frasa_sysid.calibration.command_line import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.commands.faults import show_faults
from frasa_sysid.recording import Fault, Recording, RigFacts, Signal

POSITION = Signal("position", "rad", np.arange(3.0), np.zeros(3))


def recording(name, *faults):
    return Recording(name, {"position": POSITION}, RigFacts(), "real", name, "", "header", faults)


def shown(*recordings):
    text = io.StringIO()
    show_faults(Console(file=text, width=200), recordings)
    return text.getvalue().splitlines()


GOAL, SUPPLY = Fault("blank", 300, "goal: blank in 300 rows"), Fault("blank", 540, "supply: blank in 540 rows")


@pytest.mark.parametrize(
    ("recordings", "lines"),
    [
        ([recording("a")], ["No faults found"]),
        ([recording("a", GOAL, SUPPLY)], ["  blank: goal: blank in 300 rows", "  blank: supply: blank in 540 rows"]),
        ([recording("a", GOAL), recording("b")], ["  blank: goal: blank in 300 rows"]),
        (
            [recording("a", GOAL, SUPPLY), recording("b")],
            ["  blank (in 1 of 2 recordings, 840 in all; one says:) supply: blank in 540 rows"],
        ),
        (
            [recording("a", GOAL), recording("b", GOAL)],
            ["  blank (in 2 of 2 recordings, 600 in all; one says:) goal: blank in 300 rows"],
        ),
    ],
)
def test_every_message_of_one_and_the_sum_of_several(recordings, lines):
    """One recording's faults are all said; of several, sums are said wherever there is more than one."""
    assert shown(*recordings)[-len(lines) :] == lines


def test_columns_at_three_rates(tmp_path, capsys):
    """A table whose goal and supply are slower than its position: `inspect` says of both how much was blank."""
    rows = [
        f"{i / 100},{i % 40 / 40},{i % 40 / 40 if i % 2 == 0 else ''},{12 if i % 10 == 0 else ' '}" for i in range(600)
    ]
    (tmp_path / "slow.csv").write_text("\n".join(["t,q,g,v", *rows]) + "\n")
    signals = {"q": ("position", "rad"), "g": ("goal", "rad"), "v": ("supply_voltage", "V")}
    text = "".join(f'[[signal]]\ncolumn = "{a}"\nsignal = "{b}"\nunit = "{u}"\n' for a, (b, u) in signals.items())
    (tmp_path / "m.toml").write_text('[time]\ncolumn = "t"\nunit = "s"\n' + text)
    words = ["import", tmp_path / "slow.csv", "--format", "csv", "--map", tmp_path / "m.toml", "--out", tmp_path]
    assert run_command(build_parser(), [str(word) for word in words]) == 0
    assert "blank: 840 in 1 of 1 logs" in capsys.readouterr().err
    assert run_command(build_parser(), ["inspect", str(tmp_path / "slow.mcap")]) == 0
    err = capsys.readouterr().err
    assert "blank: goal: blank in 300 of 600 rows" in err
    assert "blank: supply_voltage: blank in 540 of 600 rows" in err
    assert "NaN" not in err

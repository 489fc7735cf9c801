"""What the guide makes of the code: options from the parsers, formulas, and the table that its advice rests on."""

import argparse
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="the docs extra is not installed")

from docutils import nodes

import frasa_rl.cli
import frasa_sysid.cli

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module", autouse=True)
def _guide_on_the_path():
    """The extensions are modules of the guide's own folder, as Sphinx imports them."""
    sys.path.insert(0, str(ROOT / "notebooks" / "guide"))
    yield
    sys.path.pop(0)


@pytest.mark.parametrize("program", [frasa_sysid.cli, frasa_rl.cli], ids=["frasa-sysid", "frasa-rl"])
def test_every_option_is_in_the_reference(program):
    """Each command has a section of its own, and each of its options a place there with its help."""
    from extensions.command_line import _section, commands

    parser = program.build_parser()
    found = list(commands(parser))
    assert len(found) >= 7
    for name, one, brief in found:
        text = _section(name, one, brief).astext()
        assert text.startswith(one.prog)
        for action in one._actions:
            if action.help == argparse.SUPPRESS or action.dest == "help":
                continue
            assert action.help, f"{one.prog} {action.dest} has no help"
            for option in action.option_strings:
                assert option in text, f"{one.prog}: {option}"


def test_formulas_become_mathml(monkeypatch):
    """A formula is drawn by the browser itself; one that cannot be read fails the build and stays as text."""
    from extensions import mathml

    said = []
    monkeypatch.setattr(mathml.log, "warning", lambda *words, **_: said.append(words))
    assert "<mfrac>" in mathml.mathml(r"\frac{k_t}{R}", nodes.math(), block=True)
    assert "<mtable" in mathml.mathml(r"a &= b \\ c &= d", nodes.math_block(), block=True)
    assert "<msub>" in mathml.mathml(r"|\dot q / \dot q_s|^\alpha", nodes.math(), block=False)
    assert not said
    assert mathml.mathml(r"\nonsense x", nodes.math(), block=False) == r"<code>\nonsense x</code>"
    assert said


def test_a_drop_is_worth_what_the_bench_page_says():
    """Four runs with one drop tell friction, armature and zero better than 27 runs without; only drops tell K_v."""
    from extensions import bench_table

    rows = [row.split("|")[1:-1] for row in bench_table.information(ROOT).splitlines()]
    heading, table = [one.strip() for one in rows[0]], {row[0].strip(" *"): row for row in rows[2:]}
    with_drop = table["one load, one gain, all four"]
    without = table["three loads, three gains, without torque-off"]
    assert (with_drop[1].strip(), without[1].strip()) == ("4", "27")
    for name in ("frictionloss %", "armature %", "zero mrad"):
        place = heading.index(name)
        assert 2.0 * float(with_drop[place]) < float(without[place]), name
    for name, row in table.items():
        told = row[heading.index("K_v %")].strip() != "not told"
        assert told is ("all four" in name), name

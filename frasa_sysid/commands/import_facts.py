"""Facts of the rig as options of `import`, by the names that they have in `fit`."""

import argparse
from typing import Any

from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.recording import RigFacts

NUMBERS = {"mass": "kg", "length": "m", "arm_mass": "kg", "firmware_gain": "P", "supply_voltage": "V"}


def add_fact_arguments(parser: argparse.ArgumentParser) -> None:
    """Give `import` the facts of a bench."""
    for name, unit in NUMBERS.items():
        help_text = f"[{unit}] of all sources; a log that says it differently is refused"
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, metavar=unit.upper(), help=help_text)
    parser.add_argument("--trajectory", metavar="NAME", help="of the motion, for 'fit --hold-out trajectory=NAME'")


def declared_facts(args: argparse.Namespace) -> dict[str, Any]:
    """The facts that a command line declares, by name.

    Raises:
        UsageError: one that no rig can have.
    """
    names = (*NUMBERS, "trajectory")
    facts = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if facts.get("trajectory") == "":
        raise UsageError("--trajectory: expected a name, found none")
    try:
        RigFacts(**facts)
    except LogError as error:
        raise UsageError(str(error)) from error
    return facts

"""`frasa-sysid export-bam`: a fit as a parameter file of Rhoban/bam."""

import argparse
import json
from pathlib import Path
from typing import Any

from frasa_sysid import bam_parameters, stored_fit
from frasa_sysid.calibration import add_json_flag, input_hashes, plain, say, write_atomic
from frasa_sysid.errors import UsageError

SCHEMA = "frasa.export-bam/1"


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `export-bam` to the command line."""
    parser = subparsers.add_parser(
        "export-bam",
        help="a fit as a parameter file of Rhoban/bam",
        description="Write kt, R, armature and friction of a fit as BAM's m1.json to m6.json, and say what of the fit "
        "such a file does not carry.",
    )
    parser.add_argument("fit", type=Path, metavar="FIT", help="fit file")
    parser.add_argument("--out", type=Path, required=True, metavar="JSON", help="file to write, such as m4.json")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Export a fit.

    Raises:
        InputError: a bad fit file, or one that BAM has no words for.
        UsageError: the output is the fit itself, or not named as JSON.
    """
    out: Path = args.out
    if out.suffix != ".json":
        raise UsageError(f"--out {out}: expected a name that ends in .json")
    if out.resolve() == args.fit.resolve():
        raise UsageError(f"--out {out} is the fit itself; choose another name")
    exported = bam_parameters.export(stored_fit.load(args.fit))
    write_atomic(out, json.dumps(plain(exported.data), indent=4, allow_nan=False) + "\n")
    say(f"{exported.data['actuator']} with friction law {exported.data['model']}: {out}")
    for note in exported.notes:
        say(f"  not in it: {note}")
    return {
        "schema": SCHEMA,
        "parameters": exported.data,
        "inputs": input_hashes([args.fit]),
        "not_in_it": exported.notes,
        "outputs": {"parameters": out},
    }

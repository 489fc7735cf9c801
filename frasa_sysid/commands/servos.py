"""`frasa-sysid servos`: known servos with their numbers, a table for another one, and its bench as a model."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from frasa_sysid.bench import BENCH_MODEL, NOMINAL_MODEL
from frasa_sysid.calibration import add_json_flag, say, write_atomic
from frasa_sysid.commands.bench import people_console
from frasa_sysid.errors import UsageError
from frasa_sysid.servo import TABLES, find_table
from frasa_sysid.servo_bench import bench_model
from frasa_sysid.servo_table import ServoTable
from frasa_sysid.servo_text import new_table
from frasa_sysid.simulated_bench import bench_for

SCHEMA = "frasa.servos/1"


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `servos` to the command line."""
    parser = subparsers.add_parser(
        "servos",
        help="known servos, and a table for one of your own",
        description="List the servos that come with frasa, or show and check those named; print a table to fill in for "
        "another one (--new), which every command then takes as --servo FILE.toml; write a servo's bench as MuJoCo "
        "models to fit and publish into (--bench).",
    )
    parser.add_argument("servos", nargs="*", metavar="NAME_OR_TABLE", help="servo, or .toml file; all by default")
    parser.add_argument("--new", metavar="NAME", help="print an empty table for this servo on standard output")
    parser.add_argument("--like", metavar="SERVO", help="with --new: start from this one's numbers")
    parser.add_argument(
        "--bench", type=Path, metavar="DIR", help=f"write {NOMINAL_MODEL.name} and {BENCH_MODEL.name} of the one servo"
    )
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """List, check, or make.

    Raises:
        InputError: a table that cannot be used.
        UsageError: an unknown servo, or options that do not go together.
    """
    if args.new is not None:
        if args.servos or args.bench is not None or args.json:
            raise UsageError("--new goes with --like only")
        text = new_table(args.new, args.like)
        sys.stdout.write(text)
        return {}
    if args.like is not None:
        raise UsageError("--like goes with --new NAME")
    tables = [find_table(word) for word in args.servos] or list(TABLES.values())
    _show(tables, bool(args.servos))
    outputs = _write_bench(args, tables) if args.bench is not None else {}
    return {"schema": SCHEMA, "servos": [_plain(one) for one in tables], "outputs": outputs}


def _write_bench(args: argparse.Namespace, tables: Sequence[ServoTable]) -> dict[str, Path]:
    if len(args.servos) != 1 or tables[0].linear:
        raise UsageError("--bench: expected one servo that turns")
    servo = tables[0].servo
    mass, length = bench_for(servo).loads[0]
    paths = {"model": args.bench / NOMINAL_MODEL.name, "bench_model": args.bench / BENCH_MODEL.name}
    present = [str(path) for path in paths.values() if path.exists()]
    if present:
        raise UsageError(f"--bench: {', '.join(present)} is there already; choose another folder")
    for name, path in paths.items():
        write_atomic(path, bench_model(servo, mass, length, fitting=name == "bench_model"))
    say(f"bench of {servo.name}: {', '.join(str(path) for path in paths.values())}")
    word = args.servos[0]
    say(f"next: frasa-sysid fit LOGS --servo {word} --model {paths['model']} --publish")
    return paths


def _plain(one: ServoTable) -> dict[str, Any]:
    servo = one.servo
    return {
        **{name: value for name, value in asdict(servo).items() if name != "limits"},
        "limits": dict(servo.limits),
        "title": one.title,
        "sources": dict(one.sources),
        "axis": "linear" if one.linear else "turning",
        "mujoco": _numbers(one),
        "simulated": None if one.simulated is None else asdict(one.simulated.friction),
    }


def _numbers(one: ServoTable) -> dict[str, float]:
    servo = one.servo
    return {
        "kp": servo.kp(),
        "forcerange": servo.force_limit(),
        "damping": servo.damping(),
        "frictionloss": servo.friction.coulomb,
        "armature": servo.armature,
    }


def _show(tables: Sequence[ServoTable], named: bool) -> None:
    console = people_console()
    table = Table(title="servos, as MuJoCo has them at the stated supply and gain", title_justify="left")
    for heading in ("servo", "V", "P", "kp", "forcerange", "damping", "frictionloss", "armature", "what"):
        table.add_column(heading, justify="left" if heading in ("servo", "what") else "right", overflow="fold")
    for one in tables:
        numbers = [f"{value:.4g}" for value in _numbers(one).values()]
        title = one.title + (" (metres and newtons)" if one.linear else "")
        servo = one.servo
        table.add_row(
            servo.name, f"{servo.supply_voltage:g}", f"{servo.firmware_gain:g}", *numbers, escape(title)
        )  # fmt: skip
    console.print(table)
    for one in tables:
        console.print(f"  {one.servo.name}: {one.servo.source}", markup=False, soft_wrap=True)
        if named:
            _show_details(one)


def _show_details(one: ServoTable) -> None:
    console, servo = people_console(), one.servo
    for name, source in one.sources.items():
        console.print(f"    {name}: {source}", markup=False, soft_wrap=True)
    speed = servo.max_duty * servo.supply_voltage / servo.kt
    unit = ("N", "m/s", "m") if one.linear else ("N m", "rad/s", "rad")
    console.print(
        f"    stall {servo.force_limit():.3g} {unit[0]}, no load {speed:.3g} {unit[1]}; full duty at an error of "
        f"{servo.max_duty / servo.error_gain / servo.firmware_gain:.3g} {unit[2]} with P = {servo.firmware_gain:g}",
        markup=False,
    )
    for name in ("kp", "forcerange", "damping", "damping_off", "frictionloss", "armature"):
        span = servo.span(name)
        if span is not None:
            console.print(f"    {name} is looked for between {span[0]:.4g} and {span[1]:.4g}", markup=False)
    if one.simulated is not None:
        console.print(f"    simulated benches: {one.simulated.source}", markup=False, soft_wrap=True)

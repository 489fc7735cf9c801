"""`frasa-sysid compare`: simulated against measured, for models and fits side by side."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from frasa_sysid.bench import Bench
from frasa_sysid.bench_compare import BenchContender, compare_bench, of_bam, of_fit, of_model, of_nominal
from frasa_sysid.calibration import (
    add_json_flag,
    add_report_arguments,
    calibration_id,
    input_hashes,
    load_model,
    say,
    tell_report,
)
from frasa_sysid.commands.bench import add_bench_arguments, bench_model, load_bench, people_console, read_logs
from frasa_sysid.commands.compare_robot import REPORT, SCHEMA, compare_robot_logs, write_overlay
from frasa_sysid.commands.fit_robot import add_base_argument, add_share_argument
from frasa_sysid.commands.log_kinds import KindGroup, refuse_other_kind
from frasa_sysid.cost import Misfit
from frasa_sysid.overlay import bench_overlay
from frasa_sysid.report_compare import ComparisonPage, write_comparison
from frasa_sysid.robot_rig import is_robot


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `compare` to the command line."""
    parser = subparsers.add_parser(
        "compare",
        help="simulated against measured, for models and fits",
        description="Simulate logs of a bench or of the whole robot with the nominal model and with any fits and "
        "models, and print the errors.",
    )
    bench = add_bench_arguments(parser)
    parser.add_argument("--fit", type=Path, action="append", default=[], help="a fit file; may be repeated")
    parser.add_argument(
        "--with-model", type=Path, action="append", default=[], metavar="M", help="a calibrated model; may be repeated"
    )
    bench.add(
        "--bam",
        type=Path,
        action="append",
        default=[],
        metavar="JSON",
        help="a BAM parameter file; may be repeated",
        instead="takes models and fits (--with-model M, --fit FIT)",
    )
    robot = KindGroup(parser, "robot")
    add_base_argument(robot)
    add_share_argument(
        robot,
        "compare the end of each log only, which a fit with the same share never saw",
        "is compared on all of each log (--between FROM TO takes a part)",
    )
    add_report_arguments(parser, REPORT)
    parser.add_argument(
        "--mcap",
        type=Path,
        metavar="FILE",
        help="write measured and simulated traces to one MCAP, for Foxglove and PlotJuggler",
    )
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Compare.

    Raises:
        LogError, ModelError, InputError, UsageError: bad input.
    """
    # A calibrated model given as --model is a candidate; nominal is what stands beside it.
    if args.model.is_file() and calibration_id(load_model(args.model)) is not None:
        args.with_model = [args.model, *args.with_model]
        args.model = args.model.with_name("nominal.xml")
    recordings = read_logs(args)
    refuse_other_kind(args, recordings)
    if any(is_robot(one) for one in recordings):
        return compare_robot_logs(args, recordings)
    bench = load_bench(args, recordings=recordings)
    contenders = _contenders(args, bench)
    with bench.session(bench_model(args), args.threads) as session:
        found = compare_bench(contenders, bench, session)
    errors = found.errors
    _show(errors)
    inputs = {**bench.inputs, **input_hashes((args.model, *args.with_model, *args.fit, *args.bam))}
    report = None
    if not args.no_report:
        values = {one.name: one.values for one in contenders}
        files = {one.name: one.file for one in contenders}
        shown = ComparisonPage(bench.servo.name, errors, values, found.traces, bench.inputs, bench.origin, files)
        report = write_comparison(args.report or REPORT, shown)
        tell_report(report)
    if args.mcap is not None:
        names = [run.name for run in found.runs]
        by_run = {name: dict(zip(names, readings, strict=True)) for name, readings in found.readings.items()}
        write_overlay(args.mcap, bench_overlay(bench.train, by_run), inputs)
    last = errors[contenders[-1].name]
    return {
        "schema": SCHEMA,
        "servo": bench.servo.name,
        "misfit": _plain(last),
        "candidates": {name: _plain(one) for name, one in errors.items()},
        "inputs": inputs,
        "outputs": {"report": report, "mcap": args.mcap},
    }


def _contenders(args: argparse.Namespace, bench: Bench) -> list[BenchContender]:
    found = [of_nominal(bench)]
    for path in args.with_model:
        found.append(of_model(_name(path, found), path, bench, args.fit))
        if found[-1].note:
            say(found[-1].note)
    for make, paths in ((of_fit, args.fit), (of_bam, args.bam)):
        for path in paths:
            found.append(make(_name(path, found), path, bench))
    return found


def _name(path: Path, taken: Sequence[BenchContender]) -> str:
    """The file's name, with its folder where another contender has the same."""
    return str(path) if path.name in {one.name for one in taken} else path.name


def _plain(one: Misfit) -> dict[str, Any]:
    return {"mae_rad": one.mae_rad, "rmse_rad": one.rmse_rad, "by_log": one.by_run}


def _show(errors: dict[str, Misfit]) -> None:
    table = Table()
    for heading in ("", "mean error, mrad", "rms, mrad", "worst run, mrad"):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for name, one in errors.items():
        worst = max(one.by_run, key=lambda run: one.by_run[run])
        table.add_row(
            name, f"{one.mae_rad * 1e3:.2f}", f"{one.rmse_rad * 1e3:.2f}", f"{one.by_run[worst] * 1e3:.1f} ({worst})"
        )
    people_console().print(table)

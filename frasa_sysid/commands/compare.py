"""`frasa-sysid compare`: simulated against measured, for models and fits side by side."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from frasa_sysid import bam_parameters, stored_fit
from frasa_sysid.calibration import (
    SERVO_FIELDS,
    add_json_flag,
    add_report_arguments,
    calibration_id,
    load_model,
    number,
    read,
    tell_report,
)
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.calibration.servo_law import law
from frasa_sysid.commands.bench import Bench, add_bench_arguments, bench_model, load_bench, people_console, read_logs
from frasa_sysid.commands.compare_robot import REPORT, SCHEMA, compare_robot_logs, write_overlay
from frasa_sysid.commands.fit_robot import add_base_argument, add_share_argument
from frasa_sysid.cost import Misfit, misfit
from frasa_sysid.errors import ModelError, UsageError
from frasa_sysid.overlay import bench_overlay
from frasa_sysid.recording import FloatArray
from frasa_sysid.report_compare import ComparisonPage, write_comparison
from frasa_sysid.report_figures import Trace
from frasa_sysid.rig import BenchRun
from frasa_sysid.robot_rig import is_robot
from frasa_sysid.servo_values import FIELDS, NO_LIMIT, ServoValues

_RIG_OFFSET = "offset["  # `bench.offset[1.2kg 0.15m]`: zero of one rig beside the one that all share


@dataclass(frozen=True)
class _Candidate:
    """Numbers to simulate with, the file they are from, and the zero of single rigs [rad]."""

    name: str
    values: ServoValues
    file: str
    zeros: Mapping[str, float] = field(default_factory=dict)


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `compare` to the command line."""
    parser = subparsers.add_parser(
        "compare",
        help="simulated against measured, for models and fits",
        description="Simulate logs of a bench or of the whole robot with the nominal model and with any fits and "
        "models, and print the errors.",
    )
    add_bench_arguments(parser)
    parser.add_argument("--fit", type=Path, action="append", default=[], help="a fit file; may be repeated")
    parser.add_argument(
        "--with-model", type=Path, action="append", default=[], metavar="M", help="a calibrated model; may be repeated"
    )
    parser.add_argument(
        "--bam", type=Path, action="append", default=[], metavar="JSON", help="a BAM parameter file; may be repeated"
    )
    group = parser.add_argument_group("logs of the whole robot")
    add_base_argument(group)
    add_share_argument(group, "compare the end of each log only, which a fit with the same share never saw")
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
    if any(is_robot(one) for one in recordings):
        return compare_robot_logs(args, recordings)
    bench = load_bench(args, recordings=recordings)
    candidates = _candidates(args, bench)
    with bench.session(bench_model(args), args.threads) as session:
        runs, _ = bench.runs(session)
        kernel = session.kernel(runs)
        rows = kernel.readings(np.array([one.values.array() for one in candidates]), _offsets(candidates, runs))
        readings = [kernel.split(row) for row in rows]
    errors = {one.name: misfit(runs, found) for one, found in zip(candidates, readings, strict=True)}
    _show(errors)
    report = None
    if not args.no_report:
        names = [one.name for one in candidates]
        traces = [Trace(run, dict(zip(names, found, strict=True))) for run, *found in zip(runs, *readings, strict=True)]
        values = {one.name: one.values for one in candidates}
        files = {one.name: one.file for one in candidates}
        shown = ComparisonPage(bench.servo.name, errors, values, traces, bench.inputs, bench.origin, files)
        report = write_comparison(args.report or REPORT, shown)
        tell_report(report)
    if args.mcap is not None:
        by_run = {
            one.name: {run.name: reading for run, reading in zip(runs, found, strict=True)}
            for one, found in zip(candidates, readings, strict=True)
        }
        write_overlay(args.mcap, bench_overlay(bench.train, by_run))
    last = errors[candidates[-1].name]
    return {
        "schema": SCHEMA,
        "servo": bench.servo.name,
        "misfit": _plain(last),
        "candidates": {name: _plain(one) for name, one in errors.items()},
        "outputs": {"report": report, "mcap": args.mcap},
    }


def _candidates(args: argparse.Namespace, bench: Bench) -> list[_Candidate]:
    found = [_Candidate("nominal", ServoValues(**bench.nominal), args.model.name)]
    for path in args.with_model:
        found.append(_of_model(_name(path, found), path, bench))
    for path in args.fit:
        found.append(_of_fit(_name(path, found), path, bench))
    for path in args.bam:
        found.append(_of_bam(_name(path, found), path, bench))
    return found


def _name(path: Path, taken: Sequence[_Candidate]) -> str:
    """The file's name, with its folder where another candidate has the same."""
    return str(path) if path.name in {one.name for one in taken} else path.name


def _file(path: Path) -> str:
    """A file as it was given; of an absolute path the name, for a page is no map of a machine."""
    return path.name if path.is_absolute() else str(path)


def _of_model(name: str, path: Path, bench: Bench) -> _Candidate:
    """What a model of the robot does on the bench, with its friction law where it carries one.

    Zero offsets and unpowered damping have no place in such a model; they stand in the fit beside it. Effects stay
    off, as in the check of what was published.
    """
    model = load_model(path)
    fields = {**bench.nominal, **{one: read(model, f"{bench.servo.name}.{one}") for one in SERVO_FIELDS}}
    zeros: Mapping[str, float] = {}
    beside = path.parent / "fits" / f"{bench.servo.name}.json"
    if beside.is_file():
        fitted = _of_fit(name, beside, bench)
        fields |= {"offset": fitted.values.offset, "damping_off": fitted.values.damping_off}
        zeros = fitted.zeros
    friction = law(model, bench.servo.name)
    if friction is not None:
        fields |= _law_fields(friction)
    stated = number(model, "servo_supply_voltage"), number(model, "servo_firmware_gain")
    return _Candidate(name, _restated(ServoValues(**fields), *stated, bench, path), _file(path), zeros)


def _of_fit(name: str, path: Path, bench: Bench) -> _Candidate:
    """The numbers of a fit file, those of its law and effects included."""
    stored = stored_fit.load(path)
    if stored.servo != bench.servo.name:
        raise UsageError(f"{path} is a fit of {stored.servo}, the logs are of {bench.servo.name}")
    # A rig's own text may hold dots: only the first one parts owner and field.
    numbers = {one.partition(".")[2]: float(content["value"]) for one, content in stored.parameters.items()}
    fields = {**bench.nominal, **{one: value for one, value in numbers.items() if one in FIELDS}}
    # Beside a sag, kp and torque limit are those of the unloaded supply.
    fields["rest"] = float("sag" in numbers)
    if stored.law is not None:
        # The law holds all coefficients, those too that only follow another one (M3, M4).
        fields |= _law_fields(stored.law)
    zeros = {
        one.removeprefix(_RIG_OFFSET).removesuffix("]"): value
        for one, value in numbers.items()
        if one.startswith(_RIG_OFFSET)
    }
    stated = stored.stated["supply_voltage"], stored.stated["firmware_gain"]
    return _Candidate(name, _restated(ServoValues(**fields), *stated, bench, path), _file(path), zeros)


def _of_bam(name: str, path: Path, bench: Bench) -> _Candidate:
    """The servo of a BAM parameter file at the bench's supply and gain; commands act at once, as in BAM."""
    found = bam_parameters.read(path, bench.servo)
    if found.actuator != bam_parameters.ACTUATORS.get(bench.servo.name):
        raise UsageError(f"{path} is of {found.actuator}, the logs are of {bench.servo.name}")
    one = found.servo
    values = ServoValues(
        kp=one.kp(),
        forcerange=one.force_limit(),
        damping=one.damping(),
        armature=one.armature,
        delay=0.0,
        offset=found.offset,
        goal_speed=NO_LIMIT if found.goal_speed is None else found.goal_speed,
        **_law_fields(one.friction),
    )
    return _Candidate(name, values, _file(path))


def _law_fields(friction: Friction) -> dict[str, float]:
    shared = {name: float(getattr(friction, name)) for name in FRICTION_FIELDS if name != "coulomb"}
    return {**shared, "damping_off": friction.viscous, "frictionloss": friction.coulomb}


def _restated(values: ServoValues, supply: float, gain: float, bench: Bench, path: Path) -> ServoValues:
    """Gain and torque limit, stated at some supply and firmware gain, at those of the bench."""
    if not (supply > 0.0 and gain > 0.0):
        raise ModelError(f"{path}: states its gain at {supply:g} V and firmware gain {gain:g}; both must be above 0")
    volts, gains = bench.servo.supply_voltage / supply, bench.servo.firmware_gain / gain
    return replace(values, kp=values.kp * volts * gains, forcerange=values.forcerange * volts)


def _offsets(candidates: Sequence[_Candidate], runs: Sequence[BenchRun]) -> FloatArray:
    """Zero of every run's rig beside the candidate's own [rad], (candidates, runs); 0 for a rig it does not know."""
    return np.array([[one.zeros.get(run.rig, 0.0) for run in runs] for one in candidates])


def _plain(one: Misfit) -> dict[str, Any]:
    return {"mae_rad": one.mae_rad, "rmse_rad": one.rmse_rad, "by_log": one.by_run}


def _show(errors: dict[str, Misfit]) -> None:
    table = Table()
    for heading in ("", "mean error, mrad", "rms, mrad", "worst run, mrad"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, one in errors.items():
        worst = max(one.by_run, key=lambda run: one.by_run[run])
        table.add_row(
            name, f"{one.mae_rad * 1e3:.2f}", f"{one.rmse_rad * 1e3:.2f}", f"{one.by_run[worst] * 1e3:.1f} ({worst})"
        )
    people_console().print(table)

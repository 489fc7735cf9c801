"""`frasa-sysid compare`: simulated against measured, for models and fits side by side."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from frasa_sysid import fit_file
from frasa_sysid.calibration import SERVO_FIELDS, add_json_flag, calibration_id, load_model, read
from frasa_sysid.commands.bench import Bench, add_bench_arguments, bench_model, load_bench, people_console
from frasa_sysid.cost import Misfit, misfit
from frasa_sysid.errors import UsageError
from frasa_sysid.report import Trace, write_trace_report
from frasa_sysid.rollout import ServoValues

SCHEMA = "frasa.compare/1"


@dataclass(frozen=True)
class _Candidate:
    name: str
    values: ServoValues


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `compare` to the command line."""
    parser = subparsers.add_parser(
        "compare",
        help="simulated against measured, for models and fits",
        description="Simulate bench logs with the nominal model and with any fits and models, and print the errors.",
    )
    add_bench_arguments(parser)
    parser.add_argument("--fit", type=Path, action="append", default=[], help="a fit file; may be repeated")
    parser.add_argument(
        "--with-model", type=Path, action="append", default=[], metavar="M", help="a calibrated model; may be repeated"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write the traces to a page")
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
    bench = load_bench(args)
    candidates = _candidates(args, bench)
    with bench.simulator(bench_model(args), args.threads) as simulator:
        runs, _ = bench.runs(simulator)
        readings = simulator.simulate(runs, [one.values for one in candidates])
    errors = {one.name: misfit(runs, found) for one, found in zip(candidates, readings, strict=True)}
    _show(errors)
    report = None
    if args.report is not None:
        names = [one.name for one in candidates]
        traces = [
            Trace(run, {name: found[i] for name, found in zip(names, readings, strict=True)})
            for i, run in enumerate(runs)
        ]
        report = write_trace_report(args.report, f"{bench.servo.name}: simulated over measured", traces)
    last = errors[candidates[-1].name]
    return {
        "schema": SCHEMA,
        "servo": bench.servo.name,
        "misfit": _plain(last),
        "candidates": {name: _plain(one) for name, one in errors.items()},
        "outputs": {"report": report},
    }


def _candidates(args: argparse.Namespace, bench: Bench) -> list[_Candidate]:
    nominal = dict(bench.nominal)
    found = [_Candidate("nominal", ServoValues(**nominal))]
    for path in args.with_model:
        model = load_model(path)
        fields = {field: read(model, f"{bench.servo.name}.{field}") for field in SERVO_FIELDS}
        values = ServoValues(**{**nominal, **_bench_facts(path, bench), **fields})
        found.append(_Candidate(_name(path, found), values))
    for path in args.fit:
        found.append(_Candidate(_name(path, found), ServoValues(**{**nominal, **_fields(path, bench)})))
    return found


def _name(path: Path, taken: Sequence[_Candidate]) -> str:
    """The file's name, with its folder where another candidate has the same."""
    return str(path) if path.name in {one.name for one in taken} else path.name


def _bench_facts(model_path: Path, bench: Bench) -> dict[str, float]:
    """Offset and unpowered damping have no place in a robot's model; they stand in the fit beside it."""
    path = model_path.parent / "fits" / f"{bench.servo.name}.json"
    if not path.is_file():
        return {}
    return {name: value for name, value in _fields(path, bench).items() if name in ("offset", "damping_off")}


def _fields(path: Path, bench: Bench) -> dict[str, float]:
    stored = fit_file.load(path)
    if stored.servo != bench.servo.name:
        raise UsageError(f"{path} is a fit of {stored.servo}, the logs are of {bench.servo.name}")
    return {name.rpartition(".")[2]: one["value"] for name, one in stored.parameters.items()}


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

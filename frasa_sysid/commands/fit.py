"""`frasa-sysid fit`: servo logs to numbers with intervals and verdicts, and, with --publish, into the model."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from frasa_sysid import fit_file
from frasa_sysid.calibration import SERVO_FIELDS, add_json_flag, load_model, read, say, servo_classes
from frasa_sysid.commands.bench import Bench, add_bench_arguments, bench_model, load_bench, people_console
from frasa_sysid.commands.publish import publish_files
from frasa_sysid.errors import InterruptedRunError, UsageError
from frasa_sysid.fit import EVALUATIONS_PER_PARAMETER, FitResult, fit, simulated
from frasa_sysid.problem import FitProblem, free_parameters
from frasa_sysid.publish import check_replay, find_fits
from frasa_sysid.report import write_fit_report
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.search import Stop


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `fit` to the command line."""
    parser = subparsers.add_parser(
        "fit",
        help="servo logs to numbers with intervals and verdicts",
        description="Fit damping, friction loss, armature, gain, force limit, delay and zero offset of a servo to "
        "bench logs with CMA-ES and a least-squares finisher.",
    )
    add_bench_arguments(parser)
    parser.add_argument("--friction", choices=("m1",), default="m1", help="friction law: m1, Coulomb-viscous")
    parser.add_argument(
        "--hold-out",
        default="none",
        metavar="RULE",
        help="none; kp=24, mass=0.969, length=0.1, trajectory=NAME; or kp, rig, trajectory for the last of each",
    )
    parser.add_argument("--optimizer", choices=("cmaes+lsq", "cmaes"), default="cmaes+lsq", help="[%(default)s]")
    parser.add_argument("--evaluations", type=int, metavar="N", help="search budget [60 per parameter]")
    parser.add_argument("--seed", type=int, default=0, help="of the search [%(default)s]")
    parser.add_argument("--out", type=Path, metavar="FIT", help="fit file [fits/SERVO.json beside --model]")
    parser.add_argument("--publish", action="store_true", help="write calibrated.xml and randomization.yaml")
    parser.add_argument("--no-report", action="store_true", help="leave out the HTML page")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Fit, save, report, and publish when asked.

    Raises:
        LogError, UsageError, ModelError: bad input.
        QualityError: the published model does not replay the fit.
        InterruptedRunError: Ctrl-C; the best so far was saved.
    """
    if args.evaluations is not None and args.evaluations < 1:
        raise UsageError(f"--evaluations {args.evaluations}: expected 1 or more")
    if not 0 <= args.seed < 2**32:
        raise UsageError(f"--seed {args.seed}: expected 0 to 2^32 - 1")
    bench = load_bench(args, args.hold_out)
    out = args.out or args.model.parent / "fits" / f"{bench.servo.name}.json"
    if out.suffix != ".json":
        raise UsageError(f"--out {out}: expected a name that ends in .json")
    if args.publish:
        _check_publishable(args, bench, out)
    with bench.simulator(bench_model(args), args.threads) as simulator:
        problem = _problem(args, bench, simulator)
        result = _fit_with_progress(args, problem, simulator, bench, out)
        data = fit_file.to_json(result, bench.origin)
        outputs: dict[str, Any] = {"fit": out, "model": None, "ranges": None, "report": None}
        fit_file.save(out, {key: value for key, value in data.items() if key != "seconds"})
        if result.stop is not Stop.INTERRUPTED:
            _partial(out).unlink(missing_ok=True)
        show(result)
        if not args.no_report:
            outputs["report"] = write_fit_report(out.with_suffix(".html"), result, simulator)
        if result.stop is Stop.INTERRUPTED:
            raise InterruptedRunError(
                f"interrupted; the best of {result.evaluations} evaluations is in {out}, the same command goes on"
            )
        if args.publish:
            outputs["model"], outputs["ranges"] = _publish(args, out, result, simulator)
    _tell_outputs(outputs)
    return {**data, "outputs": outputs}


def _problem(args: argparse.Namespace, bench: Bench, simulator: BenchSimulator) -> FitProblem:
    train, held_out = bench.runs(simulator)
    free = free_parameters(bench.servo, bench.nominal, train, simulator.delay_range)
    return FitProblem(bench.servo, bench.nominal, free, tuple(train), tuple(held_out), args.hold_out, args.seed)


def _fit_with_progress(
    args: argparse.Namespace, problem: FitProblem, simulator: BenchSimulator, bench: Bench, out: Path
) -> FitResult:
    budget = args.evaluations or EVALUATIONS_PER_PARAMETER * len(problem.free)
    console = people_console()
    name = f"{problem.servo.name}: {len(problem.train)} runs, {len(problem.free)} parameters"
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=budget, best="")

        def tell(stage: str, count: int, best: float) -> None:
            text = f"{count} evaluations, best {best * 1e3:.2f} mrad"
            progress.update(task, completed=min(count, budget), description=f"{name}, {stage}", best=text)

        return fit(problem, simulator, bench.inputs, args.evaluations, args.optimizer, _partial(out), tell)


def _partial(out: Path) -> Path:
    return out.with_suffix(".partial.json")


def _check_publishable(args: argparse.Namespace, bench: Bench, out: Path) -> None:
    """Say at once, not after the fit, that its result has no place in the model."""
    if bench.servo.name not in servo_classes(load_model(args.model)):
        raise UsageError(
            f"--publish: {args.model} has no servo class '{bench.servo.name}', it has "
            f"{', '.join(servo_classes(load_model(args.model))) or 'none'}"
        )
    if out.parent.resolve() != (args.model.parent / "fits").resolve():
        raise UsageError(f"--publish takes every fit of {args.model.parent / 'fits'}; --out {out} is elsewhere")
    for path in sorted(out.parent.glob("*.json")):
        if path.name == out.name or path.name.endswith(".partial.json"):
            continue
        if fit_file.load(path).servo == bench.servo.name:
            raise UsageError(f"--publish: {path} is a fit of {bench.servo.name} too; remove it, or give --out {path}")


def _publish(args: argparse.Namespace, out: Path, result: FitResult, simulator: BenchSimulator) -> tuple[Path, Path]:
    model_path = args.model.with_name("calibrated.xml")
    servo = result.problem.servo.name

    def check(model: mujoco.MjModel) -> None:
        published = replace(
            result.problem.servo_values(result.values),
            **{field: read(model, f"{servo}.{field}") for field in SERVO_FIELDS},
        )
        runs = [*result.problem.train, *result.problem.held_out]
        worst = check_replay(simulated(result, simulator, runs), simulator.simulate(runs, [published])[0])
        say(f"{model_path} replays the {len(runs)} runs within {worst * 1e3:.2g} mrad of the fit")

    fits = [fit_file.load(path) for path in find_fits(out.parent)]
    return model_path, publish_files(fits, args.model, model_path, check)


def show(result: FitResult) -> None:
    """Print what was found, for people."""
    console = people_console()
    table = Table(title=f"{result.problem.servo.name}, friction law {result.friction}", title_justify="left")
    for heading in ("parameter", "nominal", "fitted", "95 % interval", "unit", "verdict"):
        table.add_column(heading, justify="right" if heading in ("nominal", "fitted", "95 % interval") else "left")
    for one in result.evidence.estimates:
        colour = "green" if one.verdict == "identified" else "yellow"
        interval = f"{one.low:.4g} .. {one.high:.4g}"
        verdict = f"[{colour}]{one.verdict}[/{colour}]"
        table.add_row(one.name, f"{one.nominal:.4g}", f"{one.value:.4g}", interval, one.unit, verdict)
    console.print(table)
    for one in result.evidence.estimates:
        if one.advice:
            console.print(f"  {one.name} is {one.verdict}: {one.advice}")
    errors = f"mean error {result.nominal.mae_rad * 1e3:.2f} mrad nominal, {result.fitted.mae_rad * 1e3:.2f} fitted"
    if result.problem.held_out:
        errors += (
            f"; on {len(result.problem.held_out)} held-out runs {result.held_out_nominal.mae_rad * 1e3:.2f} nominal, "
            f"{result.held_out.mae_rad * 1e3:.2f} fitted"
        )
    console.print(errors)
    console.print(
        f"{result.evaluations} evaluations, {result.seconds:.1f} s, seed {result.problem.seed}; {result.stop.value}"
    )


def _tell_outputs(outputs: dict[str, Any]) -> None:
    for name, path in outputs.items():
        if path is not None:
            say(f"{name}: {path}")

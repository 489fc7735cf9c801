"""`frasa-sysid fit`: servo logs to numbers with intervals and verdicts, and, with --publish, into the model."""

import argparse
from pathlib import Path
from typing import Any

import mujoco
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from frasa_sysid import published_as
from frasa_sysid.bench import Bench
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.bootstrap import full_bootstrap
from frasa_sysid.calibration import add_json_flag, alone, input_hashes, load_model, say, servo_classes
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.choice import Choice, choose
from frasa_sysid.claims import settle
from frasa_sysid.commands.bench import add_bench_arguments, bench_model, load_bench, people_console, read_logs
from frasa_sysid.commands.bench_checks import check_bench
from frasa_sysid.commands.fit_options import add_bench_options
from frasa_sysid.commands.fit_robot import add_robot_arguments, fit_robot_logs
from frasa_sysid.commands.fit_show import show
from frasa_sysid.commands.log_kinds import refuse_other_kind
from frasa_sysid.commands.publish import add_as_flag, load_fits, publish_files
from frasa_sysid.effects import EFFECTS
from frasa_sysid.errors import CalibrationError, InterruptedRunError, UsageError
from frasa_sysid.fit import FitResult, fit
from frasa_sysid.fit_json import read_json
from frasa_sysid.fit_record import Extras, log_facts, save, to_json
from frasa_sysid.identifiability import bench_findings, next_logs
from frasa_sysid.pieces import count_of
from frasa_sysid.publish import PATIENCE_S, find_fits
from frasa_sysid.published_place import check_ranges_free
from frasa_sysid.readout import LONGEST_AGE, disagreement, separate
from frasa_sysid.replay import replay
from frasa_sysid.report import write_fit_report
from frasa_sysid.restarts import Tell
from frasa_sysid.robot_rig import is_robot
from frasa_sysid.search import Stop
from frasa_sysid.spread import Spread, spread_over
from frasa_sysid.stand_in import stand_in


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `fit` to the command line."""
    parser = subparsers.add_parser(
        "fit",
        help="servo logs to numbers with intervals and verdicts",
        description="Fit damping, friction loss, armature, gain, force limit, delay and zero offset of a servo to "
        "bench logs with CMA-ES and a least-squares finisher.",
    )
    add_bench_options(add_bench_arguments(parser))
    parser.add_argument("--seed", type=int, default=0, help="of the search [%(default)s]")
    parser.add_argument("--out", type=Path, metavar="FIT", help="fit file [fits/SERVO.json beside --model]")
    parser.add_argument("--publish", action="store_true", help="write calibrated.xml and randomization.yaml")
    add_as_flag(parser)
    add_robot_arguments(parser)
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
    effects = _checked(args)
    recordings = read_logs(args)
    refuse_other_kind(args, recordings)
    if any(is_robot(one) for one in recordings):
        return fit_robot_logs(args, recordings)
    bench = load_bench(args, args.hold_out, recordings)
    out = args.out or args.model.parent / "fits" / f"{bench.servo.name}.json"
    if out.suffix != ".json":
        raise UsageError(f"--out {out}: expected a name that ends in .json")
    if args.publish:
        _check_publishable(args, bench, out)
    check_bench(people_console(), [*bench.train, *bench.held_out])
    with alone(out):
        return _run_bench(args, bench, effects, out)


def _run_bench(args: argparse.Namespace, bench: Bench, effects: tuple[str, ...] | None, out: Path) -> dict[str, Any]:
    """The fit of a bench, with nobody else writing the same file."""
    with (
        bench.session(bench_model(args), args.threads, args.timestep) as session,
        spread_over(args.jobs, args.cluster) as spread,
    ):
        if args.publish and not session.publishable:
            raise UsageError("--publish needs the bench model's own step: leave --timestep out")
        result, extras = _fit_with_progress(args, bench, session, spread, out, effects)
        data = {**to_json(result, extras), "models": input_hashes((args.model, bench_model(args)))}
        outputs: dict[str, Any] = {"fit": out, "model": None, "ranges": None, "report": None}
        save(out, {key: value for key, value in data.items() if key != "seconds"})
        if result.stop is not Stop.INTERRUPTED:
            _partial(out).unlink(missing_ok=True)
        show(result, extras)
        if not args.no_report:
            beforehand = next_logs(bench_findings([*bench.train, *bench.held_out], bench.servo))
            outputs["report"] = write_fit_report(out.with_suffix(".html"), result, extras, session, beforehand)
        if result.stop is Stop.INTERRUPTED:
            raise InterruptedRunError(
                f"interrupted; the best of {result.evaluations} evaluations is in {out}, the same command goes on"
            )
        if args.publish:
            outputs["model"], outputs["ranges"] = _publish(args, out, result, extras, session)
    _tell_outputs(outputs)
    return {**data, "outputs": outputs}


def _checked(args: argparse.Namespace) -> tuple[str, ...] | None:
    """The effects asked for, None to choose them; and no argument out of range.

    Raises:
        UsageError: what is wrong.
    """
    for name, least in (("evaluations", 1), ("restarts", 1), ("bootstrap", 0)):
        value = getattr(args, name)
        if value is not None and value < least:
            raise UsageError(f"--{name} {value}: expected {least} or more")
    for name in ("first", "shooting", "timestep"):
        value = getattr(args, name)
        if value is not None and not 0.0 < value < 1e6:
            raise UsageError(f"--{name} {value:g}: expected seconds above 0")
    if args.timestep is not None and not 5e-5 <= args.timestep <= 0.02:
        raise UsageError(f"--timestep {args.timestep:g}: expected 0.00005 to 0.02 s")
    if args.duty_age is not None and not abs(args.duty_age) <= LONGEST_AGE:
        raise UsageError(f"--duty-age {args.duty_age:g}: expected seconds, {LONGEST_AGE:g} at most")
    if not 0 <= args.seed < 2**32:
        raise UsageError(f"--seed {args.seed}: expected 0 to 2^32 - 1")
    asked = args.effects or ("auto" if args.friction == "auto" else "none")
    if asked in ("auto", "none"):
        return None if asked == "auto" else ()
    effects = tuple(dict.fromkeys(asked.split(",")))
    unknown = [name for name in effects if name not in EFFECTS]
    if unknown:
        raise UsageError(f"--effects {asked}: no effect '{unknown[0]}'; expected none, auto or of {', '.join(EFFECTS)}")
    return effects


def _fit_with_progress(
    args: argparse.Namespace,
    bench: Bench,
    session: BenchSession,
    spread: Spread,
    out: Path,
    effects: tuple[str, ...] | None,
) -> tuple[FitResult, Extras]:
    first_law = LAWS[0] if args.friction == "auto" else args.friction
    problem = bench.problem(session, first_law, effects or (), args.seed, args.first, args.shooting)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())
    with Progress(*columns, console=people_console()) as progress:
        task = progress.add_task(bench.servo.name, total=None, best="")

        def tell(stage: str, count: int, best: float) -> None:
            text = f"{count} evaluations, best {best * 1e3:.2f} mrad"
            progress.update(task, description=f"{bench.servo.name}: {count_of(problem.train)}, {stage}", best=text)

        choice = None
        if args.friction == "auto" or effects is None:
            laws = LAWS if args.friction == "auto" else (args.friction,)
            choice = choose(problem, session, laws, effects, spread, tell)
            problem = choice.problem
        known = () if choice is None else (choice.x,)
        result = fit(
            problem,
            session,
            bench.inputs,
            args.evaluations,
            args.optimizer,
            _partial(out),
            tell,
            args.restarts,
            known,
        )
        return result, _extras(args, bench, session, spread, result, choice, tell)


def _extras(
    args: argparse.Namespace,
    bench: Bench,
    session: BenchSession,
    spread: Spread,
    result: FitResult,
    choice: Choice | None,
    tell: Tell,
) -> Extras:
    recordings = [*bench.train, *bench.held_out]
    facts = log_facts(recordings)
    if bench.servo.supply_compensated:
        facts.pop("supply_voltage", None)  # its numbers do not follow the supply, so there is no range of it to draw
    if result.stop is Stop.INTERRUPTED:
        return Extras(bench.origin, choice, from_logs=facts)
    delays = [one for one in result.evidence.estimates if one.name == f"{bench.servo.name}.delay"]
    # Where no delay is fitted (a known force) there is none to say anything about.
    readout = separate(recordings, args.duty_age) if delays else None
    step = session.options.timestep
    doubt = "".join(disagreement(readout, (one.low, one.high), step) for one in delays if readout is not None)
    resampled = None
    if args.bootstrap:
        tell(f"fitting {args.bootstrap} resampled sets of logs", result.evaluations, result.solved.cost)
        resampled = full_bootstrap(result.problem, session, result.values, args.bootstrap, spread)
    other = None
    if result.friction != "m1":
        tell("M1 in its place", result.evaluations, result.solved.cost)
        other = stand_in(result, session)
    return Extras(bench.origin, choice, other, resampled, args.bootstrap, facts, readout, doubt)


def _partial(out: Path) -> Path:
    return out.with_suffix(".partial.json")


def _check_publishable(args: argparse.Namespace, bench: Bench, out: Path) -> None:
    """Say at once, not after the fit, that its result has no place in the model."""
    if bench.servo.name not in servo_classes(load_model(args.model)):
        raise UsageError(
            f"--publish: {args.model} has no servo class '{bench.servo.name}', it has "
            f"{', '.join(servo_classes(load_model(args.model))) or 'none'}"
        )
    check_ranges_free(args.model.with_name("calibrated.xml"))
    if out.parent.resolve() != (args.model.parent / "fits").resolve():
        raise UsageError(f"--publish takes every fit of {args.model.parent / 'fits'}; --out {out} is elsewhere")
    for path in sorted(out.parent.glob("*.json")):
        if path.name == out.name or path.name.endswith(".partial.json"):
            continue
        if read_json(path)[0].get("servo") == bench.servo.name:
            raise UsageError(f"--publish: {path} is a fit of {bench.servo.name} too; remove it, or give --out {path}")


def _publish(
    args: argparse.Namespace, out: Path, result: FitResult, extras: Extras, session: BenchSession
) -> tuple[Path, Path]:
    model_path = args.model.with_name("calibrated.xml")
    as_m1 = args.as_law == "m1" and extras.stand_in is not None

    def check(model: mujoco.MjModel, path: Path) -> None:
        worst, runs = replay(model, result, extras.stand_in if as_m1 else None, session)
        say(f"{model_path} replays the {runs} runs within {worst * 1e3:.2g} mrad of the fit")

    with alone(model_path, patience_s=PATIENCE_S):  # whoever publishes last has seen the fits of all
        fits, robot = load_fits(find_fits(out.parent))
        try:
            settle([published_as.as_m1(one) for one in fits] if args.as_law == "m1" else fits, robot)
        except CalibrationError as error:
            if robot is None:
                raise
            say(f"the fit of the robot is left out: {error}")
            robot = None
        return model_path, publish_files(fits, args.model, model_path, check, args.as_law, robot)


def _tell_outputs(outputs: dict[str, Any]) -> None:
    for name, path in outputs.items():
        if path is not None:
            say(f"{name}: {path}")

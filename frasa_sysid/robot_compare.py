"""Robots to hold against logs: the nominal model, published models by their own numbers, fits on the nominal model.

A published model is simulated with what stands in it and nothing else: its native delays, its zeros as
reference angles, its friction laws. A fit is simulated as it was fitted: bench fits frozen, its own
numbers on them. That both agree is what the check of a publication looks at.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.calibration import load_model
from frasa_sysid.errors import CalibrationError, InputError, LogError
from frasa_sysid.model_mark import mark_of
from frasa_sysid.recording import Recording
from frasa_sysid.robot_candidate import Candidate, candidate_of
from frasa_sysid.robot_errors import Compared
from frasa_sysid.robot_fit import HALF_STEP, RobotFit, frozen_model
from frasa_sysid.robot_numbers import COMMAND_DELAY, MASS_SCALE
from frasa_sysid.robot_residuals import Comparison
from frasa_sysid.robot_rig import Base, RobotRun, robot_run
from frasa_sysid.robot_simulator import Piece, RobotSimulator, split_pieces
from frasa_sysid.stored_fit import StoredFit
from frasa_sysid.stored_robot_fit import StoredRobotFit

Choose = Callable[[RobotRun, float], Sequence[Piece]]


@dataclass(frozen=True)
class Contender:
    """A robot that is held against logs.

    Attributes:
        name: for tables.
        path: model file.
        candidate: what is not as in that file; delays are physical, see `robot_candidate.candidate_of`.
    """

    name: str
    path: Path
    candidate: Candidate


def of_model(name: str, path: Path) -> Contender:
    """A model by its own numbers.

    Raises:
        ModelError: it cannot be compiled, or lacks servo classes.
    """
    return Contender(name, path, candidate_of(load_model(path)))


def of_bench_fits(name: str, fits: Sequence[StoredFit], nominal: Path, folder: Path) -> Contender:
    """The nominal model with bench fits applied.

    Args:
        name: for tables.
        fits: of servos.
        nominal: the model they started from.
        folder: an empty one, for the model that they make.
    """
    return of_model(name, frozen_model(nominal, fits, folder))


def of_found(found: RobotFit, frozen: Path) -> list[Contender]:
    """What a fit started from, `before`, and where it ended, `fitted`.

    Args:
        found: the fit.
        frozen: the model that it varied, see `robot_fit.frozen_model`.
    """
    points = {"before": found.problem.start(), "fitted": found.settled.x}
    return [Contender(name, frozen, found.problem.candidate(x)) for name, x in points.items()]


def of_robot_fit(name: str, path: Path, nominal: Path, folder: Path) -> Contender:
    """What a robot fit's file says, on the nominal model and the bench fits that it stood on.

    Args:
        name: for tables.
        path: the fit file; the bench fits are looked for beside it and beside the model.
        nominal: the model it was made with.
        folder: an empty one, for the model with its bench fits.

    Raises:
        InputError: a bench fit is missing.
        CalibrationError: the fit was made with another model.
    """
    stored, model = stored_robot_fit.load(path), load_model(nominal)
    here = mark_of(model).fingerprint
    if stored.model.fingerprint != here:
        raise CalibrationError(
            f"{path} was made with another model: '{stored.model.name}' ({stored.model.fingerprint}); "
            f"{nominal} is {here}"
        )
    frozen = frozen_model(nominal, _frozen(stored, path, nominal), folder)
    with_fits = load_model(frozen)
    return Contender(name, frozen, _candidate(stored, candidate_of(with_fits), float(with_fits.opt.timestep)))


def _frozen(stored: StoredRobotFit, path: Path, nominal: Path) -> list[StoredFit]:
    places = dict.fromkeys((path.parent, nominal.parent / "fits"))
    found: dict[str, StoredFit] = {}
    for one in (one for place in places for one in sorted(place.glob("*.json"))):
        try:
            bench = stored_fit.load(one)
        except InputError:
            continue  # a fit of a robot, or no fit
        found.setdefault(bench.sha256, bench)
    missing = [one for one in stored.frozen if one not in found]
    if missing:
        raise InputError(
            f"{path} stood on the bench fit {missing[0][:12]}, which is neither in {path.parent} nor in "
            f"{nominal.parent / 'fits'}; put it there"
        )
    return [found[one] for one in stored.frozen]


def _candidate(stored: StoredRobotFit, own: Candidate, timestep: float) -> Candidate:
    numbers = {name: float(one["value"]) for name, one in stored.parameters.items()}
    physical = {name: value - HALF_STEP.get(name, 0.0) * timestep for name, value in numbers.items()}
    ages = {name: physical.get(f"sensor.{name}_delay", age) for name, age in own.ages.items()}
    shift = [numbers.get(f"trunk.com_shift_{axis}", 0.0) for axis in "xyz"]
    scales = {
        field: {name.rpartition(".")[0]: value for name, value in numbers.items() if name.endswith(f".{field}")}
        for field in ("zero", "gain_scale", "damping_scale", "friction_scale")
    }
    return replace(
        own,
        command_delay=physical.get(COMMAND_DELAY, 0.0),
        command_delays={} if COMMAND_DELAY in numbers else own.command_delays,
        zeros=scales["zero"],
        gain=scales["gain_scale"],
        damping=scales["damping_scale"],
        friction=scales["friction_scale"],
        trunk_mass=numbers["trunk.mass"] if MASS_SCALE in numbers else None,
        trunk_shift=(shift[0], shift[1], shift[2]),
        ages=ages,
    )


def held_from(runs: Sequence[RobotRun], timestep: float, share: float) -> dict[str, float]:
    """By run, when the part begins that a fit with that share held out never saw [s]."""
    left = {run.name: split_pieces(run, timestep, share)[1] for run in runs}
    return {name: pieces[0].begin * timestep for name, pieces in left.items() if pieces}


def last_share(share: float) -> Choose:
    """The pieces that a fit with that share held out never saw; all of them for 0."""

    def choose(run: RobotRun, timestep: float) -> list[Piece]:
        kept, left = split_pieces(run, timestep, share)
        if share and not left:
            raise LogError(f"{run.name}: {run.steps * timestep:.1f} s; too short for a share of {share:g} held out")
        return left if share else kept

    return choose


def compare_robot(
    one: Contender,
    recordings: Sequence[Recording],
    base: Base | None,
    choose: Choose,
    threads: int | None = None,
) -> list[Compared]:
    """Simulate a robot over logs: one result for each kind of base.

    Args:
        one: the robot.
        recordings: to hold it against.
        base: where a log does not say.
        choose: pieces of a run, given the physics step [s], see `last_share`.
        threads: by default one per core.

    Raises:
        LogError, UsageError: bad input.
    """
    model = load_model(one.path)
    return compare_runs(one, [robot_run(recording, model, base) for recording in recordings], choose, threads)


def compare_runs(
    one: Contender, runs: Sequence[RobotRun], choose: Choose, threads: int | None = None
) -> list[Compared]:
    """The same for runs that were made ready already, for a model of that robot with its physics step."""
    found = []
    for kind in dict.fromkeys(run.base for run in runs):
        with RobotSimulator(one.path, kind, threads) as simulator:
            pieces = [piece for run in runs if run.base == kind for piece in choose(run, simulator.timestep)]
            comparison = Comparison(simulator, pieces)
            residuals = comparison.residuals([one.candidate], one.candidate)[0]
            found.append(Compared(comparison.layout, comparison.samples(), residuals))
    return found

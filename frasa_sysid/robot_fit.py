"""A fit of the whole robot: frozen bench fits applied, delays, zeros and scales found, and what is known of each.

Delays here are physical. A MuJoCo model of step h acts on a command half a step early and its speeds are
half a step old already, so in the model a command delay is h/2 longer and the delay of a velocity or a
gyro h/2 shorter; those numbers are published.
"""

import copy
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from frasa_sysid.calibration import load_model, read, servo_classes, write_atomic
from frasa_sysid.publish import publish
from frasa_sysid.recording import FloatArray, Recording
from frasa_sysid.robot_candidate import candidate_of
from frasa_sysid.robot_fit_record import RobotEstimate
from frasa_sysid.robot_numbers import COMMAND_DELAY
from frasa_sysid.robot_problem import FreeNumber, RobotProblem, state_robot_problem
from frasa_sysid.robot_residuals import Comparison
from frasa_sysid.robot_rig import Base, RobotRun, robot_run
from frasa_sysid.robot_simulator import RobotSimulator, split_pieces
from frasa_sysid.robot_solve import Settled, Tell, covariance_of, settle_robot
from frasa_sysid.robot_stack import Stack
from frasa_sysid.robot_stance import level_zeros
from frasa_sysid.robot_trail import Trail
from frasa_sysid.stored_fit import StoredFit

ALL, ROUGHLY = "all pieces", "some pieces"  # searches of a fit
COARSE = 3  # of so many pieces on the ground, one leads the first steps
_SILENT = 0.7  # of the prior's width that an interval must stay below to say anything
_TOGETHER = 0.95  # correlation beyond which only a combination is known
# [steps] that a model's delay is longer than the physical one
HALF_STEP = {COMMAND_DELAY: 0.5, "sensor.velocity_delay": -0.5, "sensor.gyro_delay": -0.5}

RECORD = {
    "command.delay": "quick changes of the goals (frasa-sysid excite), at 100 Hz or more",
    "sensor.velocity_delay": "quick motion (frasa-sysid excite), velocities at 100 Hz or more",
    "sensor.gyro_delay": "the robot on the ground, leaning and squatting quickly (--base floating)",
    "sensor.orientation_delay": "the robot on the ground, leaning and squatting quickly (--base floating)",
    "zero": "the robot held face down as well as upright (frasa-sysid excite), or standing with its IMU",
    "gain_scale": "loads held at the horizontal, and quick motion (frasa-sysid excite)",
    "damping_scale": "quick motion (frasa-sysid excite)",
    "friction_scale": "slow motion with reversals (frasa-sysid excite)",
    "mass_scale": "the robot on the ground, squatting and leaning (--base floating)",
    "com_shift": "the robot on the ground, leaning to all sides (--base floating)",
}


@dataclass(frozen=True)
class RobotFit:
    """Everything a robot fit found.

    Attributes:
        problem: what was asked.
        settled: where it ended.
        logged: covariance by the logs alone, (n, n): which numbers they cannot tell apart.
        covariance: with what the model gets wrong, (n, n).
        half: half-widths of 95 % intervals, (n,).
        errors: by `nominal`, `fitted` and `held_out`, by channel: mean absolute and root mean square error.
        timestep: of the model [s].
        seconds: wall clock.
    """

    problem: RobotProblem
    settled: Settled
    logged: FloatArray
    covariance: FloatArray
    half: FloatArray
    errors: dict[str, dict[str, tuple[float, float]]]
    timestep: float
    seconds: float

    def estimates(self) -> tuple[RobotEstimate, ...]:
        """Every free number as the model takes it, with interval, verdict and what to record next."""
        sd = np.sqrt(np.diag(self.logged))
        correlation = np.abs(self.logged / np.outer(sd, sd)) - np.eye(sd.size)
        found = []
        for i, (free, value, half) in enumerate(zip(self.problem.free, self.settled.x, self.half, strict=True)):
            partner = self.problem.free[int(np.argmax(correlation[i]))].name
            verdict = _verdict(free, float(value), float(half), float(correlation[i].max()), partner)
            shift = HALF_STEP.get(free.name, 0.0) * self.timestep
            # What a zero or a shift is cannot be bounded by what a delay or a scale must be.
            low, high = max(value - half, free.kind.low), min(value + half, free.kind.high)
            least = 0.0 if free.kind.low >= 0.0 else -np.inf
            value, low, high = (max(float(one) + shift, least) for one in (value, low, high))
            advice = "" if verdict == "identified" else f"record {_advice(free.name)}"
            found.append(RobotEstimate(free.name, value, low, high, verdict, free.start + shift, None, None, advice))
        return tuple(found)


def frozen_model(nominal: Path, fits: Sequence[StoredFit], folder: Path) -> Path:
    """The nominal model with bench fits applied, as a file; the nominal one itself without any.

    Args:
        nominal: the model file.
        fits: of servos.
        folder: where to write it.
    """
    if not fits:
        return nominal
    path = folder / "frozen.xml"
    write_atomic(path, publish(fits, nominal, path).xml)
    return path


def fit_robot(
    nominal: Path,
    fits: Sequence[StoredFit],
    recordings: Sequence[Recording],
    base: Base | None = None,
    groups: Sequence[str] | None = None,
    position_delay: float = 0.0,
    hold_out: float = 0.0,
    threads: int | None = None,
    seed: int = 0,
    tell: Tell = lambda stage, count, best: None,
    trail: Trail | None = None,
) -> RobotFit:
    """Fit a robot's logs.

    Args:
        nominal: the robot's model.
        fits: frozen bench fits, applied to it.
        recordings: of that robot, held or on the ground.
        base: where a log does not say.
        groups: what is free, of `robot_problem.GROUPS`; by default `default_groups`.
        position_delay: age of a position at its stamp [s]; only its sum with the command delay shows.
        hold_out: share of every recording, its end, that is not fitted but only compared.
        threads: by default one per core.
        seed: for the record.
        tell: told (stage, robots simulated, cost).
        trail: of an earlier run of the very same fit, to go on from to the same result; and of this one.

    Raises:
        LogError, ModelError, UsageError: bad input.
    """
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = frozen_model(nominal, fits, Path(folder))
        model = load_model(path)
        runs = [robot_run(one, model, base) for one in recordings]
        bases: list[Base] = sorted({run.base for run in runs})
        simulators = {one: stack.enter_context(RobotSimulator(path, one, threads)) for one in bases}
        trunk = simulators[bases[0]].model.body_mass[simulators[bases[0]].trunk]
        delays = model_delays(model, position_delay)
        own = candidate_of(model).command_delays
        problem = state_robot_problem(runs, servo_classes(model), delays, float(trunk), groups, seed, own)
        fitted, held = _comparisons(simulators, runs, hold_out)
        trail, start, rough = trail or Trail(), None, "floating" in simulators
        if rough and not trail.reached(ALL):
            start = _roughly(problem, fitted, tell, trail)
        settled = settle_robot(problem, Stack(fitted), start, tell, trail, ALL, near=rough)
        logged, covariance, half = covariance_of(problem, settled.linear)
        points = {"nominal": problem.start(), "fitted": settled.x}
        errors = {name: _errors(problem, fitted, x) for name, x in points.items()}
        if held:
            errors |= {f"held_out_{name}": _errors(problem, held, x) for name, x in points.items()}
        timestep = float(model.opt.timestep)
    return RobotFit(problem, settled, logged, covariance, half, errors, timestep, time.monotonic() - began)


def model_delays(model: mujoco.MjModel, position_delay: float) -> dict[str, float]:
    """Physical delays that a model has before the fit [s], by channel, and that of commands."""
    half = 0.5 * float(model.opt.timestep)
    command = max(read(model, f"{servo_classes(model)[0]}.delay") - half, 0.0)
    found = {name: read(model, f"sensor.{name}_delay") for name in ("velocity", "gyro", "orientation")}
    found = {name: value + (half if name != "orientation" else 0.0) for name, value in found.items()}
    return {**found, "position": position_delay, "command": command}


def _comparisons(
    simulators: dict[Base, RobotSimulator], runs: Sequence[RobotRun], hold_out: float
) -> tuple[list[Comparison], list[Comparison]]:
    fitted, held = [], []
    for base, simulator in simulators.items():
        kept, left = [], []
        for run in (one for one in runs if one.base == base):
            first, last = split_pieces(run, simulator.timestep, hold_out)
            kept += first
            left += last
        fitted.append(Comparison(simulator, kept))
        held += [Comparison(simulator, left)] if left else []
    return fitted, held


def _roughly(problem: RobotProblem, comparisons: Sequence[Comparison], tell: Tell, trail: Trail) -> FloatArray:
    """Where flat feet, then a part of the pieces lead, (n,): most of the way, at a part of the price of contacts."""
    x = problem.start()
    for one in comparisons:
        run = one.pieces[0].run
        if run.base == "floating":
            here = one.simulator
            zeros = level_zeros(copy.copy(here.model), here.writer, here.trunk, run, problem.ages)
            x = np.array([zeros.get(q.name.removesuffix(".zero"), v) for q, v in zip(problem.free, x, strict=True)])
    some = [Comparison(one.simulator, one.pieces[::COARSE]) for one in comparisons]
    return settle_robot(problem, Stack(some), x, tell, trail, ROUGHLY, weigh=False).x


def _errors(problem: RobotProblem, comparisons: Sequence[Comparison], x: FloatArray) -> dict[str, tuple[float, float]]:
    """Mean absolute and root mean square error by channel, in the channel's unit."""
    stack = Stack(comparisons)
    residuals = stack.raw(problem, x[None], x)[0]
    channels = np.array([name.split()[1] for name in stack.layout.names])[stack.layout.column]
    found = {}
    for name in dict.fromkeys(channels.tolist()):
        part = residuals[channels == name]
        found[name] = (float(np.mean(np.abs(part))), float(np.sqrt(np.mean(part**2))))
    return found


def _verdict(free: FreeNumber, value: float, half: float, strongest: float, partner: str) -> str:
    vague = half > _SILENT * 1.96 * free.kind.prior
    if strongest > _TOGETHER and half > free.kind.fine:
        return f"only in combination with {partner}"
    if vague:
        return "not excited"
    if min(value - free.kind.low, free.kind.high - value) < 1e-3 * (free.kind.high - free.kind.low):
        return "on its bound"
    return "identified" if half <= free.kind.fine else "known roughly"


def _advice(name: str) -> str:
    field = name.rpartition(".")[2]
    return RECORD.get(name) or RECORD["com_shift" if field.startswith("com_shift") else field]

"""Logs that diverge in open loop, fitted in pieces whose starts are free."""

import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.evidence import IDENTIFIED, ROUGH, evidence
from frasa_sysid.fit import fit
from frasa_sysid.pieces import segments
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.rig import BenchRun
from frasa_sysid.shooting import shoot, without_starts

STEP = 0.001  # [s] of the fit
FINE = 5e-5  # [s] of the truth
MASS, FRICTION, DAMPING = 0.05, 0.02, 0.12  # [kg m^2], [N m], [N m s/rad]
NOISE = 5e-4  # [rad]
BIAS = -0.01  # [N m] what the force sensor says too much
PIECE = 0.3  # [s]
TRUTH = {"armature": MASS, "damping": DAMPING, "frictionloss": FRICTION, "bias": BIAS}


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def measured(seed, gravity, seconds=6.0):
    """A force-driven joint under a position loop of its own; with `gravity` [N m] it stands on its head.

    Only force and angle are logged, so a fit replays the force in open loop: what the sensor says too much
    drives a double integrator away, and upside down it falls.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds / STEP)
    at = np.arange(count + 1) * STEP
    wanted = 0.5 * np.sin(2.0 * at + seed) + 0.3 * np.sin((5.0 + seed) * at)
    q, v, angles, forces = wanted[0], 0.0, [], []
    for k in range(count):
        angles.append(q)
        force = 8.0 * (wanted[k] - q) - 0.6 * v
        forces.append(force - BIAS)
        for _ in range(round(STEP / FINE)):
            asked = force + gravity * np.sin(q) - DAMPING * v
            stop = -(MASS * v / FINE + asked)
            v += FINE * (asked + min(max(stop, -FRICTION), FRICTION)) / MASS
            q += FINE * v
    t, y = at[:count], np.array(angles) + rng.normal(0.0, NOISE, count)
    cells = np.minimum(np.floor(t / STEP), count - 1)
    return BenchRun(
        name=f"run {seed}", group=f"{seed}", rig="", trajectory="", inertia=1e-6, gravity_torque=gravity, kp_scale=1.0,
        force_scale=1.0, control="force", command=np.array(forces), lead=0, supply=np.ones(count), switches=np.zeros(0),
        powered_first=True, q0=float(y[0] + np.pi * (gravity > 0.0)), dq0=0.0, t=t, y=y + np.pi * (gravity > 0.0),
        step=cells, weight=t / STEP - cells,
    )  # fmt: skip


@pytest.fixture(scope="module")
def known(robot_model_dir):
    """A servo to be wrong about: a third of the mass, five times the friction."""
    one, nominal = stated_servo("mx106", robot_model_dir / "nominal.xml")
    return one, {**nominal, "armature": 0.03, "frictionloss": 0.1, "damping": 0.3}


@pytest.fixture(scope="module")
def session(robot_model_dir, known):
    with BenchSession(robot_model_dir / "bench_pendulum.xml", known[0], threads=2, timestep=STEP) as one:
        yield one


def problem_of(known, runs):
    return state_problem(*known, runs, (), (0.0, 0.0), effects=("bias",))


def values_of(problem, x):
    return {one.field: float(value) for one, value in zip(problem.free, problem.from_unit(x), strict=True)}


@pytest.mark.parametrize("gravity", [0.0, 1.5])
def test_what_diverges_is_recovered_in_pieces(known, session, gravity):
    runs = [measured(seed, gravity) for seed in (1, 2, 3)]
    whole = problem_of(known, runs)
    # With the true numbers, but for the sensor's error, the replayed force leads a long way from what was measured.
    kernel = session.kernel(runs)
    plain = np.array([{**TRUTH, "bias": 0.0}[one.field] for one in whole.free])
    far = kernel.readings(whole.candidates(whole.to_unit(plain)[None]))[0] - np.concatenate([run.y for run in runs])
    assert np.nanmax(np.abs(far)) > (0.1 if gravity == 0.0 else 1.0)

    pieces = [piece for run in runs for piece in segments(run, PIECE, STEP)]
    problem = problem_of(known, pieces)
    result = fit(problem, session, {}, evaluations=60, restarts=1)
    found = {one.name.partition(".")[2]: one for one in result.evidence.estimates}
    for field, value in TRUTH.items():
        assert found[field].value == pytest.approx(value, rel=0.04), field
        assert found[field].verdict in (IDENTIFIED, ROUGH)
    assert all(run.free_start for run in result.problem.train)
    # What is left is the noise of the measurement, less what the starts take of it.
    assert result.fitted.rmse_rad == pytest.approx(NOISE, rel=0.05)


@pytest.fixture(scope="module")
def pieces(known, session):
    """Upside down, with starts that are off by far more than the noise."""
    rng = np.random.default_rng(9)
    cut = [piece for seed in (1, 2) for piece in segments(measured(seed, 1.5), PIECE, STEP)]
    return [replace(one, q0=one.q0 + rng.normal(0.0, 0.003), dq0=one.dq0 + rng.normal(0.0, 0.1)) for one in cut]


def test_starts_are_found_too(known, session, pieces):
    """From the nominal numbers and wrong starts to the true ones: no search before it."""
    problem = problem_of(known, pieces)
    shot = shoot(problem, session, problem.to_unit(problem.start_values()))
    found = values_of(problem, shot.x)
    assert found == pytest.approx(TRUTH, rel=0.05)
    true = [measured_start(piece) for piece in pieces]
    before = np.array([(run.q0 - q, run.dq0 - v) for run, (q, v) in zip(pieces, true, strict=True)])
    after = np.array([(run.q0 - q, run.dq0 - v) for run, (q, v) in zip(shot.runs, true, strict=True)])
    assert (np.abs(after).mean(axis=0) < (0.2, 0.4) * np.abs(before).mean(axis=0)).all()
    assert [run.name for run in shot.runs] == [run.name for run in pieces]
    assert shot.evaluations > len(problem.free)


def measured_start(piece):
    """Angle and speed at the start of a piece as a cubic through its samples says, to some 0.03 rad/s."""
    near = piece.t < 0.06
    line = np.polynomial.Polynomial.fit(piece.t[near], piece.y[near], 3)
    return float(line(0.0)), float(line.deriv()(0.0))


def test_a_piece_that_stands_still_holds_nothing_up(known, session, pieces):
    """Its starting speed hardly shows: without a scale the step for it would be far too long, and end the rest."""
    still = replace(pieces[0], command=np.full_like(pieces[0].command, -1.5), name="still", gravity_torque=1.5)
    rest = np.pi / 2 + np.zeros(still.t.size) + np.random.default_rng(5).normal(0.0, NOISE, still.t.size)
    still = replace(still, command=np.full_like(still.command, 1.5), y=rest, q0=float(rest[0]), dq0=0.05)
    problem = problem_of(known, [*pieces, still])
    shot = shoot(problem, session, problem.to_unit(problem.start_values()))
    assert values_of(problem, shot.x) == pytest.approx(TRUTH, rel=0.05)
    assert abs(shot.runs[-1].dq0) < 1.0


def test_a_start_that_is_not_free_stays(known, session, pieces):
    fixed = [replace(piece, free_start=i % 2 == 0) for i, piece in enumerate(pieces)]
    problem = problem_of(known, fixed)
    shot = shoot(problem, session, problem.to_unit(problem.start_values()))
    moved = [(run.q0, run.dq0) != (old.q0, old.dq0) for run, old in zip(shot.runs, fixed, strict=True)]
    assert moved == [run.free_start for run in fixed]


def test_free_starts_make_intervals_wider(known, session, pieces):
    """What a start can take up says nothing about mass or friction, and the evidence knows it."""
    problem = problem_of(known, pieces)
    shot = shoot(problem, session, problem.to_unit(problem.start_values()))
    values = problem.from_unit(shot.x)
    free, fixed = (
        evidence(one, session.kernel(one.train), values)
        for one in (
            replace(problem, train=shot.runs),
            replace(problem, train=tuple(replace(run, free_start=False) for run in shot.runs)),
        )
    )
    width = [np.array([one.high - one.low for one in some.estimates]) for some in (free, fixed)]
    assert (width[0] > 1.2 * width[1]).all()
    kernel = session.kernel(shot.runs)
    jacobians = [np.random.default_rng(1).normal(size=(run.t.size, 4)) for run in shot.runs]
    kept = without_starts(problem, kernel, shot.x, jacobians)
    for run, old, new in zip(shot.runs, jacobians, kept, strict=True):
        # Two directions are gone, and projecting again takes nothing more away.
        assert np.linalg.norm(new) < np.linalg.norm(old), run.name
    again = without_starts(problem, kernel, shot.x, kept)
    assert max(np.abs(a - b).max() for a, b in zip(kept, again, strict=True)) < 1e-9


def test_emps(shared_dir, robot_model_dir, tmp_path, capsys):
    """The published numbers of a real prismatic drive (Janot, Gautier, Brunot 2019), through the command line."""
    source = shared_dir / "data" / "emps" / "DATA_EMPS.mat"
    if not source.is_file():
        pytest.skip(f"no {source.name} in the shared folder")
    assert frasa("import", source, "--format", "emps", "--out", tmp_path / "logs") == 0
    words = ("fit", tmp_path / "logs", "--model", robot_model_dir / "nominal.xml", "--out", tmp_path / "emps.json")
    options = ("--effects", "bias", "--shooting", "0.03", "--timestep", "0.001", "--no-report", "--json")
    capsys.readouterr()
    assert frasa(*words, *options) == 0
    fit = json.loads(capsys.readouterr().out)
    found = {name: one["value"] for name, one in fit["parameters"].items()}
    assert found["emps.armature"] == pytest.approx(95.1089, abs=3 * 0.1085)
    assert found["emps.damping"] == pytest.approx(203.5034, abs=3 * 1.146)
    assert found["emps.frictionloss"] == pytest.approx(20.3935, abs=3 * 0.1012)
    assert {one["verdict"] for one in fit["parameters"].values()} <= {IDENTIFIED, ROUGH}
    assert not fit["multimodal"]

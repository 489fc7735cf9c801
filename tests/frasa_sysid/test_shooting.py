"""Logs that diverge in open loop, fitted in pieces whose starts are free."""

import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.bootstrap import full_bootstrap
from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.evidence import IDENTIFIED, ROUGH, evidence
from frasa_sysid.fit import fit
from frasa_sysid.pieces import by_log, count_of, in_pieces, independent, one_log_in_pieces, segments
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.rig import BenchRun
from frasa_sysid.shooting import shoot, without_starts
from frasa_sysid.spread import Spread

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
    runs = [measured(seed, gravity, seconds=3.0) for seed in range(1, 7)]
    whole = problem_of(known, runs)
    # With the true numbers, but for the sensor's error, the replayed force leads a long way from what was measured.
    kernel = session.kernel(runs)
    plain = np.array([{**TRUTH, "bias": 0.0}[one.field] for one in whole.free])
    far = kernel.readings(whole.candidates(whole.to_unit(plain)[None]))[0] - np.concatenate([run.y for run in runs])
    assert np.nanmax(np.abs(far)) > (0.1 if gravity == 0.0 else 1.0)

    problem = problem_of(known, in_pieces(runs, PIECE, STEP))
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
    cut = in_pieces([measured(seed, 1.5) for seed in (1, 2)], PIECE, STEP)
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


def test_pieces_know_their_log(pieces):
    """Also by the names that logs of two folders may share; what is whole is a log of its own."""
    whole = [measured(seed, 0.0, seconds=0.5) for seed in (1, 1, 2)]
    cut = in_pieces(whole, 0.1, STEP, first_log=4)
    assert [run.log for run in cut] == [4] * 5 + [5] * 5 + [6] * 5
    assert by_log(cut[::-1]) == independent(cut[::-1]) == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9], [10, 11, 12, 13, 14]]
    assert by_log([*whole, *cut[:2]]) == [[0], [1], [2], [3, 4]]
    assert (count_of(cut), count_of(whole), count_of(whole[:1])) == ("3 runs in 15 pieces", "3 runs", "1 run")
    # Of one log nothing is left to leave out but its pieces.
    assert independent(cut[:5]) == [[0], [1], [2], [3], [4]]
    assert [one_log_in_pieces(some) for some in (cut[:5], cut, whole[:1], whole)] == [True, False, False, False]
    assert segments(whole[0], 0.1, STEP)[0].log == -1
    assert len(by_log(pieces)) == 2


def test_pieces_of_one_log_are_left_out_together(kit):
    """A damping that is another one in every log is seen by the intervals; taking pieces for logs hides half of it."""
    plans = [kit.Plan(mass=mass, gain=gain, seed=i) for i, (mass, gain) in enumerate([(0.5, 16.0), (1.2, 8.0)] * 3)]
    shares = (0.9, 0.9, 1.1, 1.1, 0.9, 0.9)
    odd = [
        replace(plan, truth={**kit.truth, "damping": share * kit.truth["damping"]})
        for plan, share in zip(plans, shares, strict=True)
    ]
    cut = in_pieces(kit.runs([kit.recording(plan, f"r{i}") for i, plan in enumerate(odd)]), 0.8, kit.timestep)
    widths = []
    for train in (cut, [replace(one, log=-1) for one in cut]):
        problem = kit.problem(train)
        values = np.array([kit.truth[one.field] for one in problem.free])
        found = evidence(problem, kit.session.kernel(train), values).estimates
        widths += [one.high - one.low for one in found if one.name == "mx106.damping"]
    assert widths[0] > 1.5 * widths[1]


def test_pieces_of_one_log_are_drawn_together(known, session, pieces):
    """Every draw of the full bootstrap holds whole logs; of one log its pieces."""
    problem = problem_of(known, pieces)
    drawn = []

    class Recorder(Spread):
        def map(self, work, tasks):
            drawn.extend(tasks)
            return [problem.start_values() for _ in tasks]

    for train in (tuple(pieces), tuple(one for one in pieces if one.log == 0)):
        drawn.clear()
        full_bootstrap(replace(problem, train=train), session, problem.start_values(), 20, Recorder())
        logs = independent(train)
        assert len(drawn) == 20
        for one in drawn:
            assert sorted(one) == sorted(i for log in logs for i in log * one.count(log[0]))
    assert len({tuple(sorted(one)) for one in drawn}) > 10


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

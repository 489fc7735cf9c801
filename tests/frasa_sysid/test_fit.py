import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid import restarts as restarting
from frasa_sysid import search as searching
from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.errors import InputError
from frasa_sysid.evidence import IDENTIFIED, ROUGH
from frasa_sysid.fit import fit
from frasa_sysid.fit_record import Extras, save, to_json
from frasa_sysid.problem import state_problem
from frasa_sysid.restarts import identity_of, solve, subset
from frasa_sysid.rig import runs_of
from frasa_sysid.search import Stop
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stored_fit import load, model_parameters

# Relative, but for delay [s] and offset [rad]. The model's steps act half a step early, so its delay is that longer.
TOLERANCE = {
    "kp": 0.03,
    "damping": 0.03,
    "damping_off": 0.05,
    "frictionloss": 0.05,
    "armature": 0.03,
    "forcerange": 0.03,
    "delay": 0.0005,
    "offset": 0.002,
}


@pytest.fixture(scope="module")
def result(kit, recordings):
    """Fitted from nominal values that are wrong by a fifth and more; one run is held out."""
    runs = kit.runs(recordings)
    problem = kit.problem(runs[:2] + runs[3:], (runs[2],))
    return fit(problem, kit.session, {"a.mcap": "0" * 64}, evaluations=45)


def test_recovers_the_truth(kit, result):
    """Logs of an independent integrator, with encoder, jitter and delay, give their parameters back."""
    for one in result.evidence.estimates:
        field = one.name.rpartition(".")[2]
        truth = kit.truth[field]
        if field == "delay":
            truth += kit.timestep / 2
        allowed = TOLERANCE[field] * (1.0 if field in ("delay", "offset") else truth)
        assert one.value == pytest.approx(truth, abs=allowed), one
        assert one.verdict in (IDENTIFIED, ROUGH)


def test_intervals_are_honest(kit, result):
    """Intervals, widened by the floor of publishing, hold nearly all true values, and none is absurdly wide."""
    held = 0
    for one in result.evidence.estimates:
        field = one.name.rpartition(".")[2]
        truth = kit.truth[field] + (kit.timestep / 2 if field == "delay" else 0.0)
        floor = 0.0005 if field in ("delay", "offset") else 0.02 * one.value
        held += min(one.low, one.value - floor) <= truth <= max(one.high, one.value + floor)
        # A zero has no size of its own: half a degree is the scale of an encoder's.
        assert one.high - one.low < (0.01 if field == "offset" else 0.3 * abs(one.value))
    assert held >= 7


@pytest.mark.parametrize("timestep", [0.0005, 0.002])
def test_a_step_of_its_own_is_physics(kit, recordings, robot_model_dir, timestep):
    """With its own step the fit finds the true delay too, which MuJoCo's equations see half a step longer."""
    with BenchSession(robot_model_dir / "bench_pendulum.xml", kit.servo, 2, timestep) as session:
        runs = runs_of(recordings, kit.servo, timestep)
        problem = state_problem(kit.servo, kit.nominal, runs, (), session.delay_range)
        found = fit(problem, session, {}, evaluations=45, restarts=1)
    for one in found.evidence.estimates:
        field = one.name.rpartition(".")[2]
        allowed = 0.0004 if field == "delay" else TOLERANCE[field] * (1.0 if field == "offset" else kit.truth[field])
        assert one.value == pytest.approx(kit.truth[field], abs=allowed), one
        assert one.verdict in (IDENTIFIED, ROUGH)


def test_the_step_hardly_matters(kit, robot_model_dir):
    """Readings with a step of one's own are those of the independent bench, and hardly depend on the step."""
    truth = kit.truth | {"forcerange": 100.0}  # a jump that saturates is no finer in time than a step
    recording = kit.recording(kit.Plan(goal=kit.goals["chirp"], truth=truth), noise=False)
    found = {}
    for step in (None, 0.002, 0.001, 0.0005, 0.0001):
        with BenchSession(robot_model_dir / "bench_pendulum.xml", kit.servo, 1, step) as session:
            run = runs_of([recording], kit.servo, session.options.timestep)[0]
            found[step] = session.kernel([run]).readings(ServoValues(**truth).array()[None])[0]
    for step in (0.002, 0.001, 0.0005):
        assert np.abs(found[step] - found[0.0001]).max() < 0.1 * step
        assert np.abs(found[step] - run.y).max() < 0.0005
    # The model's own step is MuJoCo's, and late by half of it.
    assert np.abs(found[None] - run.y).max() > 0.003


@pytest.mark.parametrize(
    "numbers",
    [
        {"frictionloss": 0.0},
        {"frictionloss": 0.0, "drag": 0.05, "loop_lag": 0.002},
        {"stribeck": 0.1, "stribeck_speed": 2.0, "load_motor": 0.1, "load_external": 0.1, "sag": 0.2},
    ],
    ids=["plain", "effects", "law"],
)
def test_a_step_of_its_own_is_of_second_order(kit, robot_model_dir, numbers):
    """From a start in motion, half the step leaves about a quarter of the error."""
    truth = kit.truth | {"forcerange": 100.0}
    swing = kit.Plan(goal=lambda t: 1.6 * t, truth=truth, duration=0.6)
    recording = kit.recording(swing, noise=False)
    found = {}
    for step in (0.002, 0.001, 0.00002):
        with BenchSession(robot_model_dir / "bench_pendulum.xml", kit.servo, 1, step) as session:
            run = replace(runs_of([recording], kit.servo, step)[0], q0=-0.8, dq0=4.0)
            found[step] = session.kernel([run]).readings(ServoValues(**truth | numbers).array()[None])[0]
    coarse, fine = (np.abs(found[step] - found[0.00002]).max() for step in (0.002, 0.001))
    assert 2.8 < coarse / fine < 5.5
    assert coarse < 0.001


def test_errors_shrink_also_on_what_was_held_out(result):
    """The fit is far better than nominal, and as good on the run it never saw."""
    assert result.fitted.mae_rad < 0.05 * result.nominal.mae_rad
    assert result.held_out.mae_rad < 0.05 * result.held_out_nominal.mae_rad
    assert set(result.held_out.by_run) == {"run2"}
    assert "run2" not in result.fitted.by_run
    assert result.trace == tuple(sorted(result.trace, reverse=True))


def test_without_the_finisher(kit, recordings):
    """CMA-ES alone is never worse than nominal, and says that its budget ended it."""
    problem = kit.problem(kit.runs(recordings[:2]))
    found = fit(problem, kit.session, {}, evaluations=30, optimizer="cmaes")
    assert found.fitted.mae_rad < found.nominal.mae_rad
    assert found.stop is Stop.BUDGET


def test_unexcited_numbers_stay_nominal(kit):
    """What the logs do not speak of is left at nominal and says so in the result."""
    plans = [kit.Plan(goal=kit.goals["small"], mass=mass, seed=i) for i, mass in enumerate((0.5, 1.2))]
    problem = kit.problem(kit.runs([kit.recording(plan, f"r{i}") for i, plan in enumerate(plans)]))
    found = fit(problem, kit.session, {}, evaluations=30)
    one = next(one for one in found.evidence.estimates if one.name == "mx106.forcerange")
    assert one.verdict == "not excited"
    assert one.value == one.nominal == kit.nominal["forcerange"]


@pytest.fixture
def every_generation(monkeypatch):
    """Checkpoints after every generation, not only twice a second."""
    monkeypatch.setattr(searching, "_SAVE_EVERY", -1.0)


def counted(monkeypatch, dies_after=10**9, error=MemoryError):
    """Candidates in each call for the costs of several, as the search asks; one call more than `dies_after` fails."""
    original, asked = BenchKernel.costs, []

    def costs(self, candidates, offsets=None):
        if len(candidates) > 2:
            if len(asked) == dies_after:
                raise error
            asked.append(len(candidates))
        return original(self, candidates, offsets)

    monkeypatch.setattr(BenchKernel, "costs", costs)
    return asked


@pytest.mark.usefixtures("every_generation")
@pytest.mark.parametrize(("law", "generations"), [("m1", 2), ("m1", 4), ("m2", 4), ("m2", 8)])
def test_killed_and_started_again(kit, recordings, tmp_path, monkeypatch, law, generations):
    """A fit killed in its first or second search, on its way up or at the top, ends as the unbroken one did."""
    problem = kit.problem(kit.runs(recordings[:2]), law=law)
    with monkeypatch.context() as patch:
        every = counted(patch)
        whole = fit(problem, kit.session, {}, evaluations=42, restarts=2)
    path = tmp_path / "a.partial.json"
    with monkeypatch.context() as patch:
        counted(patch, generations)
        with pytest.raises(MemoryError):
            fit(problem, kit.session, {}, evaluations=42, restarts=2, checkpoint=path)
    assert path.is_file()
    with monkeypatch.context() as patch:
        anew = counted(patch)
        again = fit(problem, kit.session, {}, evaluations=42, restarts=2, checkpoint=path)
    np.testing.assert_array_equal(again.values, whole.values)
    assert again.evaluations == whole.evaluations
    assert again.trace == whole.trace
    assert anew == every[generations:]
    for one, other in zip(again.solved.restarts, whole.solved.restarts, strict=True):
        assert (one.start, one.cost) == (other.start, other.cost)
        np.testing.assert_array_equal(one.x, other.x)


def test_ctrl_c_in_the_finisher_keeps_the_search(kit, recordings, monkeypatch):
    """An interrupt after the search still yields a result, marked as interrupted."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(restarting, "finish", interrupted)
    found = fit(kit.problem(kit.runs(recordings[:1])), kit.session, {}, evaluations=14)
    assert found.stop is Stop.INTERRUPTED
    assert found.fitted.mae_rad <= found.nominal.mae_rad


@pytest.mark.parametrize("law", ["m1", "m4"])
@pytest.mark.parametrize("generations", [1, 2, 3])
def test_ctrl_c_ends_the_whole_fit(kit, recordings, monkeypatch, law, generations):
    """One interrupt ends it, in any search and on the way to it; the best so far is the result."""
    problem = kit.problem(kit.runs(recordings[:2]), law=law)
    asked = counted(monkeypatch, generations, KeyboardInterrupt())
    found = fit(problem, kit.session, {}, evaluations=28)
    assert found.stop is Stop.INTERRUPTED
    assert len(asked) == generations
    assert found.evaluations >= sum(asked)
    assert found.friction == law
    assert found.fitted.mae_rad <= found.nominal.mae_rad


def test_ctrl_c_before_anything_was_found(kit, recordings, monkeypatch):
    """Without a single cost there is no result to keep."""
    counted(monkeypatch, 0, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        fit(kit.problem(kit.runs(recordings[:1])), kit.session, {}, evaluations=28)


def test_only_the_very_same_search_is_resumed(kit, recordings, robot_model_dir):
    """Another load, gain, log, bound, law, effect, step or optimizer is another search, though the file is the same."""
    runs = kit.runs(recordings[:1])
    problem = kit.problem(runs)
    seen = {identity_of(problem, kit.session, "cmaes")}
    run, free = runs[0], problem.free[0]
    others = [
        *(
            replace(problem, train=(replace(run, **change),))
            for change in (
                {"kp_scale": 1.1 * run.kp_scale},
                {"inertia": 1.1 * run.inertia},
                {"y": run.y + 1e-9},
                {"supply": 0.99 * run.supply},
                {"rest": 1.01},
                {"rig": "another"},
                {"command": run.command + 1e-9},
                {"control": "voltage"},
                {"lead": 1},
                {"free_start": True},
            )
        ),
        replace(problem, free=(replace(free, high=2 * free.high), *problem.free[1:])),
        replace(problem, free=(replace(free, start=1.1 * free.start), *problem.free[1:])),
        replace(problem, nominal={**problem.nominal, "delay": 0.001}),
        replace(problem, law="m2"),
        replace(problem, effects=("sag",)),
    ]
    for other in others:
        seen.add(identity_of(other, kit.session, "cmaes"))
    seen.add(identity_of(problem, kit.session, "cmaes+lsq"))
    with BenchSession(robot_model_dir / "bench_pendulum.xml", kit.servo, 1, 0.001) as finer:
        seen.add(identity_of(problem, finer, "cmaes"))
    assert len(seen) == len(others) + 3
    assert identity_of(problem, kit.session, "cmaes") in seen
    # Threads make no difference to the result, so none to what may be resumed.
    with BenchSession(robot_model_dir / "bench_pendulum.xml", kit.servo, 1) as same:
        assert identity_of(problem, same, "cmaes") == identity_of(problem, kit.session, "cmaes")


@pytest.mark.usefixtures("every_generation")
def test_another_seed_or_start_is_another_search(kit, recordings, tmp_path):
    """Costs of one seed, or from one start, are never taken for those of another, though all stand in one file."""
    problem = kit.problem(kit.runs(recordings[:1]))
    path = tmp_path / "a.partial.json"
    points = [problem.to_unit(problem.start_values()) + shift for shift in (0.005, 0.01)]
    for count, (seed, nested) in enumerate([(0, ()), (1, ()), (0, points[:1]), (0, points[1:])], start=1):
        one = replace(problem, seed=seed)
        found = solve(one, kit.session, 28, "cmaes", nested=nested, checkpoint=path)
        alone = solve(one, kit.session, 28, "cmaes", nested=nested)
        np.testing.assert_array_equal(found.x, alone.x)
        assert found.trace == alone.trace
        assert len(json.loads(path.read_text())["searches"]) == count


def test_the_subset_is_spread_out(kit, recordings):
    """The search looks at every trajectory, whatever order the logs come in."""
    runs = kit.runs([replace(one, name=f"{one.name}_{k}") for k in range(3) for one in recordings])
    chosen = subset(runs, 6)
    assert len(chosen) == len({run.name for run in chosen}) == 6
    assert {run.trajectory for run in chosen} == {"chirp", "steps", "drop"}
    assert [run.name for run in subset(runs[::-1], 6)] == [run.name for run in chosen]
    assert len(subset(runs, 100)) == 21


def test_fit_file_round_trip(result, tmp_path):
    """What was fitted comes back from the file: numbers exactly, intervals, units, verdicts, where it holds."""
    path = tmp_path / "mx106.json"
    save(path, to_json(result, Extras("simulated")))
    stored = load(path)
    for one in result.evidence.estimates:
        found = stored.parameters[one.name]
        assert (found["value"], found["low"], found["high"]) == (one.value, one.low, one.high)
        assert (found["unit"], found["verdict"]) == (one.unit, one.verdict)
    assert stored.stated == {"supply_voltage": 15.0, "firmware_gain": 12.0}
    assert stored.inputs == {"a.mcap": "0" * 64}
    assert set(model_parameters(stored)) == set(stored.parameters) - {"bench.offset", "mx106.damping_off"}
    values = ServoValues(**{**result.problem.nominal, **json.loads(path.read_text())["mujoco"]})
    assert values.kp == stored.parameters["mx106.kp"]["value"]


def wrong(data, *keys, value):
    """The data with one field replaced, or removed where the value is None."""
    data = json.loads(json.dumps(data))
    place = data
    for key in keys[:-1]:
        place = place[key]
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    return data


KP = ("parameters", "mx106.kp")


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("schema",), "frasa.fit/99"),
        (("schema",), None),
        (("servo",), None),
        (("servo",), "mx64"),
        (("origin",), None),
        (("inputs",), [1]),
        (("stated_at",), {"supply_voltage": 15.0}),
        (("stated_at", "supply_voltage"), float("nan")),
        (("stated_at", "firmware_gain"), 0),
        (("parameters",), []),
        ((*KP,), 3),
        ((*KP, "value"), None),
        ((*KP, "value"), "much"),
        ((*KP, "value"), float("nan")),
        ((*KP, "value"), -1.0),
        ((*KP, "value"), 10**400),
        ((*KP, "low"), float("nan")),
        ((*KP, "low"), 1e9),
        ((*KP, "high"), float("inf")),
        ((*KP, "spread_low"), float("nan")),
        ((*KP, "unit"), "N m/deg"),
        ((*KP, "verdict"), None),
        (("parameters", "mx106.colour"), {}),
        (("correlation",), None),
        (("correlation", "matrix"), [[1.0]]),
        (("correlation", "matrix"), "x"),
        (("correlation", "names"), ["mx106.kp", "nobody"]),
    ],
)
def test_a_wrong_fit_file_is_one_error(result, tmp_path, keys, value):
    """Every field that is missing, of the wrong kind, not finite or out of order is an input error."""
    data = wrong(to_json(result, Extras("simulated")), *keys, value=value)
    path = tmp_path / "a.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"a\.json"):
        load(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b"[" * 100_000])
def test_what_is_no_fit_file(tmp_path, content):
    """Text that is no JSON object is said to be no fit file; a missing one too."""
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a fit file"):
        load(path)
    with pytest.raises(InputError, match="no fit at"):
        load(tmp_path / "b.json")


def test_a_step_of_its_own_is_another_search(kit, robot_model_dir):
    """Also where it equals the model's step: the equations are others, so MuJoCo cannot replay such a fit."""
    own, path = kit.session, robot_model_dir / "bench_pendulum.xml"
    with BenchSession(path, kit.servo, 1, own.options.timestep) as other:
        assert other.options.timestep == own.options.timestep
        assert own.publishable
        assert not other.publishable
        assert other.fingerprint != own.fingerprint
        assert other.delay_range[0] == 0.0 < own.delay_range[0]
        assert not pickle.loads(pickle.dumps(other)).publishable

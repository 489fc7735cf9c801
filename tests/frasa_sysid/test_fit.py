import json
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid import fit as fitting
from frasa_sysid import fit_file
from frasa_sysid.errors import InputError
from frasa_sysid.fit import _identity, fit, subset
from frasa_sysid.report import write_fit_report
from frasa_sysid.rollout import ServoValues
from frasa_sysid.search import Stop

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
    return fit(problem, kit.simulator, {"a.mcap": "0" * 64}, evaluations=45)


def test_recovers_the_truth(kit, result):
    """Logs of an independent integrator, with encoder, jitter and delay, give their parameters back."""
    for one in result.evidence.estimates:
        field = one.name.rpartition(".")[2]
        truth = kit.truth[field]
        if field == "delay":
            truth += kit.simulator.timestep / 2
        allowed = TOLERANCE[field] * (1.0 if field in ("delay", "offset") else truth)
        assert one.value == pytest.approx(truth, abs=allowed), one
        assert one.verdict == "identified"


def test_intervals_are_honest(kit, result):
    """Intervals, widened by the floor of publishing, hold nearly all true values, and none is absurdly wide."""
    held = 0
    for one in result.evidence.estimates:
        field = one.name.rpartition(".")[2]
        truth = kit.truth[field] + (kit.simulator.timestep / 2 if field == "delay" else 0.0)
        floor = 0.0005 if field in ("delay", "offset") else 0.02 * one.value
        held += min(one.low, one.value - floor) <= truth <= max(one.high, one.value + floor)
        assert one.high - one.low < 0.3 * abs(one.value)
    assert held >= 7


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
    found = fit(problem, kit.simulator, {}, evaluations=30, optimizer="cmaes")
    assert found.fitted.mae_rad < found.nominal.mae_rad
    assert found.stop is Stop.BUDGET


def test_unexcited_numbers_stay_nominal(kit):
    """What the logs do not speak of is left at nominal and says so in the result."""
    plans = [kit.Plan(goal=kit.goals["small"], mass=mass, seed=i) for i, mass in enumerate((0.5, 1.2))]
    problem = kit.problem(kit.runs([kit.recording(plan, f"r{i}") for i, plan in enumerate(plans)]))
    found = fit(problem, kit.simulator, {}, evaluations=30)
    one = next(one for one in found.evidence.estimates if one.name == "mx106.forcerange")
    assert one.verdict == "not excited"
    assert one.value == one.nominal == kit.nominal["forcerange"]


def test_killed_and_started_again(kit, recordings, tmp_path, monkeypatch):
    """A fit killed while searching gives, when started again, the result of the unbroken one."""
    problem = kit.problem(kit.runs(recordings[:2]))
    whole = fit(problem, kit.simulator, {}, evaluations=42)
    original, calls = fitting.robust_cost, []

    def dying(parts):
        calls.append(1)
        if len(calls) > 20:
            raise MemoryError
        return original(parts)

    path = tmp_path / "a.partial.json"
    monkeypatch.setattr(fitting, "robust_cost", dying)
    with pytest.raises(MemoryError):
        fit(problem, kit.simulator, {}, evaluations=42, checkpoint=path)
    monkeypatch.undo()
    assert path.is_file()
    again = fit(problem, kit.simulator, {}, evaluations=42, checkpoint=path)
    np.testing.assert_array_equal(again.values, whole.values)
    assert again.evaluations == whole.evaluations


def test_ctrl_c_in_the_finisher_keeps_the_search(kit, recordings, monkeypatch):
    """An interrupt after the search still yields a result, marked as interrupted."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(fitting, "finish", interrupted)
    found = fit(kit.problem(kit.runs(recordings[:1])), kit.simulator, {}, evaluations=14)
    assert found.stop is Stop.INTERRUPTED
    assert found.fitted.mae_rad <= found.nominal.mae_rad


def test_only_the_very_same_search_is_resumed(kit, recordings):
    """Another load, gain, log, bound, seed or optimizer is another search, though the file is the same."""
    runs = kit.runs(recordings[:1])
    problem = kit.problem(runs)
    seen = {_identity(problem, kit.simulator, "cmaes")}
    run, free = runs[0], problem.free[0]
    for other in (
        replace(problem, train=(replace(run, kp_scale=1.1 * run.kp_scale),)),
        replace(problem, train=(replace(run, inertia=1.1 * run.inertia),)),
        replace(problem, train=(replace(run, y=run.y + 1e-9),)),
        replace(problem, free=(replace(free, high=2 * free.high), *problem.free[1:])),
        replace(problem, nominal={**problem.nominal, "delay": 0.001}),
        replace(problem, seed=1),
    ):
        seen.add(_identity(other, kit.simulator, "cmaes"))
    seen.add(_identity(problem, kit.simulator, "cmaes+lsq"))
    assert len(seen) == 8
    assert _identity(problem, kit.simulator, "cmaes") in seen


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
    fit_file.save(path, fit_file.to_json(result, "simulated"))
    stored = fit_file.load(path)
    for one in result.evidence.estimates:
        found = stored.parameters[one.name]
        assert (found["value"], found["low"], found["high"]) == (one.value, one.low, one.high)
        assert (found["unit"], found["verdict"]) == (one.unit, one.verdict)
    assert stored.stated == {"supply_voltage": 15.0, "firmware_gain": 12.0}
    assert stored.inputs == {"a.mcap": "0" * 64}
    assert set(fit_file.model_parameters(stored)) == set(stored.parameters) - {"bench.offset", "mx106.damping_off"}
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
    data = wrong(fit_file.to_json(result, "simulated"), *keys, value=value)
    path = tmp_path / "a.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"a\.json"):
        fit_file.load(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b"[" * 100_000])
def test_what_is_no_fit_file(tmp_path, content):
    """Text that is no JSON object is said to be no fit file; a missing one too."""
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a fit file"):
        fit_file.load(path)
    with pytest.raises(InputError, match="no fit at"):
        fit_file.load(tmp_path / "b.json")


def test_report_is_one_file(kit, result, tmp_path):
    """The page opens offline: pictures inside, nothing from elsewhere, a few MB at most, every run and number in it."""
    hostile = replace(result, problem=replace(result.problem, hold_out_rule="<script>alert(1)</script>"))
    path = write_fit_report(tmp_path / "a.html", hostile, kit.simulator)
    page = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 5_000_000
    for word in ("http://", "https://", "<script", "<link", "@import", "url("):
        assert word not in page
    assert page.count("src=") == page.count('src="data:image/png;base64,') == 2
    for run in (*result.problem.train, *result.problem.held_out):
        assert run.name in page
    for one in result.evidence.estimates:
        assert one.name in page
    assert write_fit_report(tmp_path / "b.html", hostile, kit.simulator).read_bytes() == path.read_bytes()


def test_report_of_odd_names(kit, result, tmp_path):
    """A trajectory named by a stranger is drawn as it is, not typeset."""
    runs = tuple(replace(run, trajectory=r"$\frac{<b>&") for run in result.problem.train)
    odd = replace(result, problem=replace(result.problem, train=runs))
    assert write_fit_report(tmp_path / "a.html", odd, kit.simulator).is_file()

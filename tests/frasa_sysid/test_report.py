import re
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.page import Html, esc, table
from frasa_sysid.choice import Choice, Fold, Trial
from frasa_sysid.cost import misfit
from frasa_sysid.fit import fit
from frasa_sysid.fit_record import Extras
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.report import Trace, shown, write_fit_report
from frasa_sysid.report_compare import ComparisonPage, write_comparison
from frasa_sysid.report_figures import unpowered
from frasa_sysid.report_tables import record_next
from frasa_sysid.resampling import Profile
from frasa_sysid.rig import runs_of
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stand_in import stand_in

pytest.importorskip("matplotlib")
EVIL = "<script>alert('x')</script>&\"$\\frac"


@pytest.fixture(scope="session")
def bench(robot_model_dir):
    """Servo, nominal numbers, the equations, and nine runs of the project's own log."""
    servo, nominal = stated_servo("mx106", robot_model_dir / "nominal.xml")
    recordings = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    with BenchSession(robot_model_dir / "bench_pendulum.xml", servo, threads=2) as session:
        runs = runs_of(recordings[::4], servo, session.options.timestep)
        yield servo, nominal, session, runs


@pytest.fixture(scope="session")
def fitted(bench):
    """A real fit of M4 with a zero for each rig: two restarts of few evaluations, one run held out."""
    servo, nominal, session, runs = bench
    delays = session.delay_range
    problem = state_problem(servo, nominal, runs[:8], runs[8:], delays, "kp=32", 0, "m4", ("offsets", "sag"))
    return fit(problem, session, {"mx106.mcap": "ab" * 32}, evaluations=30, restarts=2, known=(np.full(16, 0.3),))


@pytest.fixture(scope="session")
def extras(fitted, bench):
    """Everything a page can hold beside the fit."""
    folds = (Fold("rig", "0.5kg 0.1m", (0, 1)), Fold("gain", EVIL, (2, 3)))
    laws = tuple(
        Trial(law, fitted.problem.effects, 9, 0.01, error, (error, 1.3 * error), p, against)
        for law, error, p, against in (("m1", 0.02, float("nan"), ""), ("m4", 0.004, 0.012, "m1 + offsets + sag"))
    )
    choice = Choice(fitted.problem, fitted.solved.x, laws, (), folds, "m4: no richer law is better", 5)
    bootstrap = np.column_stack([fitted.values - 0.01, fitted.values + 0.01])
    return Extras("simulated", choice, stand_in(fitted, bench[2]), bootstrap, 7)


def test_the_page_of_a_fit(fitted, extras, bench, tmp_path, page_text):
    """Everything a person asks of a fit stands on one page that needs nothing else."""
    path = write_fit_report(tmp_path / "fit.html", fitted, extras, bench[2], ("log the servo's input voltage",))
    text = page_text(path)
    for one in fitted.evidence.estimates:
        assert one.name in text
        assert f"{one.value:.4g}" in text
        assert f"{one.low:.4g} to {one.high:.4g}" in text
        assert one.verdict in text
        assert one.advice.removeprefix("record ") in text
    for words in (
        "friction law M4",
        "every rig has its own zero",
        f"{fitted.nominal.mae_rad * 1e3:.1f} → {fitted.fitted.mae_rad * 1e3:.1f}",
        f"{fitted.held_out_nominal.mae_rad * 1e3:.1f} → {fitted.held_out.mae_rad * 1e3:.1f}",
        "kp=32",
        fitted.stop.value,
        "torque switched off",
        "no richer law is better",
        "0.012",
        f"{extras.stand_in.penalty.mae_rad * 1e3:.2f} mrad",
        f"{extras.stand_in.loads[0]:.2f} to {extras.stand_in.loads[1]:.2f} N m",
        "log the servo's input voltage",
        "ab" * 32,
        f"mujoco {fitted.versions['mujoco']}",
        "seed 0",
        "nested",
        "7 refits",
    ):
        assert words in text, words
    for name in (*fitted.fitted.by_run, *fitted.held_out.by_run):
        assert name in text
    assert ("Several answers" in text) == fitted.solved.multimodal


def test_the_same_fit_gives_the_same_page(fitted, extras, bench, tmp_path):
    """No clock and no folder gets into it."""
    pages = [write_fit_report(tmp_path / name, fitted, extras, bench[2]).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1]
    assert str(tmp_path).encode() not in pages[0]


def test_names_from_files_stay_text(fitted, extras, bench, tmp_path, page_text):
    """A log, rig or trajectory may be called anything: nothing of it becomes HTML or a formula."""
    runs = [replace(run, name=f"{EVIL}{run.name}", rig=EVIL, group=EVIL, trajectory=EVIL) for run in bench[3]]
    by_run = [dict(zip([run.name for run in part], [0.01] * len(part), strict=True)) for part in (runs[:8], runs[8:])]
    names = [f"bench.offset[{EVIL}]" if one.rig else one.name for one in fitted.problem.free]
    free = tuple(
        replace(one, name=name, rig=one.rig and EVIL) for one, name in zip(fitted.problem.free, names, strict=True)
    )
    estimates = tuple(
        replace(one, name=other.name, unit=EVIL) for one, other in zip(fitted.evidence.estimates, free, strict=True)
    )
    profile = Profile(EVIL, EVIL, (0.0, 1.0, 2.0), (0.001, 0.0, 0.001), None, 1.5)
    evil = replace(
        fitted,
        problem=replace(fitted.problem, train=tuple(runs[:8]), held_out=tuple(runs[8:]), free=free, hold_out_rule=EVIL),
        evidence=replace(fitted.evidence, estimates=estimates, profiles=(profile,)),
        fitted=replace(fitted.fitted, by_run=by_run[0]),
        nominal=replace(fitted.nominal, by_run=by_run[0]),
        held_out=replace(fitted.held_out, by_run=by_run[1]),
        held_out_nominal=replace(fitted.held_out_nominal, by_run=by_run[1]),
        inputs={EVIL: EVIL},
        versions={EVIL: EVIL},
    )
    path = write_fit_report(tmp_path / "fit.html", evil, replace(extras, origin=EVIL), bench[2], (EVIL,))
    assert EVIL in page_text(path)
    assert "<script>alert" not in path.read_text()


def test_a_page_without_extras(fitted, bench, tmp_path, page_text):
    """A plain M1 fit without held-out runs has no tables of choices, and no NaN."""
    servo, nominal, session, runs = bench
    problem = state_problem(servo, nominal, runs[:3], (), session.delay_range)
    plain = fit(problem, session, {}, evaluations=20, restarts=1)
    text = page_text(write_fit_report(tmp_path / "fit.html", plain, Extras("real"), session))
    assert "held out" not in text.replace("Held-out", "")
    assert "stand-in" not in text
    assert not re.search(r"\bnan\b", text)


def test_shown_runs(bench):
    """At most eight: the worst always among them, held-out ones too, and no two alike while there are others."""
    runs = bench[3]
    errors = {run.name: 0.01 for run in runs}
    for worst in runs:
        picked = shown(runs, {**errors, worst.name: 0.02}, {runs[3].name})
        assert len(picked) == len({run.name for run in picked}) == 8
        assert worst in picked
        assert runs[3] in picked
        assert {run.trajectory for run in picked} == {run.trajectory for run in runs}
    assert shown(runs[:2], errors, set()) == sorted(runs[:2], key=lambda run: (run.trajectory, run.group, run.name))


def test_advice_most_missed_first(fitted):
    """Logs that would help several numbers come first, each once; what the logs say themselves comes after."""
    names = ["", "record a", "record b", "record b"]
    estimates = [
        replace(one, advice=advice, verdict="not excited" if advice else "identified")
        for one, advice in zip(fitted.evidence.estimates, names, strict=False)
    ]
    one = replace(fitted, evidence=replace(fitted.evidence, estimates=tuple(estimates)))
    items = re.findall(r"<li>(\w+)", record_next(one, ("b", "c")))
    assert items == ["b", "a", "c"]
    nothing = replace(fitted, evidence=replace(fitted.evidence, estimates=tuple(estimates[:1])))
    assert "Nothing is missing" in record_next(nothing, ())


def test_traces_of_candidates(bench, tmp_path, page_text):
    """A page of traces draws at most eight runs, lists all, keeps names text, and bears a simulation that diverged."""
    _, nominal, _, runs = bench
    names = (EVIL, "b")
    traces = [Trace(run, dict(zip(names, (run.y + 0.01, np.full(run.t.size, np.nan)), strict=True))) for run in runs]
    errors = {name: misfit(runs, [trace.readings[name] for trace in traces]) for name in names}
    values = {name: replace(ServoValues(**nominal), kp=kp) for name, kp in zip(names, (21.25, 17.5), strict=True)}
    one = ComparisonPage(f"a {EVIL}", errors, values, traces, {EVIL: EVIL}, "real", {EVIL: EVIL, "b": "b.xml"})
    path = write_comparison(tmp_path / "traces.html", one)
    text = page_text(path)
    assert all(run.name in text for run in runs)
    assert f"a {EVIL}" in text
    assert f"{EVIL} 10.00 mrad" in text
    assert "kp 21.25 17.5" in text
    assert "<script>alert" not in path.read_text()


def test_unpowered_time(bench):
    """Shaded is where the torque is off, from the start on or between two switches."""
    run = replace(bench[3][0], switches=np.array([1.0, 2.0]), powered_first=True)
    end = float(run.t[-1])
    assert unpowered(run) == [(1.0, 2.0)]
    assert unpowered(replace(run, powered_first=False)) == [(0.0, 1.0), (2.0, end)]
    assert unpowered(replace(run, switches=np.zeros(0))) == []
    assert unpowered(replace(run, switches=np.array([-1.0]), powered_first=True)) == [(0.0, end)]


def test_html_is_escaped():
    """Only what is marked as HTML stays as it is."""
    assert esc("<&>\"'") == "&lt;&amp;&gt;&quot;&#x27;"
    assert esc(Html("<b>")) == "<b>"
    assert "<td>&lt;a&gt;</td>" in table(("x",), [["<a>"]])

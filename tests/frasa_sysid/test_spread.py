"""Work side by side: the same results in this process, in others and on a cluster."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.bootstrap import full_bootstrap
from frasa_sysid.calibration import run_command
from frasa_sysid.choice import Fold, held_out_error
from frasa_sysid.cli import build_parser
from frasa_sysid.errors import UsageError
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.spread import Spread, spread_over
from frasa_sysid.writer import write_mcap


def frasa(*words):
    return run_command(build_parser(), [str(word) for word in words])


def first(recording, seconds):
    position = recording.signals["position"]
    kept = position.t < seconds
    short = Signal("position", "rad", position.t[kept], position.y[kept])
    return replace(recording, signals={**recording.signals, "position": short})


@pytest.fixture(scope="module")
def short(robot_model_dir):
    """Four short recordings of the project's own bench log."""
    recordings = read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")
    return [first(recordings[i], 2.6) for i in (1, 8, 20, 33)]


@pytest.fixture(scope="module")
def problem(kit, short):
    return kit.problem(kit.runs(short), seed=3)


@pytest.fixture(scope="module")
def alone(kit, problem):
    """Bootstrap interval of five draws, all in this process."""
    return full_bootstrap(problem, kit.session, problem.start_values(), 5, Spread())


@pytest.fixture(scope="module")
def scheduler():
    """Address of a Dask cluster on this machine, two workers that are processes of their own."""
    distributed = pytest.importorskip("distributed", reason="no Dask here: pip install 'frasa[cluster]'")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster:
        yield cluster.scheduler_address


def test_order_is_that_of_the_tasks():
    tasks = list(range(-9, 9))
    assert Spread(2).map(abs, tasks) == Spread().map(abs, tasks) == [abs(one) for one in tasks]
    assert Spread(2).map(abs, []) == []
    assert Spread(2).map(abs, [-3]) == [3]
    assert (Spread().local, Spread(2).local, Spread(1, "dask").local) == (True, False, False)


def test_two_processes_find_what_one_does(kit, problem, alone):
    assert np.ptp(alone, axis=1).max() > 0.0
    assert np.array_equal(full_bootstrap(problem, kit.session, problem.start_values(), 5, Spread(2)), alone)


def test_a_cluster_finds_what_one_process_does(kit, problem, alone, scheduler):
    with spread_over(1, scheduler) as spread:
        assert not spread.local
        assert np.array_equal(full_bootstrap(problem, kit.session, problem.start_values(), 5, spread), alone)


def test_an_error_on_the_way_is_an_error_here(kit, problem):
    """A fold that leaves nothing to fit fails, wherever it is done."""
    with pytest.raises(ValueError):
        held_out_error(problem, problem.to_unit(problem.start_values()), Fold("", "", (0, 1, 2, 3)), kit.session)
    for spread in (Spread(), Spread(2)):
        with pytest.raises(TypeError):
            spread.map(len, [1, 2])


@pytest.mark.parametrize("address", ["nowhere", "", "ftp://x:1"])
def test_bad_addresses(address):
    pytest.importorskip("distributed", reason="no Dask here: pip install 'frasa[cluster]'")
    with pytest.raises(UsageError, match=f"--cluster {address}: no Dask scheduler answers"), spread_over(1, address):
        pass


@pytest.fixture
def place(robot_model_dir, tmp_path, short):
    """The nominal robot model, and a log beside it."""
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, tmp_path)
    write_mcap(tmp_path / "log.mcap", short)
    return tmp_path


def fit_words(place, *more):
    words = ("fit", place / "log.mcap", "--model", place / "nominal.xml", "--no-report", "--evaluations", 20)
    return *words, "--restarts", 1, *more


def test_nobody_at_the_address_is_one_line(place, monkeypatch, capsys):
    """A port that nothing listens on; the wait is short here, not the way."""
    distributed = pytest.importorskip("distributed", reason="no Dask here: pip install 'frasa[cluster]'")
    client = distributed.Client
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: client(address, timeout="0.2s"))
    assert frasa(*fit_words(place, "--cluster", "tcp://127.0.0.1:1")) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "--cluster tcp://127.0.0.1:1: no Dask scheduler answers there" in said[0]
    assert frasa(*fit_words(place, "--jobs", 0)) == 2
    assert "--jobs 0: expected 1 or more" in capsys.readouterr().err


def test_jobs_do_not_change_the_fit_file(place, capsys):
    made = []
    for jobs, seed in ((1, 3), (2, 3), (2, 4)):
        out = place / f"{jobs}{seed}" / "mx106.json"
        assert frasa(*fit_words(place, "--jobs", jobs, "--bootstrap", 4, "--seed", seed, "--out", out)) == 0
        made.append(out.read_bytes())
    capsys.readouterr()
    assert made[0] == made[1] != made[2]
    fit = json.loads(made[0])
    assert fit["bootstrap_draws"] == 4
    assert all(one["refit_low"] <= one["refit_high"] for one in fit["parameters"].values())

"""Many agents are trained whatever happens: some fail, all are killed, others do the work."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.cli import main
from frasa_rl.evaluate import Evaluation
from frasa_rl.policy import Policy
from frasa_rl.protocol_standup import StandUpTrial
from frasa_rl.sweep_files import Sweep
from frasa_rl.sweep_run import Order, objection_of, run_agent

TINY = (
    "envs=4", "pool=8", "batch=16", "actor=16,16", "critic=16,16", "learning_starts=40", "renorm_warmup=20",
    "evaluate_falls=1", "evaluate_physics=fast", "evaluate_steps=0", "checkpoint_steps=64", "updates_per_step=0.1",
)  # fmt: skip
SETTINGS = [word for one in (*TINY, "end_gyro=5") for word in ("--set", one)]


@pytest.fixture(scope="module")
def model(robot_model_dir):
    return str(robot_model_dir / "nominal.xml")


@pytest.fixture(scope="module", autouse=True)
def _paths():
    """Agents, and workers of a cluster, have the frasa that is tested."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(Path(__file__).parents[2])
    yield
    del os.environ["PYTHONPATH"]
    if before is not None:
        os.environ["PYTHONPATH"] = before


def begin(out, model, *more):
    return ["sweep", "--model", model, "--device", "cpu", "--out", str(out), *SETTINGS, *more]


def reached(run):
    """Steps of the newest checkpoint."""
    return max((int(one.name[:9]) for one in (run / "checkpoints").glob("0*")), default=0)


@pytest.fixture(scope="module")
def killed(model, tmp_path_factory):
    """A sweep of two agents whose processes all were killed when the first had a checkpoint to go on from."""
    out = tmp_path_factory.mktemp("sweep") / "killed"
    words = begin(out, model, "--seeds", "2", "--first-seed", "7", "--jobs", "2", "--steps", "1000000")
    sweep = subprocess.Popen(
        [sys.executable, "-m", "frasa_rl.cli", *words], start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    until = time.monotonic() + 600.0  # against a hang only: the learner may have to compile first
    try:
        while reached(out / "seed-0007") < 64:
            assert sweep.poll() is None, sweep.communicate()[1]
            assert time.monotonic() < until, "the sweep hangs"
            time.sleep(0.01)
    finally:
        os.killpg(sweep.pid, signal.SIGKILL)
        sweep.communicate()
    return out


@pytest.fixture(scope="module")
def resumed(killed):
    """The same, gone on with to a nearer end."""
    steps = max(reached(killed / f"seed-000{seed}") for seed in (7, 8)) + 320
    assert main(["sweep", "--resume", str(killed), "--steps", str(steps), "--jobs", "2"]) == 0
    return killed, steps


def test_a_killed_sweep_goes_on(resumed):
    """Both agents come to the end, each as an ordinary run folder; the tables speak of both."""
    out, steps = resumed
    for seed in (7, 8):
        run = out / f"seed-000{seed}"
        assert Policy.load(run / "latest").run["trained"]["steps"] >= steps
        said = yaml.safe_load((run / "run.yaml").read_text())
        assert (said["settings"]["seed"], said["settings"]["actor"]) == (seed, [16, 16])
        assert json.loads((run / "result.json").read_text())["stopped"] == "steps"
    assert "going on in" in (out / "seed-0007" / "agent.log").read_text()
    rows = [line.split(",") for line in (out / "sweep.csv").read_text().splitlines()]
    assert rows[0][:3] == ["seed", "steps", "minutes"]
    assert [(row[0], float(row[1]) >= steps) for row in rows[1:]] == [("7", True), ("8", True)]
    said = json.loads((out / "sweep.json").read_text())
    assert said["schema"] == "frasa.sweep/1"
    assert [one["state"] for one in said["agents"]] == ["done", "done"]
    assert {"mujoco", "torch", "frasa"} <= set(said["run"]["versions"])
    assert (out / "sweep.png").stat().st_size > 5000
    first, second = (Policy.load(out / f"seed-000{seed}" / "latest").layers[0][0] for seed in (7, 8))
    assert not np.array_equal(first, second)


def test_what_is_over_is_left(resumed, capsys):
    """Nothing is trained again, and the object for machines is there."""
    out, _ = resumed
    log = (out / "seed-0008" / "agent.log").read_bytes()
    assert main(["sweep", "--resume", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [(one["seed"], one["state"]) for one in said["agents"]] == [(7, "done"), (8, "done")]
    assert said["ranking"] is None
    assert (out / "seed-0008" / "agent.log").read_bytes() == log


def test_the_best_are_ranked(resumed, model, tmp_path, monkeypatch, capsys):
    """--rank puts as many as it says through the protocol, the best by held-out falls."""
    out, steps = resumed
    evaluated = tmp_path / "sweep"
    said = json.loads((out / "sweep.json").read_text())
    said["run"]["settings"]["evaluate_steps"] = 100
    said["seeds"] = [7, 8, 9]
    evaluated.mkdir()
    (evaluated / "sweep.json").write_text(json.dumps(said))
    for seed, success in ((7, 0.25), (8, 0.75), (9, 0.5)):
        run = evaluated / f"seed-000{seed}"
        source = out / f"seed-000{min(seed, 8)}"
        run.mkdir()
        for name in ("policy", "result.json", "progress.csv"):
            (run / name).symlink_to(source / name)
        (run / "evaluations.csv").write_text(
            f"steps,minutes,set,success_prone,success_supine,time_s,best\n{steps},1,0,{success},{success},2,1\n"
        )
    ran = []

    def evaluate(controller, conditions, standup, push, tell):
        ran.append((controller.name, conditions.randomize))
        return Evaluation([StandUpTrial(side, 2.0, 2.0, False, np.ones(5)) for side in ("prone", "supine")], [])

    monkeypatch.setattr("frasa_rl.commands.rank.evaluate", evaluate)
    assert main(["sweep", "--resume", str(evaluated), "--rank", "2", "--json"]) == 0
    told = capsys.readouterr()
    names = [str(evaluated / f"seed-000{seed}") for seed in (8, 9)]
    assert ran == [(name, drawn) for name in names for drawn in (False, True)]
    kept = json.loads((evaluated / "rank.json").read_text())
    assert {one["name"] for one in kept["candidates"]} == set(names)
    assert json.loads(told.out)["ranking"] == kept
    assert "mean rank" in told.err


def test_a_cluster_trains_them_and_a_failing_one_is_alone(model, tmp_path, capsys):
    """The same through Dask; who fails is named with what it said, the others come to the end, the status is not 0."""
    distributed = pytest.importorskip("distributed", reason="no Dask here: pip install 'frasa[cluster]'")
    out = tmp_path / "s"
    (out / "seed-0000").mkdir(parents=True)
    (out / "seed-0000" / "run.yaml").write_text("- no run\n")
    with distributed.LocalCluster(
        1, threads_per_worker=2, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
    ) as cluster:
        words = begin(out, model, "--seeds", "2", "--steps", "64", "--cluster", cluster.scheduler_address)
        assert main(words) == 1
    told = capsys.readouterr().err
    assert "1 of 2 agents failed" in told
    assert "seed 0: frasa-rl: " in told
    assert "expected a mapping" in told
    states = [one["state"] for one in json.loads((out / "sweep.json").read_text())["agents"]]
    assert states == ["failed", "done"]
    assert Policy.load(out / "seed-0001" / "latest").run["trained"]["steps"] == 64
    assert not (out / "stop").exists()


def test_workers_with_other_files_are_refused(model, tmp_path):
    """Without the folder, with another frasa, without the model, or with another one: each is said."""
    from frasa_sysid.calibration import load_model, model_sha256

    version = objection_of.__globals__["__version__"]
    own = model_sha256(load_model(Path(model)))
    here = tmp_path / "sweep.json"
    assert "all workers share" in objection_of(here, model, own, version)
    here.touch()
    assert "it has frasa" in objection_of(here, model, own, "0.0.0")
    assert "no model at" in objection_of(here, str(tmp_path / "none.xml"), own, version)
    assert "is another model" in objection_of(here, model, "0" * 64, version)
    assert objection_of(here, model, own, version) == ""


def test_an_agent_stops_when_it_is_asked_to(model, tmp_path):
    """A file named stop ends a sweep: nobody begins any more, and it can be resumed."""
    (tmp_path / "stop").touch()
    order = Order(0, Sweep(tmp_path, (0,), {}).folder(0), {"device": "cpu"})
    assert run_agent(order, {}).state == "waiting"
    assert not order.out.exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--steps", "10"], 2, "give --seeds"),
        (["--seeds", "0", "--steps", "10"], 2, "--seeds 0: expected 1 .. 10,000"),
        (["--seeds", "1", "--first-seed", "-1", "--steps", "10"], 2, "--first-seed -1"),
        (["--seeds", "20", "--first-seed", "4294967280", "--steps", "10"], 2, "the last seed would be 4294967299"),
        (["--seeds", "1", "--minutes", "nan"], 2, "--minutes is nan"),
        (["--resume", "missing", "--minutes", "inf"], 2, "--minutes is inf"),
        (["--resume", "missing", "--steps", "-5"], 2, "--steps is -5"),
        (["--seeds", "1", "--jobs", "0", "--steps", "10"], 2, "--jobs 0: expected 1 .. 10,000"),
        (["--seeds", "1", "--jobs", "2", "--cluster", "tcp://a:1"], 2, "--jobs is of this machine"),
        (["--seeds", "1", "--rank", "-1", "--steps", "10"], 2, "--rank -1"),
        (["--seeds", "1", "--steps", "10", "--set", "seed=3"], 2, "--first-seed and those after"),
        (["--seeds", "1", "--steps", "10", "--set", "sed=3"], 2, "no setting 'sed'"),
        (["--seeds", "1"], 2, "needs an end"),
        (["--seeds", "1", "--steps", "10", "--rank", "1", "--evaluate-steps", "0"], 2, "chooses by held-out falls"),
        (["--seeds", "1", "--steps", "10", "--model", "missing.xml"], 3, "no model at missing.xml"),
        (["--resume", "missing"], 3, "no sweep at missing"),
        (["--resume", "missing", "--first-seed", "1"], 2, "--first-seed from the run itself"),
        (["--resume", "missing", "--set", "batch=1"], 2, "--set from the run itself"),
    ],
)
def test_bad_arguments_are_one_line(words, code, message, model, monkeypatch, tmp_path, capsys):
    """Nothing is begun, and the line says what to do."""
    monkeypatch.chdir(tmp_path)
    given = [] if "--model" in words or "--resume" in words else ["--model", model]
    assert main(["sweep", *given, *words]) == code
    told = capsys.readouterr().err
    assert message in told
    assert len(told.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_sweep_is_not_overwritten(resumed, model, capsys):
    """A second one into the same folder is refused, and so are fewer agents than there are."""
    out, _ = resumed
    assert main(begin(out, model, "--seeds", "2", "--steps", "10")) == 2
    assert "already holds a sweep" in capsys.readouterr().err
    assert main(["sweep", "--resume", str(out), "--seeds", "1"]) == 2
    assert "agents already" in capsys.readouterr().err


def test_nobody_at_the_address_leaves_nothing_in_the_way(model, tmp_path, monkeypatch, capsys):
    """One line, and the same command works when the cluster is there."""
    distributed = pytest.importorskip("distributed", reason="no Dask here: pip install 'frasa[cluster]'")
    client = distributed.Client
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: client(address, timeout="0.2s"))
    for _ in range(2):
        words = begin(tmp_path / "s", model, "--seeds", "2", "--steps", "10", "--cluster", "tcp://127.0.0.1:1")
        assert main(words) == 2
        assert "no Dask scheduler answers there" in capsys.readouterr().err

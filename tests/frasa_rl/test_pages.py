"""The pages of training, evaluation and the demo: real numbers, whole on their own, and never in the way."""

import json
import os
import shutil
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("sb3_contrib")
pytest.importorskip("matplotlib")

from frasa_rl.cli import main
from frasa_rl.controllers import Nothing
from frasa_rl.demo_page import write_page
from frasa_rl.evaluate import Evaluation
from frasa_rl.evaluation_page import write_evaluation_page
from frasa_rl.film import Film
from frasa_rl.held_out import SEED
from frasa_rl.policy import Policy, read_run
from frasa_rl.protocol import Conditions, evaluation_task
from frasa_rl.protocol_push import PushTrial
from frasa_rl.protocol_standup import StandUpTrial
from frasa_rl.run_page import write_run_page
from frasa_rl.strips import strip
from frasa_rl.sweep_files import Sweep
from frasa_rl.sweep_page import write_sweep_page
from frasa_rl.sweep_table import AGENTS, agent_row
from frasa_rl.tables import EVALUATIONS, PROGRESS

EVIL = "<script>alert('x')</script>&\"$\\frac"
TINY = [
    word
    for one in (
        "envs=4", "pool=8", "batch=16", "actor=16,16", "critic=16,16", "learning_starts=40", "renorm_warmup=20",
        "evaluate_falls=1", "evaluate_physics=fast", "updates_per_step=0.1", "end_gyro=5",
    )
    for word in ("--set", one)
]  # fmt: skip


@pytest.fixture(scope="module")
def begin(robot_model_dir):
    """Words of a small run."""
    return ["train", "--model", str(robot_model_dir / "nominal.xml"), "--device", "cpu", *TINY]


@pytest.fixture(scope="module")
def run(begin, tmp_path_factory):
    """A small run that tried its policy on held-out falls three times, without a page."""
    out = tmp_path_factory.mktemp("pages") / "run"
    words = ["--steps", "1920", "--evaluate-steps", "640", "--seed", "7", "--no-report", "--out", str(out)]
    assert main([*begin, *words]) == 0
    return out


@pytest.fixture
def blind(monkeypatch):
    """A machine that cannot draw without a window."""

    def broken(*_):
        raise ImportError("no EGL")

    monkeypatch.setattr("mujoco.Renderer", broken)


@pytest.fixture(scope="module")
def results():
    """An evaluation with successes, failures and an unknown number of the paper."""
    strain = np.array([7.5, 4.25, 310.0, 12.5, 0.05])
    standup = [
        StandUpTrial("prone", 2.0, 2.25, False, strain),
        StandUpTrial("prone", 3.0, 3.25, False, strain),
        StandUpTrial("supine", None, None, True, strain),
    ]
    push = [
        PushTrial("front", 4.0, True, True, 3.1, 0.5, False, False, strain),
        PushTrial("back", 7.3, True, True, 3.3, None, True, False, strain),
    ]
    about = {"schema": "frasa.evaluation/2", "controller": "c", "model": "m.xml", "calibration_id": None}
    return {**Evaluation(standup, push).to_dict(), **about, "rate_hz": 20.0, "randomized": False, "seed": 10_000}


def test_a_run_leaves_a_page(begin, tmp_path, capsys, page_text, blind):
    """frasa-rl train names its page, which tells of this very run; resumed, the page tells of the longer one."""
    out = tmp_path / "run"
    words = ["--steps", "640", "--evaluate-steps", "320", "--seed", "7", "--out", str(out), "--json"]
    assert main([*begin, *words]) == 0
    said, err = capsys.readouterr()
    page = Path(json.loads(said)["outputs"]["report"])
    assert page == out / "report.html"
    assert f"report: {page}" in err
    text = page_text(page)
    told, rows = read_run(out / "run.yaml"), EVALUATIONS.read(out)
    assert len(rows) >= 2
    for row in rows:
        assert f"{row[0]:,.0f} {row[1]:.2f} {100 * row[3]:.0f} {100 * row[4]:.0f}" in text
    best = [row for row in rows if row[-1]][-1]
    assert f"best policy, at {best[0]:,.0f} steps" in text
    steps = PROGRESS.read(out)[-1][0]
    assert f"{steps:,.0f} steps" in text
    for one in (
        "How it learned", "lies still earns up to 25", "Held-out falls", "Settings", "learning_rate 0.001", "crossq",
        "It ended at the number of transitions", told["model_sha256"], "none: a nominal model",
        f"training 7, held-out {SEED}", f"mujoco {told['versions']['mujoco']}", "640 transitions",
    ):  # fmt: skip
        assert one in text, one
    assert text.count("No pictures of the robot") == 1
    assert "cannot draw without a window (ImportError: no EGL)" in text
    assert str(tmp_path) not in text
    assert main(["train", "--resume", str(out), "--steps", str(int(steps) + 320)]) == 0
    assert f"{PROGRESS.read(out)[-1][0]:,.0f} steps" in page_text(page) != text


def test_an_interrupted_run_leaves_a_page(begin, tmp_path, capsys, page_text, blind):
    """Ctrl-C ends with 130 as ever, and the page says that the run can go on."""
    out = tmp_path / "run"

    def stop():
        while not PROGRESS.read(out):
            if over.wait(0.05):
                return
        os.kill(os.getpid(), signal.SIGINT)

    over = threading.Event()
    beside = threading.Thread(target=stop)
    beside.start()
    try:
        assert main([*begin, "--steps", "10000000", "--evaluate-steps", "0", "--out", str(out)]) == 130
    finally:
        over.set()
        beside.join()
    assert "continue with --resume" in capsys.readouterr().err
    text = page_text(out / "report.html")
    assert "It was interrupted; all of it is saved." in text
    assert "no policy was tried" in text


@pytest.mark.parametrize("what", ["drawing", "matplotlib", "disk"])
def test_a_page_that_cannot_be_made_is_no_failure(what, begin, tmp_path, capsys, monkeypatch, blind):
    """A run that is over ends with 0 and its result, and one line says why there is no page."""

    def broken(*_):
        raise OSError(28, "No space left on device") if what == "disk" else ValueError("a broken\nfigure")

    if what == "matplotlib":
        monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    else:
        monkeypatch.setattr("frasa_rl.run_page." + ("write_atomic" if what == "disk" else "curve_figure"), broken)
        monkeypatch.setattr("frasa_rl.curve.curve_figure", lambda _: pytest.importorskip("matplotlib.figure").Figure())
    out = tmp_path / "run"
    assert main([*begin, "--steps", "40", "--evaluate-steps", "0", "--out", str(out), "--json"]) == 0
    said, err = capsys.readouterr()
    assert json.loads(said)["outputs"] == {"report": None}
    line = {"drawing": "a broken figure", "matplotlib": "pip install 'frasa[report]'", "disk": "No space left"}[what]
    assert [line in one for one in err.splitlines() if one.startswith("no report page: ")] == [True]
    assert Policy.load(out).run["trained"]["steps"] >= 40
    assert not (out / "report.html").exists()


def test_the_page_of_a_run_keeps_names_text(run, tmp_path, page_text, blind):
    """Whatever a run.yaml says, nothing of it becomes HTML; a folder without numbers has a page too."""
    evil = tmp_path / f"{EVIL.replace('/', '')}"
    shutil.copytree(run, evil)
    said = read_run(run / "run.yaml")
    said.update(model=EVIL, calibration_id=EVIL, model_sha256=EVIL, versions={EVIL: EVIL}, seeds={EVIL: EVIL})
    said["settings"] |= {"algorithm": EVIL, EVIL: EVIL}
    (evil / "run.yaml").write_text(yaml.safe_dump(said))
    shutil.rmtree(evil / "policy")
    path = write_run_page(evil, "steps")
    assert page_text(path).count(EVIL) >= 8
    assert "<script>alert" not in path.read_text()
    for file in (PROGRESS.file, EVALUATIONS.file):
        (evil / file).unlink()
    assert "How it learned" not in page_text(write_run_page(evil, "steps"))


def test_the_page_of_an_evaluation(results, nominal, tmp_path, page_text):
    """Both tables beside the paper's, cards, strain and strips; names from outside stay text."""
    task = evaluation_task()
    conditions = Conditions(nominal, task)
    path = write_evaluation_page(tmp_path / "e.html", {**results, "controller": "nothing"}, Nothing(task), conditions)
    text = page_text(path)
    for one in (
        "prone 2 100% 2.500 ± 0.500 2.135 ± 0.042 3.154", "supine 1 0% - 2.678 ± 0.178 5.060",
        "front 4.0 J 1 100% 0 0 0 0.50 ± 0.00 0.54", "back 7.3 J 1 0% 1 0 0 - -",
        "from prone 2.50 s 100 % of 2 trials; the paper's agent: 2.135 s", "pushes 1 of 2 stable again",
        "largest torque of any servo at any instant 7.5 N m", "measured on the robot itself", "10000",
        "The simulation blew up in 1 trials",
    ):  # fmt: skip
        assert one in text, one
    assert text.count("does not stand up") + text.count("No pictures of the robot") in (1, 2)
    bad = {**results, "controller": f"{EVIL}.yaml", "model": EVIL, "calibration_id": EVIL, "push": []}
    path = write_evaluation_page(tmp_path / "evil.html", bad, Nothing(task), conditions)
    assert page_text(path).count(EVIL) >= 4
    assert "<script>alert" not in path.read_text()


def test_without_a_display_a_page_says_so_once(results, nominal, tmp_path, page_text, blind):
    """One sentence in place of all strips."""
    task = evaluation_task()
    path = write_evaluation_page(
        tmp_path / "e.html", results | {"controller": "nothing"}, Nothing(task), Conditions(nominal, task)
    )
    text = page_text(path)
    assert text.count("cannot draw without a window") == 1
    assert "MUJOCO_GL=egl" in text


def test_a_strip_has_pictures_with_their_times():
    """Each picture of a film becomes one of the page, below it when it was."""
    frames = [np.full((12, 16, 3), shade, dtype=np.uint8) for shade in (0, 120, 240)]
    html = strip(Film(frames, 20.0, 0.5, [0.0, 0.25, 0.5]))
    assert html.count("data:image/webp;base64,") == 3
    assert [html.count(f"<figcaption>{time} s<") for time in ("0.00", "0.25", "0.50")] == [1, 1, 1]


def test_the_page_of_a_sweep(run, tmp_path, page_text):
    """A row for every agent, also for one that failed, the spread, and the ranking where there is one."""
    shutil.copytree(run, tmp_path / "sweep" / "seed-0007")
    sweep = Sweep(tmp_path / "sweep", (7, 8), read_run(run / "run.yaml"))
    agents = [
        {**dict(zip(AGENTS.columns, agent_row(seed, sweep.folder(seed)), strict=True)), "seed": seed, **more}
        for seed, more in ((7, {"state": "done", "why": None}), (8, {"state": "failed", "why": EVIL}))
    ]
    ranks = {"speed": 1.0, "robustness": 1.5, "safety": 2.0, "versatility": 1.0}
    ranking = {"candidates": [{"name": "a/seed-0007", "place": 1, "mean_rank": 1.375, "ranks": ranks}]}
    path = write_sweep_page(sweep, agents, ranking)
    text = page_text(path)
    for one in ("1 done, 1 failed", "best agent seed 7", "0 of 2", "1 seed-0007 1 1.5 2 1 1.38", EVIL):
        assert one in text, one
    assert f"7 done {PROGRESS.read(run)[-1][0]:,.0f}" in text
    assert 'alt="spread of return' in path.read_text()
    assert "The best by the protocol" not in page_text(write_sweep_page(sweep, agents, None))


def test_the_page_of_the_demo(run, results, robot_model_dir, tmp_path, page_text, law_as_before):
    """The published fits, the run and both evaluations on one page of the same look."""
    fit = json.loads((robot_model_dir / "fits" / "mx106.json").read_text())
    fit |= {"seconds": 12.0, "outputs": {"report": None}}
    train = {"steps": 1920, "minutes": 0.5, "return_first": 3.0, "return_last": 21.5, "held_out": None}
    found = {"mx106": fit, "train": train, "evaluate": results, "nothing": results}
    film = tmp_path / "none.webp"
    path = write_page(tmp_path, [(EVIL, EVIL, 3.0)], found, run, film, robot_model_dir / "calibrated.xml")
    text = page_text(path)
    for name, one in fit["parameters"].items():
        assert f"{name} {one['nominal']:.4g} {one['value']:.4g} {one['low']:.4g} to {one['high']:.4g}" in text
    for one in ("Fit of the mx106", "3.0 to 21.5", "2.500 ± 0.500", "No picture: none.webp was not made", EVIL):
        assert one in text, one
    assert "<script>alert" not in path.read_text()

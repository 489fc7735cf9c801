"""The numbers of a sweep are those of its run folders, worked out by hand here."""

import csv
import math

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.sweep_files import Sweep
from frasa_rl.sweep_picture import draw_sweep
from frasa_rl.sweep_table import AGENTS, agent_row, by_merit, curve, spread
from frasa_rl.sweep_watch import Watch
from frasa_rl.tables import EVALUATIONS, PROGRESS

NAN = float("nan")


def folder(path, progress, evaluations=()):
    """A run folder with (steps, minutes, return) and (steps, minutes, prone, supine, time, best) in its tables."""
    PROGRESS.write(path, [[*one, 90, 0, 0, 0, 10, 100, 10] for one in progress])
    if evaluations:
        EVALUATIONS.write(path, [[a, b, 0, c, d, e, f] for a, b, c, d, e, f in evaluations])
    return path


@pytest.fixture
def good(tmp_path):
    """Half of the falls at 200 steps, nine tenths at 400, best at 500, worse again at the end."""
    return folder(
        tmp_path / "seed-0003",
        [(100, 1.0, 10.0), (300, 2.0, 50.0), (600, 4.0, 40.0)],
        [
            (100, 1.0, 0.2, 0.6, 4.0, 1),
            (200, 1.5, 1.0, 0.0, 3.0, 1),
            (300, 2.0, 0.25, 0.5, 3.0, 0),
            (400, 2.75, 0.875, 0.925, 3.0, 1),
            (500, 3.0, 1.0, 0.9, 2.5, 1),
            (600, 4.0, 0.8, 0.8, 2.0, 0),
        ],
    )


def named(row):
    return dict(zip(AGENTS.columns, row, strict=True))


def test_times_to_success_by_hand(good):
    """Both sides count alike, and a success is had when an evaluation shows it, not between two."""
    got = named(agent_row(3, good))
    assert (got["seed"], got["steps"], got["minutes"]) == (3, 600, 4.0)
    assert (got["steps_to_50"], got["minutes_to_50"]) == (200, 1.5)
    assert (got["steps_to_90"], got["minutes_to_90"]) == (400, 2.75)
    assert (got["success_prone"], got["success_supine"], got["time_s"]) == (1.0, 0.9, 2.5)
    assert got["success"] == pytest.approx(0.95)
    assert (got["best_steps"], got["best_minutes"]) == (500, 3.0)
    assert (got["return"], got["return_best"]) == (40.0, 50.0)


def test_what_has_not_been_is_left_out(tmp_path):
    """An agent without evaluations or rows has empty cells, in the file too."""
    rows = [agent_row(0, tmp_path / "nothing"), agent_row(1, folder(tmp_path / "begun", [(100, 1.0, 7.0)]))]
    assert [math.isnan(one) for one in rows[0]] == [False] + [True] * (len(AGENTS.columns) - 1)
    assert (named(rows[1])["return"], math.isnan(named(rows[1])["steps_to_50"])) == (7.0, True)
    AGENTS.write(tmp_path, rows)
    with (tmp_path / "sweep.csv").open() as file:
        read = list(csv.DictReader(file))
    assert read[0]["seed"] == "0"
    assert read[0]["success"] == read[1]["minutes_to_90"] == ""


def test_merit_is_success_then_speed():
    """Equals by their time; who was never evaluated is no candidate."""
    blank = dict.fromkeys(AGENTS.columns, NAN)
    made = [(0, 0.5, 2.0), (1, 0.75, 4.0), (2, 0.75, 3.0), (3, NAN, NAN), (4, 0.0, NAN), (5, 0.0, NAN)]
    rows = [[*{**blank, "seed": seed, "success": part, "time_s": time}.values()] for seed, part, time in made]
    assert by_merit(rows) == [2, 1, 0, 4, 5]


def test_the_spread_continues_nobody():
    """Where one of three curves is over the others are the spread; beyond all there is none."""
    curves = [(np.array([0.0, 4.0]), np.array([0.0, 4.0])), (np.array([0.0, 2.0]), np.array([10.0, 10.0]))]
    curves += [(np.array([1.0, 4.0]), np.array([2.0, 2.0])), (np.zeros(0), np.zeros(0))]
    got = spread(curves, points=5)
    np.testing.assert_array_equal(got.x, [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(got.count, [2, 3, 3, 2, 2])
    np.testing.assert_array_equal(got.levels[2], [5.0, 2.0, 2.0, 2.5, 3.0])
    np.testing.assert_array_equal(got.levels[0], [0.0, 1.0, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(got.levels[4], [10.0, 10.0, 10.0, 3.0, 4.0])
    assert got.levels[3][1] == 6.0  # of 1, 2, 10
    apart = spread([(np.array([0.0, 1.0]), np.zeros(2)), (np.array([3.0, 4.0]), np.zeros(2))], points=5)
    np.testing.assert_array_equal(apart.count, [1, 1, 0, 1, 1])
    assert np.isnan(apart.levels[:, 2]).all()
    assert spread([]).x.size == 0


def test_curves_of_a_run(good):
    """Return and the mean success of both sides, against either axis."""
    np.testing.assert_array_equal(curve(good, "return", "minutes")[0], [1.0, 2.0, 4.0])
    np.testing.assert_allclose(curve(good, "success", "steps")[1], [0.4, 0.5, 0.375, 0.9, 0.95, 0.8])


def test_the_picture_has_all_agents(good, tmp_path):
    """One agent alone, two of different length, none at all."""
    pytest.importorskip("matplotlib")
    assert draw_sweep(tmp_path, [tmp_path / "nothing"], Task()) is None
    alone = draw_sweep(tmp_path, [good], Task()).read_bytes()
    other = folder(tmp_path / "seed-0004", [(100, 1.0, 10.0), (400, 2.5, 20.0)])
    assert draw_sweep(tmp_path, [good, other], Task()).read_bytes() != alone


def test_the_time_left(tmp_path):
    """Two at a time: one half done in 3 min, one a quarter; the third begins when there is room."""
    run = {"steps": 1000, "minutes": None, "until_success": None, "settings": {}, "seeds": {}}
    sweep = Sweep(tmp_path, (0, 1, 2), run)
    assert math.isinf(Watch(sweep, 2).left_s())
    folder(sweep.folder(0), [(500, 3.0, 1.0)])
    folder(sweep.folder(1), [(250, 3.0, 1.0)], [(200, 2.0, 0.5, 0.25, 3.0, 1)])
    watch = Watch(sweep, 2)
    assert watch.left_s() == pytest.approx(60.0 * (3.0 + 9.0 + 9.0) / 2)
    assert "0/3 agents done" in watch.text()
    assert "best: seed 1, held-out 50 % prone 25 % supine" in watch.text()
    watch.over.update({1: "done", 2: "failed"})
    assert watch.left_s() == pytest.approx(180.0)
    assert "1/3 agents done, 0 running, 1 failed" in watch.text()

"""The learning curve says what keeping still is worth."""

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.curve import draw_curve, still_return
from frasa_rl.standup_env import StandUp
from frasa_rl.tables import EVALUATIONS, PROGRESS


def test_lying_still_earns_no_more_than_the_reference(robot_model_dir):
    """A robot that lies on its back and does nothing earns nearly the reference, and not more."""
    env = StandUp(robot_model_dir / "nominal.xml", randomize=False)
    env.reset(seed=3, options={"start": "supine"})
    total, over = 0.0, False
    while not over:
        _, earned, terminated, truncated, info = env.step(np.zeros(5))
        total, over = total + earned - info["terms"]["posture"], terminated or truncated
    assert still_return(Task()) == pytest.approx(25.0)
    assert 0.5 * still_return(Task()) < total <= still_return(Task()) + 1e-9


def test_the_curve_shows_training_and_held_out_falls(tmp_path):
    """A picture of progress.csv, with the evaluations where there are some."""
    pytest.importorskip("matplotlib")
    assert draw_curve(tmp_path) is None
    PROGRESS.write(
        tmp_path, [[1000, 0.1, 20.0, 90, 0.0, 0.1, 0, 10, 100, 10], [2000, 0.2, 30.0, 95, 0.1, 0.2, 0, 20, 100, 10]]
    )
    plain = draw_curve(tmp_path).read_bytes()
    EVALUATIONS.write(tmp_path, [[1000, 0.1, 0, 0.5, 0.25, 3.0, 1], [2000, 0.2, 0, 0.5, 0.5, float("nan"), 1]])
    assert draw_curve(tmp_path).read_bytes() != plain

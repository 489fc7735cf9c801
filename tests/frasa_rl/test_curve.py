"""The learning curve says what keeping still is worth."""

import numpy as np
import pytest

from frasa_rl.config import Task
from frasa_rl.curve import still_return
from frasa_rl.standup_env import StandUp


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

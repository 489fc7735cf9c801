"""Single stand-up trials of a controller, as the tuner of keyframes needs them: ends of the task included.

A trial starts lying and ends with success, with the end of the episode, or after `episode_s`.
"""

from dataclasses import dataclass

import numpy as np

from frasa_rl.controllers import Controller
from frasa_rl.protocol import Side
from frasa_rl.standup_env import StandUp


@dataclass(frozen=True)
class Trial:
    """How one trial went.

    Attributes:
        time_s: from the first action to the start of the time held in the standing pose; NaN for a failure [s].
        worst_error: largest of the six errors, averaged over the trial's last half second [rad].
        ended: whether the episode ended early: fallen over or spinning too fast.
        lasted_s: until success, the early end, or the end of the time [s].
    """

    time_s: float
    worst_error: float
    ended: bool
    lasted_s: float


def run_trial(controller: Controller, env: StandUp, side: Side, seed: int, longest_s: float | None = None) -> Trial:
    """One robot, one fall, one try.

    Args:
        controller: started anew.
        env: made with a task whose `episode_s` is long enough.
        side: how the robot lies.
        seed: of the trial.
        longest_s: give up earlier than the episode does [s].
    """
    period = env.task.control_period_s
    observation, _ = env.reset(seed=seed, options={"start": side})
    controller.start(1, period)
    steps = round(min(longest_s or np.inf, env.task.episode_s) / period)
    worst: list[float] = []
    over, step = False, 0
    while step < steps and not over:
        observation, _, over, _, info = env.step(controller.act(observation[None])[0])
        worst.append(float(np.abs(env.errors()).max()))
        step += 1
        if info["is_success"]:
            return Trial(step * period - env.task.success_hold_s, worst[-1], False, step * period)
    recent = worst[-round(0.5 / period) :]
    return Trial(np.nan, float(np.mean(recent)), over, step * period)

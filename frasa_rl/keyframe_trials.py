"""Stand-up trials of a controller that sees and acts: success and times, from prone and from supine.

A trial starts lying and ends with success, with the end of the episode, or after `episode_s`.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from frasa_rl.evaluate import SIDES, Side
from frasa_rl.standup_env import StandUp


class Controller(Protocol):
    """Whatever drives robots through a trial; the same for keyframes and for policies."""

    name: str

    def start(self, count: int, period_s: float) -> None:
        """Forget everything; `count` robots, a decision every `period_s` [s]."""

    def act(self, observation: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Actions in [-1, 1], shape (count, n), for observations of shape (count, all that is observed)."""


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


def run_trials(controller: Controller, env: StandUp, trials: int, seed: int) -> dict[str, dict[str, Any]]:
    """Success rate and times over `trials` falls from each side.

    Returns:
        For each side `trials`, `success_rate`, `time_mean_s`, `time_std_s` and `time_max_s` (None without a success),
        and `ended`: how many trials the pitch or spin limit of the task ended.
    """
    result: dict[str, dict[str, Any]] = {}
    for side in SIDES:
        done = [run_trial(controller, env, side, seed + one) for one in range(trials)]
        times = np.array([one.time_s for one in done if np.isfinite(one.time_s)])
        result[side] = {
            "trials": trials,
            "success_rate": times.size / trials,
            "time_mean_s": float(times.mean()) if times.size else None,
            "time_std_s": float(times.std()) if times.size else None,
            "time_max_s": float(times.max()) if times.size else None,
            "ended": sum(one.ended for one in done),
        }
    return result

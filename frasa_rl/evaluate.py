"""Does a policy stand the robot up? The paper's measure: all six errors below 5 deg for 0.5 s.

Trials start lying prone or supine, at rest, each with a robot drawn from the same ranges
as in training. The time of a success runs from the first action to the start of the 0.5 s.
"""

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from frasa_rl.config import Task
from frasa_rl.observation import layout
from frasa_rl.policy import Policy, PolicyError
from frasa_rl.render import Frame
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import CalibrationError

SCHEMA = "frasa.evaluation/1"
Side = Literal["prone", "supine"]
SIDES: tuple[Side, ...] = ("prone", "supine")
TRIAL_S = 10.0  # the paper's keyframes need 5.06 s from supine: a training episode is too short to see them


def evaluation_task(task: Task | None = None) -> Task:
    """The task of training, by default the Sigmaban's, with more time."""
    return replace(task or Task(), episode_s=TRIAL_S)


def check_policy(policy: Policy, env: StandUp, *, allow_other_model: bool = False) -> None:
    """Raise when a policy does not belong to an environment.

    Raises:
        PolicyError: it was trained on another task, or sees or moves another number of things.
        CalibrationError: it was trained on another calibration, and that is not allowed.
    """
    inputs, outputs = policy.layers[0][0].shape[1], policy.layers[-1][0].shape[0]
    n = len(env.task.joints)
    wanted = (sum(part.size for part in layout(env.task)), n)
    if (inputs, outputs) != wanted:
        raise PolicyError(
            f"the policy sees {inputs} numbers and moves {outputs}; the task has {wanted[0]}, {wanted[1]}"
        )
    task = policy.run.get("task", {})
    joints = [one.get("name") for one in task.get("joints", [])]
    if joints != [one.name for one in env.task.joints] or task.get("rate_limit") != env.task.rate_limit:
        raise PolicyError("the policy was trained on another task (joints or rate limit differ)")
    trained_on = policy.run.get("calibration_id")
    if trained_on != env.calibration_id and not allow_other_model:
        raise CalibrationError(
            f"the policy was trained on calibration {trained_on or 'none (nominal)'}, "
            f"the model carries {env.calibration_id or 'none (nominal)'}; pass --allow-other-model to mean it"
        )


def run_trial(policy: Policy | None, env: StandUp, side: Side, seed: int, frames: list[Frame] | None = None) -> float:
    """Time to stand up [s], NaN for a failure.

    Args:
        policy: None holds every command where it is.
        env: made with `evaluation_task()`.
        side: how the robot lies.
        seed: of the trial.
        frames: where to add a picture of every control step; the trial then runs a second past success.
    """
    observation, _ = env.reset(seed=seed, options={"start": side})
    task, still = env.task, np.zeros(len(env.task.joints), dtype=np.float32)
    time_s, more = np.nan, round(1.0 / task.control_period_s)
    for step in range(1, round(task.episode_s / task.control_period_s) + 1):
        action = still if policy is None else policy.act(observation)
        observation, _, over, _, info = env.step(action)
        if frames is not None and (picture := env.render()) is not None:
            frames.append(picture)
        if info["is_success"] and np.isnan(time_s):
            time_s = step * task.control_period_s - task.success_hold_s
        more -= bool(np.isfinite(time_s))
        if over or (np.isfinite(time_s) and (frames is None or more < 0)):
            break
    return float(time_s)


def evaluate(policy: Policy | None, env: StandUp, trials: int, seed: int) -> dict[str, Any]:
    """Success rate and time, prone and supine, over `trials` robots and falls each.

    Returns:
        For each side `trials`, `success_rate`, `time_mean_s`, `time_std_s` (None without a success).
    """
    result: dict[str, Any] = {}
    for side in SIDES:
        times = np.array([run_trial(policy, env, side, seed + trial) for trial in range(trials)])
        good = times[np.isfinite(times)]
        result[side] = {
            "trials": trials,
            "success_rate": good.size / trials,
            "time_mean_s": float(good.mean()) if good.size else None,
            "time_std_s": float(good.std()) if good.size else None,
        }
    return result

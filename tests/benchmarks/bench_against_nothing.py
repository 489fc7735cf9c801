"""What a trained policy earns against doing nothing and against random actions, start by start.

A rising training return proves little by itself: exploration costs return, and a robot that only keeps still earns
most of the small terms. So each kind of start is played by all three, on the same robots and falls.

    python tests/benchmarks/bench_against_nothing.py RUN MODEL
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from frasa_rl.config import Task
from frasa_rl.policy import Policy
from frasa_rl.settings import Settings
from frasa_rl.standup_env import StandUp

SEED = 50_000  # none of training's own
EPISODES = {"any": 200, "target": 40, "falling": 40, "prone": 30, "supine": 30}
Act = Callable[[np.ndarray], np.ndarray]


def play(env: StandUp, act: Act, start: str, count: int) -> np.ndarray:
    """Return and success of each episode, shape (count, 2)."""
    rows = []
    for k in range(count):
        observation, _ = env.reset(seed=SEED + k, options={"start": start})
        total, over = 0.0, False
        while not over:
            observation, earned, terminated, truncated, info = env.step(act(observation))
            total, over = total + earned, terminated or truncated
        rows.append((total, info["is_success"]))
    return np.array(rows, dtype=float)


def main() -> int:
    if len(sys.argv) != 3:
        print("skipped: give a run folder and its model (RUN MODEL)")
        return 0
    policy, quick = Policy.load(sys.argv[1]), Settings()
    # The start mix that `any` draws from is that of the quick preset.
    task = replace(Task(), near_target_share=quick.near_target_share, falling_share=quick.falling_share)
    env = StandUp(Path(sys.argv[2]), task)
    rng = np.random.default_rng(0)
    players: dict[str, Act] = {
        "nothing": lambda _: np.zeros(5),
        "policy": policy.act,
        "random": lambda _: rng.uniform(-1.0, 1.0, 5),
    }
    for start, count in EPISODES.items():
        nothing = 0.0
        for name, act in players.items():
            rows = play(env, act, start, count)
            mean, error = rows[:, 0].mean(), rows[:, 0].std() / np.sqrt(count)
            nothing = mean if name == "nothing" else nothing
            print(
                f"{start:<9}{name:<9}return {mean:6.1f} +- {error:4.1f}   {mean / nothing:5.2f} of nothing   "
                f"ends standing {rows[:, 1].mean():6.1%}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())

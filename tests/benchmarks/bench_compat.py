"""Our task beside FRASA's published environment (`--compat frasa2024`): what their differences come to.

    python tests/benchmarks/bench_compat.py [MODEL] [EPISODES]

The same controllers in both, on starts of each: return and length of an episode, share that ends standing by the
paper's rule. Where the published environment's errors are random, so are its numbers: its starts ignore the seed.
"""

import sys
from pathlib import Path

import numpy as np

from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Task
from frasa_rl.controllers import Controller, Nothing
from frasa_rl.keyframe import KEYFRAMES, load_controller
from frasa_rl.observation import Observation
from frasa_rl.policy import Array
from frasa_rl.vec_env import StandUpVecEnv


class Random:
    """White noise."""

    name = "random actions"

    def start(self, count: int, period_s: float) -> None:
        self._rng = np.random.default_rng(0)

    def act(self, observation: Observation) -> Array:
        return self._rng.uniform(-1.0, 1.0, (len(observation), 5)).astype(np.float32)


def play(env: StandUpVecEnv, controller: Controller) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, length and success of the first episode of every robot."""
    seen = env.reset()
    controller.start(env.count, env.task.control_period_s)
    earned, length, stood = np.zeros(env.count), np.zeros(env.count), np.zeros(env.count, dtype=bool)
    going = np.ones(env.count, dtype=bool)
    while going.any():
        seen, reward, over, infos = env.step(controller.act(seen))
        earned, length = earned + reward * going, length + going
        for place in np.flatnonzero(over & going):
            stood[place] = infos[place]["is_success"]
        going &= ~over
    return earned, length, stood


def main() -> None:
    """Print the comparison."""
    model = Path(sys.argv[1] if len(sys.argv) > 1 else "robot_model/nominal.xml")
    episodes = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    print(f"{model}, {episodes} episodes each, robots randomized\n")
    print(f"{'':12} {'':16} return (of 125)   steps   ends standing")
    for name, task in (("ours", Task()), ("frasa2024", compat_task(Task()))):
        env = StandUpVecEnv(model, task, episodes, pool=episodes, seed=1, keep=False)
        knees = np.degrees([start.state[1 + env.core.batch.robot.qpos[3, 0]] for start in env.pool.starts])
        for controller in (Nothing(task), Random(), load_controller(KEYFRAMES, task)):
            earned, length, stood = play(env, controller)
            print(
                f"{name:12} {controller.name:16} {earned.mean():6.1f} +- {earned.std():5.1f}"
                f"   {length.mean():6.1f} {100 * stood.mean():9.0f} %"
            )
        straight, bent = (100 * np.mean(one) for one in (knees < 2.0, knees > 125.0))
        print(f"{name:12} starts: {straight:.0f} % of knees straight, {bent:.0f} % fully bent")
        env.close()


if __name__ == "__main__":
    main()

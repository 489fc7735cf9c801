"""Training: updates of ours, sb3-contrib's and SBX's CrossQ, steps of the environments, and both together, in one run.

    python tests/benchmarks/bench_training.py [--model robot_model/calibrated.xml] [--rounds 3] [--transitions 4096]
        [--sbx-python PATH]

First the updates alone at the sizes of the `quick` preset, as `bench_learner.py` measures them (SBX where there is a
Python for it). Then the whole: all learn the same task with the same sizes, physics and updates a transition (the
`quick` preset; rewards are summed over one step, as sb3-contrib does). "One robot" is how the published trainer
gathers: a Gymnasium environment and SB3's own loop; "robots together" gives SB3 our `StandUpVecEnv`. Ours is what
`frasa-rl train` runs, a round after the other: its steps a second hold stepping, replay, updates and waiting. Parts of
a round are timed alone as well, so that it can be seen what bounds it. Rounds are interleaved; ratios are medians of
those of each round.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from bench_learner import sbx_of, table
from sb3_contrib import CrossQ
from stable_baselines3.common.logger import Logger

from frasa_rl.plan import Plan
from frasa_rl.settings import PRESETS, Settings
from frasa_rl.standup_env import StandUp
from frasa_rl.train import make_loop
from frasa_rl.vec_env import StandUpVecEnv

WARM_UP = 6_000


def settings_of(**changes: object) -> Settings:
    """The quick preset, comparable with what sb3-contrib can do."""
    return replace(PRESETS["quick"], n_step=1, evaluate_steps=0, learning_starts=5_000, **changes)


class Theirs:
    """sb3-contrib's CrossQ in SB3's loop."""

    def __init__(self, plan: Plan, robots: int) -> None:
        own = plan.settings
        made = StandUp(plan.model, plan.task) if robots == 1 else StandUpVecEnv(plan.model, plan.task, robots)
        self.model = CrossQ(
            "MlpPolicy",
            made,
            policy_kwargs={"net_arch": {"pi": list(own.actor), "qf": list(own.critic)}},
            batch_size=own.batch,
            learning_rate=own.learning_rate,
            learning_starts=1_000,
            policy_delay=own.policy_delay,
            train_freq=max(1, own.rollout_steps // robots),
            gradient_steps=max(1, round(own.updates_per_step * own.rollout_steps)),
            buffer_size=50_000,
            seed=0,
        )
        self.model.set_logger(Logger(None, []))
        self(2_000)

    def __call__(self, transitions: int) -> float:
        before, began = self.model.num_timesteps, time.perf_counter()
        self.model.learn(transitions, reset_num_timesteps=False)
        return (self.model.num_timesteps - before) / (time.perf_counter() - began)


class Ours:
    """A run's rounds without what is written down of them."""

    def __init__(self, plan: Plan) -> None:
        self.loop = make_loop(plan)
        while self.loop.steps < WARM_UP:
            self.loop.round()

    def __call__(self, transitions: int) -> float:
        before, began = self.loop.steps, time.perf_counter()
        while self.loop.steps < before + transitions:
            self.loop.round()
        return (self.loop.steps - before) / (time.perf_counter() - began)

    def stepping(self, transitions: int) -> float:
        """Stepping alone."""
        actor, settings = self.loop.learner.actor(), self.loop._settings
        began = time.perf_counter()
        for _ in range(transitions // settings.envs):
            self.loop.collector.collect(actor, 1)
        return transitions // settings.envs * settings.envs / (time.perf_counter() - began)

    def updating(self, updates: int) -> float:
        """Updates alone, drawing the batches included."""
        began = time.perf_counter()
        self.loop._learn(updates)
        return updates / (time.perf_counter() - began)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, default=Path("robot_model/calibrated.xml"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--transitions", type=int, default=4096)
    parser.add_argument("--sbx-python", help="a Python that has sbx-rl")
    given = parser.parse_args()
    others = sbx_of(given.sbx_python)
    own = PRESETS["quick"]
    table((own.batch, own.actor, own.critic), given.rounds, others)
    for one in others.values():
        one.close()
    print()
    torch.set_num_threads(1)
    plan = Plan(given.model, Path(tempfile.mkdtemp()), settings_of(), steps=1)
    ours, half = Ours(plan), given.transitions // 4
    together, alone = Theirs(plan, plan.settings.envs), Theirs(plan, 1)
    each = plan.settings.updates_per_step
    runs: dict[str, tuple[float, Callable[[], float]]] = {
        "sb3-contrib, one robot": (each, lambda: alone(half)),
        "sb3-contrib, robots together": (each, lambda: together(half)),
        "ours": (each, lambda: ours(given.transitions)),
        "ours, stepping alone": (0.0, lambda: ours.stepping(given.transitions)),
        "ours, updates alone": (1.0, lambda: ours.updating(given.transitions // 2)),
    }
    found: dict[str, list[float]] = {name: [] for name in runs}
    print(
        f"{given.model}, {os.cpu_count()} cores, {plan.settings.envs} robots, {each:g} updates a transition,", end=" "
    )
    print(f"load before {os.getloadavg()[0]:.1f}; medians of {given.rounds} interleaved rounds")
    for _ in range(given.rounds):
        for name, (_, run) in runs.items():
            found[name].append(run())
    reference = np.array(found["sb3-contrib, one robot"])
    print(f"{'':32} steps/s  updates/s   x one robot, x together")
    for name, (share, _) in runs.items():
        rate = np.array(found[name])
        middle = float(np.median(rate))
        steps, updates = ("-" if "updates" in name else f"{middle:.0f}"), f"{share * middle:.0f}" if share else "-"
        ratios = [np.median(rate / reference), np.median(rate / found["sb3-contrib, robots together"])]
        told = "".join(f"{one:11.2f}" for one in ratios) if "alone" not in name else ""
        print(f"{name:32} {steps:>7} {updates:>10}   {told}")


if __name__ == "__main__":
    main()

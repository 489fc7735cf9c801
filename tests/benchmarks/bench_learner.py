"""CrossQ's updates per second: ours, sb3-contrib's, SBX's, at equal sizes and settings.

    python tests/benchmarks/bench_learner.py [--sbx-python PATH] [--rounds 7]

All learn from the same kind of buffer (random transitions of 22 observed and 5 acted numbers), two critics, Adam with
betas 0.5 and 0.999, the policy every third update. `train` is SB3's call with the draws from the replay buffer in it;
`update` is ours on batches that are given. SBX (JAX, all updates of a call in one compiled loop) runs with a Python of
its own, as it needs another environment than ours. "Products" are our matrix products of an update alone, with
nothing between them: what no arrangement of ours can beat. Rounds of all are interleaved, the best and the median are
printed; other work on the machine makes the median worse than the best, and CPU time shows what it would be alone.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SEEN, ACTED, DELAY = 22, 5, 3
SIZES = ((128, (128, 128), (128, 128)), (256, (256, 256), (256, 256)), (256, (384, 256), (384, 256)))


def model_of(kind: type, pi: tuple[int, ...], qf: tuple[int, ...], adam: dict | None):
    """A model of a class of SB3's, sb3-contrib's or SBX's kind."""
    import gymnasium
    from stable_baselines3.common.logger import Logger

    class Nothing(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-9, 9, (SEEN,), np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (ACTED,), np.float32)

        def reset(self, *, seed=None, options=None):
            return np.zeros(SEEN, np.float32), {}

        def step(self, action):
            return np.zeros(SEEN, np.float32), 0.0, False, False, {}

    extra = {"net_arch": {"pi": list(pi), "qf": list(qf)}, **({"optimizer_kwargs": adam} if adam else {})}
    settings = {"buffer_size": 20_000, "seed": 1, "policy_delay": DELAY, "learning_starts": 0, "learning_rate": 1e-3}
    model = kind("MlpPolicy", Nothing(), policy_kwargs=extra, **settings)
    model.set_logger(Logger(None, []))
    buffer, rng = model.replay_buffer, np.random.default_rng(0)
    buffer.observations[:] = rng.normal(size=buffer.observations.shape)
    buffer.next_observations[:] = rng.normal(size=buffer.observations.shape)
    buffer.actions[:] = rng.uniform(-1, 1, buffer.actions.shape)
    buffer.rewards[:] = rng.normal(size=buffer.rewards.shape)
    buffer.full = True
    return model


def seconds(call: Callable[[int], object], updates: int) -> list[float]:
    """Of one update, in a call of so many: on the wall clock, and of this process on all its cores."""
    began = time.perf_counter(), time.process_time()
    call(updates)
    ended = time.perf_counter(), time.process_time()
    return [(after - before) / updates for before, after in zip(began, ended, strict=True)]


def serve_sbx() -> None:
    """Answer each line of sizes with the seconds of an update; run by SBX's Python."""
    from sbx import CrossQ

    models: dict[str, object] = {}
    for line in sys.stdin:
        batch, pi, qf, updates = json.loads(line)
        if line not in models:
            models[line] = model_of(CrossQ, pi, qf, {"b1": 0.5})
            models[line].train(updates, batch)  # compiled
        took = seconds(lambda count, model=models[line], batch=batch: model.train(count, batch), updates)
        print(json.dumps(took), flush=True)


class Sbx:
    """SBX in a process of its own, on one core or on all."""

    def __init__(self, python: str, threads: int) -> None:
        cores = sorted(os.sched_getaffinity(0))
        self.process = subprocess.Popen(
            [python, __file__, "--serve-sbx"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, cores[:threads]),
        )

    def __call__(self, batch: int, pi: tuple[int, ...], qf: tuple[int, ...], updates: int) -> list[float]:
        print(json.dumps([batch, pi, qf, updates]), file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self.process.stdin.close()
        self.process.wait()


def batches_of(count: int, size: int):
    """Random batches for `update`."""
    from frasa_rl.batches import Batches

    rng = np.random.default_rng(0)

    def some(*shape: int) -> np.ndarray:
        return rng.normal(size=(count, size, *shape)).astype(np.float32)

    ends = np.zeros((count, size), np.float32)
    seen, acted, following = some(SEEN), np.tanh(some(ACTED)), some(SEEN)
    return Batches(seen, acted, following, some(), ends, ends + np.float32(0.99), some(ACTED), some(ACTED))


def products_of(batch: int, pi: tuple[int, ...], qf: tuple[int, ...]) -> tuple[Callable[[int], None], float]:
    """Our matrix products of an update alone, and how many million operations they are without padding."""
    from numba import njit

    from frasa_rl.crossq_net import aligned
    from frasa_rl.crossq_tiles import product, product_of_rows

    shapes = []  # kind, rows, depth in panels, results in panels, times an update
    operations = 0.0
    pair = list(zip((SEEN + ACTED, *qf[:-1]), qf, strict=True))
    policy = list(zip((SEEN, *pi), (*pi, 2 * ACTED), strict=True))
    for nets, layers, rows, forwards, backwards, slopes in (
        (2, pair, 2 * batch, 1.0, 1.0, 1.0),
        (2, pair, batch, 1 / DELAY, 1 / DELAY, 0.0),
        (1, policy, batch, 1.0 + 1 / DELAY, 1 / DELAY, 1 / DELAY),
    ):
        for i, (inputs, outputs) in enumerate(layers):
            a, b = -(-inputs // 32), -(-outputs // 32)
            to_input = i > 0 or (nets == 2 and not slopes)
            kinds = ((0, a, b, forwards), (0, b, a, backwards * to_input), (1, b, a, slopes))
            shapes += [(kind, rows, deep, wide, nets * times) for kind, deep, wide, times in kinds if times]
            operations += 2e-6 * rows * inputs * outputs * nets * sum(times for *_, times in kinds)
    most = max(rows for _, rows, *_ in shapes) * 32 * max(max(one[2:4]) for one in shapes)
    memory = [aligned((max(most, 32 * 32 * 16 * 16),), np.float32) for _ in range(3)]

    @njit(nogil=True)
    def run(kind, rows, deep, wide, times, c, a, b):
        for _ in range(times):
            for panel in range(wide):
                if kind == 0:
                    product(c, panel * rows * 32, a, 0, rows, b, panel * deep * 1024, deep)
                else:
                    product_of_rows(c, a, deep, b[panel * rows * 32 :], rows)

    def call(updates: int) -> None:
        for kind, rows, deep, wide, times in shapes:
            run(kind, rows, deep, wide, round(updates * times), *memory)

    call(6)
    return call, operations


def measure(sizes: tuple, rounds: int, others: dict[str, Sbx]) -> tuple[dict[str, np.ndarray], float]:
    """Seconds an update of all contenders, and the millions of operations of one."""
    import torch
    from sb3_contrib import CrossQ

    from frasa_rl.crossq import FastCrossQ

    batch, pi, qf = sizes
    ours, theirs = (model_of(kind, pi, qf, {"betas": (0.5, 0.999), "fused": True}) for kind in (FastCrossQ, CrossQ))
    updates = 96 if batch == 128 else 48
    batches, (products, operations) = batches_of(updates, batch), products_of(batch, pi, qf)

    def contrib(threads: int) -> list[float]:
        torch.set_num_threads(threads)
        return seconds(lambda count: theirs.train(count, batch), updates // 2)

    runs: dict[str, Callable[[], list[float]]] = {
        "sb3-contrib train, 1 thread": lambda: contrib(1),
        "sb3-contrib train, 2 threads": lambda: contrib(2),
        **{name: lambda other=other: other(batch, pi, qf, updates) for name, other in others.items()},
        "ours train, 1 thread": lambda: seconds(lambda count: ours.train(count, batch), updates),
        "ours update, 1 thread": lambda: seconds(lambda _: ours.update(batches), updates),
        "products alone, 1 thread": lambda: seconds(products, updates),
    }
    for run in runs.values():
        run()  # compiled, and its memory touched
    return _rounds(runs, rounds), operations


def _rounds(runs: dict[str, Callable[[], list[float]]], rounds: int) -> dict[str, np.ndarray]:
    """Seconds on the wall and of the processor, shape (2, rounds)."""
    times: dict[str, list[list[float]]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            times[name].append(run())
    return {name: np.array(found).T for name, found in times.items()}


def table(sizes: tuple, rounds: int, others: dict[str, Sbx]) -> None:
    """Measure all contenders at one size, and print it."""
    times, operations = measure(sizes, rounds, others)
    batch, pi, qf = sizes
    print(f"\nbatch {batch}, policy {pi}, critics {qf}: {operations:.0f} million operations an update")
    print(f"{'':30} best/s  median/s   best us   CPU us   x sb3-contrib: best, median, CPU")
    reference, floor = times["sb3-contrib train, 1 thread"], times["products alone, 1 thread"].min(axis=1)
    for name, found in times.items():
        (best, busy), middle = found.min(axis=1), float(np.median(found[0]))
        ratios = [reference[0].min() / best, np.median(reference[0] / found[0]), reference[1].min() / busy]
        print(f"{name:30}{1 / best:7.0f} {1 / middle:9.0f} {best * 1e6:9.0f} {busy * 1e6:8.0f}", end="   ")
        print("".join(f"{ratio:9.2f}" for ratio in ratios))
    shares = floor / times["ours update, 1 thread"].min(axis=1)
    print(f"products alone: {operations / floor[1] / 1e3:.0f} GFLOP/s of CPU time, {shares[1]:.0%} of our update's")


def sbx_of(python: str | None) -> dict[str, Sbx]:
    """SBX on one core and on two, where there is a Python for it."""
    if python is None:
        print("SBX is left out: no --sbx-python was given")
        return {}
    return {f"SBX train, {n} thread{'s' * (n > 1)}": Sbx(python, n) for n in (1, 2)}


def main() -> None:
    """Print a table for each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sbx-python", help="a Python that has sbx-rl")
    parser.add_argument("--serve-sbx", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    if given.serve_sbx:
        serve_sbx()
        return
    others = sbx_of(given.sbx_python)
    model = next((line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")), "")
    print(
        f"{model.partition(': ')[2] or platform.processor()}, {os.cpu_count()} cores, {given.rounds} rounds;", end=" "
    )
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} (1 is one core busy with other work)")
    for sizes in SIZES:
        table(sizes, given.rounds, others)


if __name__ == "__main__":
    main()

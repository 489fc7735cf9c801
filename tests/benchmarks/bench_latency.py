"""Time of one decision: the plain policy, the robot's runtime, onnxruntime, OpenVINO, all in one run on one core.

    python tests/benchmarks/bench_latency.py

The paper says 40 us on its robot's computer (OpenVINO on an i5-7260U). Runtimes take turns in short rounds, so that
other work on the machine falls on all; p50 and p99 are over all decisions, best is the median of the quietest round.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platform
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

from frasa_rl.config import Task
from frasa_rl.deployment import deployment
from frasa_rl.export import publish
from frasa_rl.policy import Policy
from frasa_rl.runtime import Runtime

PAPER_US = 40.0
SIZES = ((384, 256), (128, 128))
ROUNDS, DECISIONS = 60, 300
MODEL = Path("robot_model/nominal.xml")
Act = Callable[[np.ndarray], object]


def made_policy(hidden: tuple[int, ...]) -> Policy:
    """Of random weights: their values take no time."""
    rng = np.random.default_rng(0)
    return Policy(
        tuple(
            ((rng.normal(size=(to, of)) / np.sqrt(of)).astype(np.float32), rng.normal(size=to).astype(np.float32))
            for of, to in pairwise((22, *hidden, 5))
        )
    )


def onnx_act(path: Path) -> Act:
    """One thread, and no waiting for work in a loop."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return lambda seen: session.run(None, {"obs": seen[None]})[0][0]


def openvino_act(path: Path) -> Act:
    """One thread, 32-bit: where the processor can, OpenVINO takes bfloat16 by itself, and is off by 1e-2."""
    import openvino

    core = openvino.Core()
    model = core.read_model(path)
    model.reshape([1, 22])
    hints = {"INFERENCE_PRECISION_HINT": "f32", "PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": 1}
    request = core.compile_model(model, "CPU", hints).create_infer_request()
    tensor = openvino.Tensor(np.zeros((1, 22), dtype=np.float32))
    request.set_input_tensor(tensor)

    def act(seen: np.ndarray) -> object:
        tensor.data[0] = seen
        request.infer()
        return request.get_output_tensor().data[0]

    return act


def ways(hidden: tuple[int, ...], folder: Path) -> tuple[Policy, dict[str, Act]]:
    """All that are installed."""
    policy = made_policy(hidden)
    publish(policy, deployment({}, Task(), MODEL), folder)
    found: dict[str, Act] = {"numpy Policy.act": policy.act, "Runtime.act": Runtime.load(folder).act}
    if find_spec("onnxruntime"):
        found["onnxruntime"] = onnx_act(folder / "policy.onnx")
    if find_spec("openvino"):
        found["OpenVINO"] = openvino_act(folder / "policy.onnx")
    for rate in (20, 100):
        runtime = Runtime.load(folder, rate)
        runtime.start(np.zeros((5, 2)))
        found[f"Runtime.step at {rate} Hz"] = stepping(runtime)
    return policy, found


def stepping(runtime: Runtime) -> Act:
    """The whole decision, from readings of both sides to commands for both."""
    angles = np.random.default_rng(0).normal(size=(5, 2))
    return lambda _: runtime.step(angles, angles, 0.1, 0.2)


def timed(act: Act, observations: np.ndarray) -> np.ndarray:
    """Microseconds of each decision, less those of the clock."""
    clock, spent = time.perf_counter_ns, np.zeros(len(observations))
    for index, seen in enumerate(observations):
        began = clock()
        act(seen)
        spent[index] = clock() - began
    empty = np.median([-(clock() - clock()) for _ in range(100)])
    return (spent - empty) / 1e3


def main() -> None:
    """Print the tables."""
    installed = [name for name in ("onnxruntime", "openvino") if find_spec(name)]
    versions = {name: __import__(name).__version__.partition("-")[0] for name in installed}
    print(f"Python {platform.python_version()}, numpy {np.__version__}, {versions}; {ROUNDS} x {DECISIONS} decisions")
    rng = np.random.default_rng(1)
    for hidden in SIZES:
        with tempfile.TemporaryDirectory() as folder:
            policy, found = ways(hidden, Path(folder))
            observations = rng.uniform(-2.0, 2.0, (DECISIONS, 22)).astype(np.float32)
            expected = policy.act(observations)
            spent: dict[str, list[np.ndarray]] = {name: [] for name in found}
            for _ in range(ROUNDS):
                for name, act in found.items():
                    spent[name].append(timed(act, observations))
            print(f"\n22-{hidden[0]}-{hidden[1]}-5 {'[us]':13} best    p50    p99   paper / p50   off by")
            for name, rounds in spent.items():
                best = min(float(np.median(one)) for one in rounds)
                p50, p99 = np.percentile(np.concatenate(rounds), [50, 99])
                off = ""
                if "step" not in name:
                    acted = np.stack([np.array(found[name](seen)) for seen in observations])
                    off = f"{np.abs(acted - expected).max():.0e}"
                print(f"{name:26} {best:6.1f} {p50:6.1f} {p99:6.1f} {PAPER_US / p50:12.1f}   {off:>8}")
    sys.stdout.flush()


if __name__ == "__main__":
    main()

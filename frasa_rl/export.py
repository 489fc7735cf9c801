"""A policy as others take it: weights, ONNX, what it was trained on, and what a robot must know; then tried out."""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl import __version__
from frasa_rl.deployment import metadata
from frasa_rl.onnx_file import INPUT, onnx_bytes
from frasa_rl.policy import ONNX_FILE, Policy
from frasa_rl.runtime import DEPLOY_FILE, WEIGHTS_FILE, Network, read_weights
from frasa_sysid.calibration import QualityError, sha256_of, write_together

AGREEMENT = 1e-5
_TRIED = 1000


def publish(policy: Policy, deploy: dict[str, Any], folder: Path) -> list[Path]:
    """Write all files of a policy together; each has the hash of the weights it tells of.

    Without the package `onnx`, policy.onnx is left out.

    Args:
        policy: with its run.
        deploy: from `deployment`.
        folder: is made when missing.
    """
    deploy = {**deploy, "frasa_version": __version__}
    files = policy.files({"frasa_deploy": json.dumps(deploy, allow_nan=False)})
    digest = sha256_of(files[WEIGHTS_FILE])
    deploy = {**deploy, "weights_sha256": digest}
    if find_spec("onnx"):
        files[ONNX_FILE] = onnx_bytes(policy.layers, {**metadata(deploy), "weights_sha256": digest})
    else:
        (folder / ONNX_FILE).unlink(missing_ok=True)  # of other weights
    files[DEPLOY_FILE] = (json.dumps(deploy, indent=2, allow_nan=False) + "\n").encode()
    write_together({folder / name: content for name, content in files.items()})
    return sorted(one for one in folder.iterdir() if one.is_file() and not one.name.startswith("."))


def check_published(policy: Policy, deploy: dict[str, Any], folder: Path) -> dict[str, float]:
    """Largest difference of a published policy's runtimes from the policy, over random observations.

    onnxruntime is tried where it is installed. All are asked one observation at a time, as a robot does: products of
    many at once round in another order.

    Raises:
        QualityError: one differs by more than `AGREEMENT`.
    """
    fastest = deploy["action"]["rate_limit_rad_s"]  # rounding grows with what is seen; few joints turn faster
    bound = np.concatenate([np.full(one["size"], min(one["bound"], fastest)) for one in deploy["observation"]])
    seen = np.random.default_rng(0).uniform(-bound, bound, (_TRIED, bound.size)).astype(np.float32)
    expected = np.stack([policy.act(one) for one in seen])
    network = Network(read_weights(folder / WEIGHTS_FILE)[0])
    found = {"runtime": np.stack([network.act(one).copy() for one in seen])}
    if (folder / ONNX_FILE).is_file() and find_spec("onnxruntime"):
        import onnxruntime

        session = onnxruntime.InferenceSession(folder / ONNX_FILE, providers=["CPUExecutionProvider"])
        found["onnxruntime"] = np.concatenate([session.run(None, {INPUT: one[None]})[0] for one in seen])
    differences = {name: float(np.abs(one - expected).max()) for name, one in found.items()}
    for name, one in differences.items():
        if not one <= AGREEMENT:
            raise QualityError(f"{folder}: {name} differs by {one:.1e} from the policy, more than {AGREEMENT:g}")
    return differences

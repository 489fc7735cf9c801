"""A trained policy as plain numbers: a folder that loads without executing code, and runs with numpy alone.

policy/weights.safetensors   layer0.weight (out, in), layer0.bias (out,), layer1.weight, ...
policy/run.yaml              what it was trained on: task, model, calibration id, seed, versions

A published one has two files more, written by `frasa_rl.export`:

policy/policy.onnx           the same network, with all that a robot needs to know in its metadata
policy/deploy.json           the same as plain data, for `frasa_rl.runtime`
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from frasa_rl.runtime import DEPLOY_FILE, WEIGHTS_FILE, DeployError, check_layers, read_weights
from frasa_sysid.calibration import InputError, plain, read_yaml, sha256_of, write_together

Array = npt.NDArray[np.float32]
RUN_FILE = "run.yaml"
ONNX_FILE = "policy.onnx"
FOLDER = "policy"
_HASH = "weights_sha256"  # in run.yaml, older ones have none


class PolicyError(InputError):
    """A policy folder is missing, broken, or made for another task."""


@dataclass(frozen=True)
class Policy:
    """A chain of linear layers with rectifiers between and a hyperbolic tangent at the end.

    Normalisation is folded into the layers, so observations go in as they are.

    Attributes:
        layers: weights (out, in) and biases (out,).
        run: the content of run.yaml.
    """

    layers: tuple[tuple[Array, Array], ...]
    run: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            check_layers(self.layers)
        except DeployError as error:
            raise PolicyError(str(error)) from None

    def act(self, observation: npt.ArrayLike) -> Array:
        """Actions in [-1, 1] for one observation (22,) or many (k, 22): shape (5,) or (k, 5)."""
        values = np.asarray(observation, dtype=np.float32)
        for weight, bias in self.layers[:-1]:
            values = np.maximum(values @ weight.T + bias, 0.0)
        weight, bias = self.layers[-1]
        action: Array = np.tanh(values @ weight.T + bias)
        return action

    def save(self, folder: Path, metadata: Mapping[str, str] | None = None) -> None:
        """Write weights and run.yaml; each file is complete or as it was before.

        Whatever was published of other weights there is removed.

        Args:
            folder: of the policy.
            metadata: notes to carry along with the weights.
        """
        for name in (ONNX_FILE, DEPLOY_FILE):
            (folder / name).unlink(missing_ok=True)
        write_together({folder / name: content for name, content in self.files(metadata).items()})

    def files(self, metadata: Mapping[str, str] | None = None) -> dict[str, bytes]:
        """The content of weights and run.yaml, by name; run.yaml has the hash of the weights it speaks of."""
        from safetensors.numpy import save

        tensors = {}
        for index, (weight, bias) in enumerate(self.layers):
            tensors[f"layer{index}.weight"] = np.ascontiguousarray(weight)
            tensors[f"layer{index}.bias"] = np.ascontiguousarray(bias)
        weights: bytes = save(tensors, dict(metadata) if metadata else None)
        said = {**plain(self.run), _HASH: sha256_of(weights)}
        return {WEIGHTS_FILE: weights, RUN_FILE: yaml.safe_dump(said, sort_keys=False).encode()}

    @staticmethod
    def load(folder: Path | str) -> "Policy":
        """Read a policy folder, or the policy of a run folder.

        Raises:
            PolicyError: no policy there, or a broken one.
        """
        path = weights_file(Path(folder)).parent
        try:
            layers, digest = read_weights(path / WEIGHTS_FILE)
        except DeployError as error:
            raise PolicyError(str(error)) from None
        run = read_run(path / RUN_FILE)
        if run.pop(_HASH, digest) != digest:
            raise PolicyError(
                f"{path}: {WEIGHTS_FILE} and {RUN_FILE} are of different policies, as after a kill between them: "
                "go on with the run (--resume), or export the policy again"
            )
        return Policy(layers, run)


def weights_file(folder: Path) -> Path:
    """Where the weights of a policy folder are, or of the policy of a run folder."""
    inner = folder / FOLDER / WEIGHTS_FILE
    return inner if inner.is_file() else folder / WEIGHTS_FILE


def read_run(path: Path) -> dict[str, Any]:
    """The content of a run.yaml.

    Raises:
        PolicyError: missing, or not a mapping in YAML.
    """
    try:
        run = read_yaml(path, PolicyError)
    except FileNotFoundError:
        raise PolicyError(f"no {path}: expected the folder of a run or of a policy") from None
    if not isinstance(run, dict):
        raise PolicyError(f"{path}: expected a mapping")
    return run

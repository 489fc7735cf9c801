"""A trained policy as plain numbers: a folder that loads without executing code, and runs with numpy alone.

policy/weights.safetensors   layer0.weight (out, in), layer0.bias (out,), layer1.weight, ...
policy/run.yaml              what it was trained on: task, model, calibration id, seed, versions
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from frasa_sysid.calibration import InputError, plain, write_atomic

Array = npt.NDArray[np.float32]
WEIGHTS_FILE = "weights.safetensors"
RUN_FILE = "run.yaml"
FOLDER = "policy"


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
        if not self.layers:
            raise PolicyError("a policy needs at least one layer")
        for index, (weight, bias) in enumerate(self.layers):
            wanted = self.layers[index - 1][0].shape[0] if index else weight.shape[-1]
            if weight.ndim != 2 or weight.shape[1] != wanted or bias.shape != weight.shape[:1]:
                raise PolicyError(f"layer {index} has shapes {weight.shape} and {bias.shape} after {wanted} numbers")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise PolicyError(f"layer {index} holds numbers that are not finite")

    def act(self, observation: npt.ArrayLike) -> Array:
        """Actions in [-1, 1] for one observation (22,) or many (k, 22): shape (5,) or (k, 5)."""
        values = np.asarray(observation, dtype=np.float32)
        for weight, bias in self.layers[:-1]:
            values = np.maximum(values @ weight.T + bias, 0.0)
        weight, bias = self.layers[-1]
        action: Array = np.tanh(values @ weight.T + bias)
        return action

    def save(self, folder: Path) -> None:
        """Write the folder; each file is complete or as it was before."""
        from safetensors.numpy import save

        tensors = {}
        for index, (weight, bias) in enumerate(self.layers):
            tensors[f"layer{index}.weight"] = np.ascontiguousarray(weight)
            tensors[f"layer{index}.bias"] = np.ascontiguousarray(bias)
        write_atomic(folder / WEIGHTS_FILE, save(tensors))
        write_atomic(folder / RUN_FILE, yaml.safe_dump(plain(self.run), sort_keys=False))

    @staticmethod
    def load(folder: Path | str) -> "Policy":
        """Read a policy folder, or the policy of a run folder.

        Raises:
            PolicyError: no policy there, or a broken one.
        """
        path = Path(folder)
        inner = path / FOLDER
        path = inner if (inner / WEIGHTS_FILE).is_file() else path
        return Policy(tuple(_read_layers(path / WEIGHTS_FILE)), read_run(path / RUN_FILE))


def read_run(path: Path) -> dict[str, Any]:
    """The content of a run.yaml.

    Raises:
        PolicyError: missing, or not a mapping in YAML.
    """
    try:
        run = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PolicyError(f"no {path}: expected the folder of a run or of a policy") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise PolicyError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(run, dict):
        raise PolicyError(f"{path}: expected a mapping")
    return run


def _read_layers(path: Path) -> Sequence[tuple[Array, Array]]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        tensors = load(path.read_bytes())
    except FileNotFoundError:
        raise PolicyError(f"no policy at {path.parent}: expected {WEIGHTS_FILE}") from None
    except (SafetensorError, ValueError) as error:
        raise PolicyError(f"{path} is not a safetensors file: {error}") from error
    count = len(tensors) // 2
    names = {f"layer{i}.{part}" for i in range(count) for part in ("weight", "bias")}
    if set(tensors) != names:
        raise PolicyError(f"{path} holds {', '.join(sorted(tensors))}; expected layer0.weight, layer0.bias, ...")
    return [
        (tensors[f"layer{i}.weight"].astype(np.float32), tensors[f"layer{i}.bias"].astype(np.float32))
        for i in range(count)
    ]

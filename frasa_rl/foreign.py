"""Policies from SB3's zip files (CrossQ and SAC), turned into plain ones without unpickling anything.

Such a file holds `data`, JSON with pickled Python in it, and `policy.pth`, tensors. SB3's own `load` executes the
pickles. Here only the plain part of `data` is read, and tensors through `torch.load(weights_only=True)`. It asks for
`--trust` all the same: that reader has had holes, and the file does not say which robot its numbers will move.
"""

import io
import json
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from frasa_rl.config import Task
from frasa_rl.policy import Array, Policy, PolicyError
from frasa_rl.task_text import task_data
from frasa_sysid.calibration import UsageError, calibration_id, load_model, sha256_of_file
from frasa_sysid.calibration.plain_arrays import check_packing

Tensors = Mapping[str, npt.NDArray[np.float64]]
_LARGEST = 1 << 28
# What zipfile raises of a damaged file; some of it is not of its own kind.
_BROKEN = (
    zipfile.BadZipFile, zlib.error, KeyError, ValueError, NotImplementedError, RuntimeError, OSError, EOFError,
)  # fmt: skip
_RELU = "<class 'torch.nn.modules.activation.ReLU'>"
_RENORM_EPS, _CLIP_MEAN = 1e-3, 2.0  # defaults of sb3-contrib and SB3


def is_foreign(word: str) -> bool:
    """Whether a word for a policy names an SB3 file."""
    return word.endswith(".zip")


def foreign_policy(path: Path, task: Task, model: Path, *, trust: bool) -> Policy:
    """The policy of an SB3 file, which does not say what it was trained on: whoever trusts it says so.

    Args:
        path: a zip file as SB3 saves it.
        task: what it is taken to be trained for.
        model: the model it is taken to be trained on.
        trust: whether the user trusts where it is from.

    Raises:
        PolicyError: no trust, no such file, or not an actor that can be said in plain layers.
        ModelError: the model is missing or broken.
    """
    layers = read_sb3(path, trust=trust)
    return Policy(
        layers,
        {
            "origin": f"SB3 file {path.name}",
            "origin_sha256": sha256_of_file(path),
            "stated": "model, calibration_id and task are as said by who converted it; the file does not say them",
            "model": str(model),
            "calibration_id": calibration_id(load_model(model)),
            "task": task_data(task),
        },
    )


def read_sb3(path: Path, *, trust: bool) -> tuple[tuple[Array, Array], ...]:
    """The layers of the mean action of a CrossQ or SAC actor, normalisation folded in.

    Args:
        path: a zip file as SB3 saves it.
        trust: whether the user trusts where it is from.

    Raises:
        PolicyError: no trust, no such file, or not an actor that can be said in plain layers.
        UsageError: torch, which wrote the tensors, is not installed.
    """
    if not path.is_file():
        raise PolicyError(f"no policy at {path}")
    if not trust:
        raise PolicyError(
            f"{path} is an SB3 file, which holds pickled Python: --trust if you know where it is from "
            "(a policy folder of frasa's needs no trust)"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            said = _settings(archive)
            tensors = _tensors(_member(archive, "policy.pth"))
    except _BROKEN as error:
        raise PolicyError(f"{path} is not an SB3 file: {' '.join(str(error).split())[:200]}") from None
    try:
        return fold(tensors, said)
    except (KeyError, ValueError) as error:
        raise PolicyError(f"{path} holds no CrossQ or SAC actor that is understood: {error}") from None


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    check_packing(archive, name)
    if archive.getinfo(name).file_size > _LARGEST:
        raise KeyError(f"{name} is larger than {_LARGEST >> 20} MiB")
    with archive.open(name) as file:
        content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:  # whatever its header says
        raise KeyError(f"{name} is larger than {_LARGEST >> 20} MiB")
    return content


def _settings(archive: zipfile.ZipFile) -> dict[str, Any]:
    """What `data` says in plain JSON; texts under `:serialized:` are pickles and stay texts."""
    content = _member(archive, "data")
    try:
        said = json.loads(content)
    except (ValueError, RecursionError):
        raise KeyError("'data' is not JSON") from None
    if not isinstance(said, dict):
        raise KeyError("'data' is not a mapping")
    return said


def _tensors(content: bytes) -> Tensors:
    try:
        import torch
    except ModuleNotFoundError:
        raise UsageError("reading an SB3 file needs torch: pip install 'frasa[train]'") from None
    from pickle import UnpicklingError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is then refused, or does not matter
            state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if not isinstance(state, Mapping):
            raise KeyError("policy.pth is not a mapping")
        return {
            str(name).removeprefix("actor."): tensor.detach().to(torch.float64).numpy()
            for name, tensor in state.items()
            if str(name).startswith("actor.") and isinstance(tensor, torch.Tensor)
        }
    except (UnpicklingError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise KeyError(f"policy.pth: {str(error).splitlines()[0][:120] if str(error) else error!r}") from None


def fold(tensors: Tensors, said: Mapping[str, Any]) -> tuple[tuple[Array, Array], ...]:
    """Layers of a state dict, named from the actor on.

    Batch renormalisation at inference is a x + c with a = scale / sqrt(var + eps) and c = bias - a mean, so
    W (a x + c) + b = (W a) x + (W c + b). With gSDE SB3 clips the mean before the hyperbolic tangent;
    clip(x, -m, m) = relu(x + m) - relu(x - m) - m says that in two plain layers.

    Args:
        tensors: `latent_pi.<i>.*` and `mu.*`, with renormalisation or without.
        said: plain settings of the file.

    Raises:
        ValueError: something in it that plain layers cannot do.
        KeyError: a tensor is missing.
    """
    options = _options(said)
    clipped = "mu.0.weight" in tensors
    mu = "mu.0" if clipped else "mu"
    places = sorted({int(name.split(".")[1]) for name in tensors if name.startswith("latent_pi.")})
    known = {name for name in tensors if name.startswith(("latent_pi.", f"{mu}.", "log_std"))}
    if set(tensors) - known or not tensors:
        raise ValueError(f"found {', '.join(sorted(set(tensors) - known))[:120] or 'no actor'}")
    layers: list[tuple[Array, Array]] = []
    gain, offset = np.ones(1), np.zeros(1)
    for place in (*(f"latent_pi.{index}" for index in places), mu):
        if f"{place}.ra_var" in tensors:
            if (tensors[f"{place}.ra_var"] < 0.0).any():
                raise ValueError(f"{place}.ra_var is negative")
            gain = tensors[f"{place}.scale"] / np.sqrt(tensors[f"{place}.ra_var"] + options["batch_norm_eps"])
            offset = tensors[f"{place}.bias"] - gain * tensors[f"{place}.ra_mean"]
            continue
        weight, bias = tensors[f"{place}.weight"], tensors[f"{place}.bias"]
        folded = weight * gain, bias + (weight * offset).sum(axis=1)
        layers.append((folded[0].astype(np.float32), folded[1].astype(np.float32)))
        gain, offset = np.ones(1), np.zeros(1)
    most = options["clip_mean"]
    return _clip(layers, most) if clipped and most > 0.0 else tuple(layers)


def _clip(layers: list[tuple[Array, Array]], most: float) -> tuple[tuple[Array, Array], ...]:
    """The same layers, whose last numbers are clipped to [-most, most]."""
    weight, bias = layers[-1]
    one, limit = np.eye(bias.size, dtype=np.float32), np.float32(most)
    both = np.concatenate([weight, weight]), np.concatenate([bias + limit, bias - limit])
    return *layers[:-1], both, (np.hstack([one, -one]), np.full(bias.size, -limit, dtype=np.float32))


def _options(said: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of the actor that are not in its tensors."""
    given = said.get("policy_kwargs")
    given = given if isinstance(given, dict) else {}
    kind = str(given.get("activation_fn", _RELU))
    if kind != _RELU:
        raise ValueError(f"its activation is {kind[:60]}, expected ReLU")
    space = said.get("action_space")
    space = space if isinstance(space, dict) else {}
    for name, limit in (("low", -1.0), ("high", 1.0)):
        numbers = str(space.get(name, limit)).strip("[]").split()
        if any(float(one) != limit for one in numbers):
            raise ValueError(f"its actions reach {' '.join(numbers)[:40]}, expected -1 to 1")
    options = {"batch_norm_eps": _RENORM_EPS, "clip_mean": _CLIP_MEAN}
    for name in options:
        value = given.get(name, options[name])
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1e6:
            raise ValueError(f"its {name} is {str(value)[:40]}")
        options[name] = float(value)
    return options

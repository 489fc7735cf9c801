"""What an output depends on: hashes of its inputs, and the versions of all that computed it."""

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import mujoco
import numpy as np

from frasa_sysid.calibration.files import sha256_of, sha256_of_file
from frasa_sysid.calibration.load import load_spec

_ALWAYS = ("frasa", "mujoco", "numpy")


def versions(*more: str) -> dict[str, str]:
    """Versions of frasa, Python, MuJoCo, numpy and further packages, where they are installed.

    Args:
        more: names as pip knows them.
    """
    found = {}
    for name in dict.fromkeys((*_ALWAYS, *more)):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {**found, "python": platform.python_version()}


def model_sha256(model: mujoco.MjModel) -> str:
    """SHA-256 of a compiled model, so that every included file counts; another MuJoCo gives another."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return sha256_of(content.tobytes())


def input_hashes(paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of files as they were given, of absolute paths by name; of a model as MuJoCo compiles it.

    Args:
        paths: files that are there; models end in .xml and have been loaded before.
    """
    found = {}
    for path in dict.fromkeys(paths):
        digest = model_sha256(load_spec(path).compile()) if path.suffix == ".xml" else sha256_of_file(path)
        found[path.name if path.is_absolute() else str(path)] = digest
    return found

"""A pool of settled starts, made once from a seed and kept on disk under the hash of all it depends on."""

import io
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np
import yaml

from frasa_rl.config import Task
from frasa_rl.falls import Kind
from frasa_rl.simulation import FULL, Start, fresh
from frasa_rl.starts import StartMaker, compat_starts
from frasa_sysid.calibration import Calibration, UsageError, plain, sha256_of, write_atomic

VERSION = 1  # of what a pool holds; another one is made anew


def pool_key(model: mujoco.MjModel, task: Task, calibration: Calibration | None, count: int, seed: int) -> str:
    """Hash of all that a pool depends on: model, task, ranges, its size and seed, and MuJoCo."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    ranges = calibration.to_dict() if calibration else None
    said = yaml.safe_dump([plain(asdict(task)), plain(ranges), count, seed, VERSION, mujoco.__version__])
    return sha256_of(content.tobytes() + said.encode())[:32]


def cache_folder() -> Path:
    """Where pools are kept: `$FRASA_CACHE`, else the user's cache folder."""
    users = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return Path(os.environ.get("FRASA_CACHE") or users / "frasa")


class Pool:
    """Settled starts to choose from; each has a robot of its own.

    Args:
        maker: makes them.
        calibration: the ranges the maker draws from.
        count: of starts.
        seed: of all of them.
        folder: where to keep it, if it can be written; None keeps nothing.
        tell: called with the share done while it is made.

    Raises:
        UsageError: no start is asked for.
        ModelError: no release came to rest as asked.
    """

    def __init__(
        self,
        maker: StartMaker,
        calibration: Calibration | None,
        count: int,
        seed: int,
        folder: Path | None = None,
        tell: Callable[[float], None] = lambda _: None,
    ) -> None:
        if count < 1:
            raise UsageError(f"a pool of {count} starts: expected at least 1")
        self._maker, self._seed = maker, seed
        if maker.task.compat:
            self.starts = compat_starts(maker).make([self._rng(i) for i in range(count)])
            return
        if folder is None:
            self.starts = self._make(count, tell)
            return
        key = pool_key(maker.original, maker.task, calibration, count, seed)
        path = folder / f"starts-{key}.npz"
        kept = _load(path) if path.is_file() else None
        if kept is not None and self._fits(kept, count, key):
            self.starts = [self._restore(i, kept) for i in range(count)]
            return
        self.starts = self._make(count, tell)
        with suppress(OSError):  # a cache that cannot be written is none: the pool is there all the same
            write_atomic(path, _packed(self.starts, key))

    def __len__(self) -> int:
        return len(self.starts)

    def _rng(self, index: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(index,)))

    def _make(self, count: int, tell: Callable[[float], None]) -> list[Start]:
        kinds: list[Kind] = ["any"] * count
        return self._maker.make([self._rng(i) for i in range(count)], kinds, tell)

    def _fits(self, kept: dict[str, np.ndarray], count: int, key: str) -> bool:
        """Whether a file holds what its name says: numbers of the right shapes, as they were written."""
        model = self._maker.model
        shapes = {"state": (count, mujoco.mj_stateSize(model, FULL)), "ctrl": (count, model.nu)}
        shapes["sensors"] = shapes["older"] = (count, model.nsensordata)
        if set(kept) != {*shapes, "mark"} or any(kept[name].dtype != np.float64 for name in shapes):
            return False
        right = all(kept[name].shape == shape for name, shape in shapes.items())
        return right and str(kept["mark"]) == _mark(kept, key)

    def _restore(self, index: int, kept: dict[str, np.ndarray]) -> Start:
        """The robot is drawn again from its seed, where it settled is read."""
        model, drawn = self._maker.draw_robot(self._rng(index))
        ages = fresh(model)
        state, ctrl, sensors, older = (kept[name][index] for name in _KEPT)
        return Start(model, state, ctrl, sensors, ages, drawn, older)


_KEPT = ("state", "ctrl", "sensors", "older")


def _packed(starts: list[Start], key: str) -> bytes:
    file = io.BytesIO()
    kept = {name: np.stack([getattr(one, name) for one in starts]) for name in _KEPT}
    state, ctrl, sensors, older = (kept[name] for name in _KEPT)
    np.savez(file, state=state, ctrl=ctrl, sensors=sensors, older=older, mark=np.array(_mark(kept, key)))
    return file.getvalue()


def _mark(kept: dict[str, np.ndarray], key: str) -> str:
    """Hash of the numbers and of what they were made from."""
    return sha256_of(b"".join(kept[name].tobytes() for name in _KEPT) + key.encode())


def _load(path: Path) -> dict[str, np.ndarray] | None:
    """What a file holds; None when it is damaged."""
    try:
        file = np.load(path, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            return None
        with file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile):
        return None

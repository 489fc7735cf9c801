"""A pool of settled starts, made once from a seed and kept on disk under the hash of all it depends on."""

import io
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import yaml

from frasa_rl.config import Task
from frasa_rl.falls import Kind
from frasa_rl.simulation import FULL, Start, fresh
from frasa_rl.starts import StartMaker, compat_starts
from frasa_sysid.calibration import BusyError, Calibration, UsageError, alone, plain, sha256_of, write_atomic
from frasa_sysid.calibration.plain_arrays import read_arrays

_PATIENCE_S = 600.0  # for another process that makes the same pool
VERSION = 2  # of what a pool holds; another one is made anew


def pool_key(
    model: mujoco.MjModel,
    task: Task,
    calibration: Calibration | None,
    kinds: Sequence[Kind],
    seed: int,
    branch: tuple[int, ...] = (),
) -> str:
    """Hash of all that a pool depends on: model, task, ranges, what it holds, its seed, and MuJoCo."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    ranges = calibration.to_dict() if calibration else None
    of = [plain(asdict(task)), plain(ranges), list(kinds), seed, list(branch), VERSION, mujoco.__version__]
    said = yaml.safe_dump(of)
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
        kinds: of every start, where they are not what training uses.
        branch: numbers that set a pool's chance apart from that of others with the same seed.

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
        *,
        kinds: Sequence[Kind] | None = None,
        branch: tuple[int, ...] = (),
    ) -> None:
        if count < 1:
            raise UsageError(f"a pool of {count} starts: expected at least 1")
        self._maker, self._seed, self._branch = maker, seed, branch
        wanted: Sequence[Kind] = ["any"] * count if kinds is None else kinds
        if maker.task.compat and kinds is None:
            self.starts = compat_starts(maker).make([self._rng(i) for i in range(count)])
            return
        if folder is None:
            self.starts = self._make(wanted, tell)
            return
        key = pool_key(maker.original, maker.task, calibration, wanted, seed, branch)
        path = folder / f"starts-{key}.npz"
        if self._find(path, count, key):
            return
        with ExitStack() as stack:
            # Many agents begin together: one of them makes it, the others wait. Without a lock each makes its own.
            with suppress(OSError, BusyError):
                stack.enter_context(alone(path, patience_s=_PATIENCE_S))
            if self._find(path, count, key):
                return
            self.starts = self._make(wanted, tell)
            with suppress(OSError):  # a cache that cannot be written is none: the pool is there all the same
                write_atomic(path, _packed(self.starts, key))

    def __len__(self) -> int:
        return len(self.starts)

    def _find(self, path: Path, count: int, key: str) -> bool:
        """Take the starts from a file, if it holds them."""
        kept = _load(path) if path.is_file() else None
        if kept is None or not self._fits(kept, count, key):
            return False
        self.starts = [self._restore(i, kept) for i in range(count)]
        return True

    def _rng(self, index: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(*self._branch, index)))

    def of_kind(self, kind: str) -> npt.NDArray[np.intp]:
        """Which starts are of a kind."""
        return np.flatnonzero([one.kind == kind for one in self.starts])

    def _make(self, kinds: Sequence[Kind], tell: Callable[[float], None]) -> list[Start]:
        return self._maker.make([self._rng(i) for i in range(len(kinds))], kinds, tell)

    def _fits(self, kept: dict[str, np.ndarray], count: int, key: str) -> bool:
        """Whether a file holds what its name says: numbers of the right shapes, as they were written."""
        model = self._maker.model
        shapes = {"state": (count, mujoco.mj_stateSize(model, FULL)), "ctrl": (count, model.nu)}
        shapes["sensors"] = shapes["older"] = (count, model.nsensordata)
        if set(kept) != {*shapes, "kind", "mark"} or any(kept[name].dtype != np.float64 for name in shapes):
            return False
        if kept["kind"].shape != (count,) or kept["kind"].dtype.kind != "U":
            return False
        right = all(kept[name].shape == shape for name, shape in shapes.items())
        return right and str(kept["mark"]) == _mark(kept, key)

    def _restore(self, index: int, kept: dict[str, np.ndarray]) -> Start:
        """The robot is drawn again from its seed, where it settled is read."""
        model, drawn = self._maker.draw_robot(self._rng(index))
        ages = fresh(model)
        state, ctrl, sensors, older, kind = (kept[name][index] for name in _KEPT)
        return Start(model, state, ctrl, sensors, ages, drawn, older, str(kind))


_KEPT = ("state", "ctrl", "sensors", "older", "kind")


def _packed(starts: list[Start], key: str) -> bytes:
    file = io.BytesIO()
    kept = {name: np.stack([getattr(one, name) for one in starts]) for name in _KEPT}
    np.savez(file, allow_pickle=False, **kept, mark=np.array(_mark(kept, key)))
    return file.getvalue()


def _mark(kept: dict[str, np.ndarray], key: str) -> str:
    """Hash of the numbers and of what they were made from."""
    return sha256_of(b"".join(kept[name].tobytes() for name in _KEPT) + key.encode())


def _load(path: Path) -> dict[str, np.ndarray] | None:
    """What a file holds; None when it is damaged."""
    try:
        return read_arrays(path, 2 * path.stat().st_size)  # they are not packed
    except (OSError, ValueError):
        return None

"""Checkpoints of a run: complete or absent, and restored without unpickling anything.

checkpoints/000020000/model.zip   SB3's own file: weights and optimizer states
checkpoints/000020000/state.npz   everything else as plain arrays: robots, replay, random states, counts, tables

A checkpoint appears under its name by one rename, and the older one is removed after that: whenever a run is killed,
one of them is there. Nothing is compressed, so that 300,000 transitions take a fraction of a second.
"""

import os
import pickle
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from frasa_rl.snapshots import Arrays
from frasa_sysid.calibration import InputError, cannot_write
from frasa_sysid.calibration.plain_arrays import read_arrays

FOLDER = "checkpoints"
_MODEL, _STATE = "model.zip", "state.npz"
_BROKEN = (
    OSError, EOFError, ValueError, KeyError, IndexError, TypeError, RuntimeError, NotImplementedError, struct.error,
    pickle.UnpicklingError, zipfile.BadZipFile, zlib.error, AttributeError, OverflowError, AssertionError,
)  # fmt: skip


class CheckpointError(InputError):
    """A run has no checkpoint, or a broken one."""


def save_checkpoint(run: Path, steps: int, mark: str, model: bytes, state: Arrays) -> Path:
    """Write a checkpoint beside the older one, which is removed afterwards.

    Args:
        run: the run folder.
        steps: of the run so far.
        mark: of the run: what else has it can resume from this.
        model: SB3's file.
        state: all the rest.

    Raises:
        OutputError: it cannot be written; the older one is still there.
    """
    done = run / FOLDER / f"{steps:09d}"
    if done.exists():  # a run that was over went on to another end at the same steps
        done = done.with_name(f"{done.name}-again")
        shutil.rmtree(done, ignore_errors=True)
    partial = run / FOLDER / "partial"
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        with _durable(partial / _MODEL) as file:
            file.write(model)
        with _durable(partial / _STATE) as file:
            np.savez(file, allow_pickle=False, **state, mark=np.array(mark))
        partial.rename(done)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise cannot_write(done, error) from error
    for other in (run / FOLDER).iterdir():
        if other != done:
            shutil.rmtree(other)
    return done


@contextmanager
def _durable(path: Path) -> Iterator[IO[bytes]]:
    """A new file that is on the disk when this ends: the older checkpoint goes soon after, and so may the power."""
    with path.open("wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def load_checkpoint(
    run: Path, mark: str, load_model: Callable[[Path], None], restore: Callable[[Arrays], None]
) -> None:
    """Continue from the newest checkpoint of a run.

    Args:
        run: the run folder.
        mark: of the run.
        load_model: takes SB3's file.
        restore: takes all the rest.

    Raises:
        CheckpointError: there is none, it is broken, or it belongs to another run.
    """
    folders = sorted(one for one in (run / FOLDER).glob("*") if one.is_dir() and one.name[:1].isdigit())
    if not folders:
        raise CheckpointError(f"{run} has no checkpoint to resume from")
    newest = folders[-1]
    try:
        # Nothing is packed, so the arrays are as large as the file.
        state = read_arrays(newest / _STATE, (newest / _STATE).stat().st_size)
        if str(state.pop("mark")) != mark:
            raise ValueError("it belongs to a run with another model, task, or settings")
        _check_unpacked(newest / _MODEL)
        load_model(newest / _MODEL)
        restore(state)
    except _BROKEN as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise CheckpointError(f"cannot resume from {newest}: {said}") from error


def _check_unpacked(path: Path) -> None:
    """See that SB3's file holds its members as they are, as SB3 writes it: what is packed can be any size.

    Raises:
        ValueError: one is packed.
    """
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{path.name} holds {member.filename[:40]} packed, expected it as SB3 writes it")

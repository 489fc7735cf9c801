"""Checkpoints of a run: complete or absent, and restored without unpickling anything.

checkpoints/000020000/model.zip   SB3's own file: weights and optimizer states
checkpoints/000020000/state.npz   replay buffer, counters, random states
"""

import io
import shutil
import zipfile
from pathlib import Path

import numpy as np
from sb3_contrib import CrossQ

from frasa_rl.learner import restore, snapshot
from frasa_sysid.calibration import InputError

FOLDER = "checkpoints"


class CheckpointError(InputError):
    """A run has no checkpoint, or a broken one."""


def save_checkpoint(model: CrossQ, run: Path, elapsed_s: float) -> Path:
    """Write a checkpoint beside the older one, which is removed afterwards.

    The folder appears under its name by one rename, so a kill leaves the older one.
    """
    done = run / FOLDER / f"{model.num_timesteps:09d}"
    partial = done.with_suffix(".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    content = io.BytesIO()
    model.save(content)
    (partial / "model.zip").write_bytes(content.getvalue())
    kept = {**snapshot(model), "elapsed_s": np.array(elapsed_s)}
    np.savez(partial / "state.npz", allow_pickle=False, **kept)
    if done.exists():
        shutil.rmtree(done)
    partial.rename(done)
    for older in _folders(run):
        if older != done:
            shutil.rmtree(older)
    return done


def load_checkpoint(model: CrossQ, run: Path) -> float:
    """Continue a newly built learner from the newest checkpoint of a run.

    Only tensors and arrays are read; nothing is unpickled.

    Returns:
        Seconds the run has been training.

    Raises:
        CheckpointError: there is none, or it does not fit the run's settings.
    """
    folders = _folders(run)
    if not folders:
        raise CheckpointError(f"{run} has no checkpoint to resume from")
    newest = folders[-1]
    try:
        model.set_parameters(str(newest / "model.zip"), device=model.device)
        with np.load(newest / "state.npz", allow_pickle=False) as state:
            restore(model, state.__getitem__)
            return float(state["elapsed_s"])
    except (OSError, ValueError, KeyError, RuntimeError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"cannot resume from {newest}: {' '.join(str(error).split())}") from error


def _folders(run: Path) -> list[Path]:
    return sorted(one for one in (run / FOLDER).glob("*") if one.is_dir() and one.name.isdigit())

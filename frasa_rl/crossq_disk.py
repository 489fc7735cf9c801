"""CrossQ's compiled updates on disk: compiled by a child process, so that every process loads the same code.

Where they are compiled, inner functions are linked as compiled alone; where they are loaded, as the whole was
optimised. These round differently, and a resumed run must come to the numbers of an unbroken one. Numba itself looks at
the file of the outermost function only: a mark beside its files says what all of them were compiled from.
"""

import os
import subprocess
import sys
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite import binding

from frasa_sysid.calibration import BusyError, alone, write_atomic

_PATIENCE_S = 600.0  # for another process that compiles the same
_CHILD = "FRASA_COMPILES"  # set in the process that compiles for others
_PYTHON = f"py{sys.version_info[0]}{sys.version_info[1]}"  # as Numba names its files
_FILL = """
import gymnasium, numpy as np
from gymnasium import spaces
from frasa_rl.batches import Batches
from frasa_rl.crossq import FastCrossQ
class Env(gymnasium.Env):
    observation_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
policy = {"net_arch": [4], "optimizer_kwargs": {"betas": (0.5, 0.999)}}
model = FastCrossQ("MlpPolicy", Env(), policy_kwargs=policy, buffer_size=1, device="cpu", seed=0)
zeros = lambda *shape: np.zeros(shape, np.float32)
model.update(Batches(zeros(1, 4, 2), zeros(1, 4, 1), zeros(1, 4, 2), *(zeros(1, 4) for _ in range(3)),
                     zeros(1, 4, 1), zeros(1, 4, 1)))
"""


def fill(compiled: Any, script: str = _FILL) -> None:  # noqa: ANN401 - a function of Numba's
    """Have the updates compiled on disk, unless they are: once after an installation, on a machine.

    A child that fails changes nothing: then this process compiles for itself.

    Args:
        compiled: the updates, not called in this process so far (else nothing is done).
        script: what makes a process compile them.
    """
    if _CHILD in os.environ or compiled.signatures:
        return
    if compiled.stats.cache_path is None:
        return  # nothing can be kept, which was said
    folder = Path(compiled.stats.cache_path)
    file, wanted = folder / f"crossq.{_PYTHON}.mark", mark()
    with suppress(OSError, BusyError), alone(file, patience_s=_PATIENCE_S):  # agents of a sweep begin together
        if any(folder.glob(f"crossq_*.{_PYTHON}*.nbi")) and file.is_file() and file.read_text() == wanted:
            return
        file.unlink(missing_ok=True)
        for old in folder.glob(f"crossq_*.{_PYTHON}*.nb?"):
            old.unlink(missing_ok=True)
        path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        environment = {**os.environ, _CHILD: "1", "PYTHONPATH": path}
        done = subprocess.run([sys.executable, "-c", script], env=environment, check=False, capture_output=True)
        if done.returncode == 0:
            write_atomic(file, wanted)


def mark() -> str:
    """Hash of all that the compiled code depends on: our sources, the compiler, the processor."""
    sources = sorted(Path(__file__).parent.glob("crossq_*.py"))
    machine = [binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()]
    said = [numba.__version__, llvmlite.__version__, *machine, *(one.read_text(encoding="utf-8") for one in sources)]
    return sha256("\0".join(said).encode()).hexdigest()

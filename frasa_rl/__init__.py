"""From a calibrated MuJoCo model to a stand-up policy.

calibrated.xml + randomization.yaml -> StandUp -> Policy

`frasa_rl.StandUp` is also registered with gymnasium as `frasa/StandUp-v0`. Importing this
package imports neither torch nor MuJoCo.
"""

import ctypes
import os
import sys
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frasa_rl.config import Task
    from frasa_rl.policy import Policy
    from frasa_rl.standup_env import StandUp
    from frasa_rl.task_file import dump_task, load_task

__version__ = "0.1.0"
__all__ = ["Policy", "StandUp", "Task", "__version__", "dump_task", "load_task"]

_HOMES = {
    "StandUp": "frasa_rl.standup_env",
    "Policy": "frasa_rl.policy",
    "Task": "frasa_rl.config",
    "dump_task": "frasa_rl.task_file",
    "load_task": "frasa_rl.task_file",
}

# MuJoCo chooses its OpenGL when it is imported: without a display only EGL draws, and
# asking for EGL where there is none would break the import.
if sys.platform == "linux" and not {"DISPLAY", "MUJOCO_GL"} & set(os.environ):
    with suppress(OSError):
        ctypes.CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"

if find_spec("gymnasium"):
    from gymnasium import register

    register("frasa/StandUp-v0", entry_point="frasa_rl.standup_env:StandUp")


def __getattr__(name: str) -> Any:  # noqa: ANN401 - what a module exports
    """Import what this package exports on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'frasa_rl' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)

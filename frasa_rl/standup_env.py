"""Standing up, as a gymnasium environment: one robot of `StandUpBatch`.

action in [-1, 1]^5 -> rates of 5 joints on both sides -> 50 ms of physics -> 22 observed numbers, a reward
"""

from pathlib import Path
from typing import Any, get_args

import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from frasa_rl.batch_env import Outcome, StandUpBatch
from frasa_rl.config import Task
from frasa_rl.falls import Kind
from frasa_rl.observation import Observation, bounds
from frasa_rl.randomize import Randomizer
from frasa_rl.render import Camera, Frame
from frasa_rl.reward import TERMS
from frasa_rl.robot import Floats
from frasa_rl.simulation import set_state
from frasa_rl.starts import StartMaker, compat_starts
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import UsageError, calibration_id, load_calibration

Action = npt.NDArray[np.float32]
_START = Task()


class StandUp(gymnasium.Env[Observation, Action]):
    """A fallen humanoid learns to stand up.

    Every episode draws its robot anew from the calibration's measured ranges and the task's
    assumed ones, settles a fall under it, and runs until it falls over, spins too fast, or
    `episode_s` is over. All chance comes from `np_random` (not in compat `frasa2024`).

    Args:
        model: a model file; a calibrated one brings its ranges along.
        task: poses, rates, rewards, ranges.
        randomize: False keeps the model as it is in its file.
        render_mode: `rgb_array` or None.

    Raises:
        ModelError: the file is missing or broken, or lacks a joint or sensor.
        CalibrationError: the model is calibrated and its ranges are missing or belong to another.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / _START.control_period_s)}  # noqa: RUF012

    def __init__(
        self,
        model: Path | str = Path("robot_model/calibrated.xml"),
        task: Task = _START,
        *,
        randomize: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UsageError(f"unknown render_mode '{render_mode}': expected rgb_array or None")
        self.task, self.render_mode = task, render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / task.control_period_s)}
        compiled = build_model(Path(model), task, textures=render_mode is not None)
        self.calibration_id = calibration_id(compiled)
        self._maker = StartMaker(compiled, task, load_calibration(Path(model)), randomize=randomize, threads=1)
        self._compat = compat_starts(self._maker) if task.compat else None
        self.robot = self._maker.robot
        self._core = StandUpBatch(compiled, task, 1, threads=1)
        self._bounds = bounds(task)
        self.observation_space = spaces.Box(-self._bounds, self._bounds, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (len(task.joints),), dtype=np.float32)
        self._camera: Camera | None = None
        self._data = mujoco.MjData(compiled)

    @property
    def core(self) -> StandUpBatch:
        """The batch of one robot behind this environment."""
        return self._core

    @property
    def randomizer(self) -> Randomizer | None:
        """What draws the robots; None when the model stays as it is."""
        return self._maker.randomizer

    @property
    def drawn(self) -> dict[str, float]:
        """What was randomized in the present robot."""
        return self._core.drawn[0]

    @property
    def divergences(self) -> int:
        """Episodes that ended because the simulation blew up."""
        return self._core.divergences

    @property
    def model(self) -> mujoco.MjModel:
        """The present robot's model; nobody writes to it."""
        return self._core.batch.sim.models[0]

    @property
    def data(self) -> mujoco.MjData:
        """A picture of the present instant, after `mj_forward`: to look at, not to change.

        Its delayed sensors are those of a model made `fresh`; what the robot reads stands in the observation.
        """
        sim = self._core.batch.sim
        self._data.ctrl[:] = sim.ctrl[0]
        set_state(self.model, self._data, sim.state[0])
        return self._data

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with a newly drawn robot, settled under its own model.

        Args:
            seed: restarts the environment's chance.
            options: `start`: `any` (default), `random`, `prone`, `supine`, `target` or `falling`.
        """
        super().reset(seed=seed)
        kind: Kind = (options or {}).get("start", "any")
        if kind not in get_args(Kind):
            raise UsageError(f"unknown start '{kind}': expected {', '.join(get_args(Kind))}")
        starts = self._compat.make([self.np_random]) if self._compat else self._maker.make([self.np_random], [kind])
        self._core.begin(0, starts[0])
        return self._core.batch.observation[0].copy(), _info(None)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply one action for a control period.

        Args:
            action: joint rates as a share of the rate limit, clipped to [-1, 1], shape (5,).

        Raises:
            ValueError: another shape, or numbers that are not finite.
        """
        out = self._core.step(np.asarray(action, dtype=np.float64)[None])
        return out.observation[0], float(out.reward[0]), bool(out.terminated[0]), bool(out.truncated[0]), _info(out)

    def errors(self) -> Floats:
        """The 5 joint errors (mean of both sides) and the pitch error to the standing pose [rad], shape (6,)."""
        return np.asarray(self._core.batch.errors()[0])

    def render(self) -> Frame | None:
        """The scene now, shape (height, width, 3), in render mode `rgb_array`."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = Camera(self.model, self.task.names.trunk)
        return self._camera.picture(self.data)

    def close(self) -> None:
        """Free the renderer and the threads."""
        self._core.close()
        if self._camera is not None:
            self._camera.close()
            self._camera = None


def _info(out: Outcome | None) -> dict[str, Any]:
    if out is None:
        return {"diverged": False, "is_success": False, "terms": {}}
    terms = {} if out.diverged[0] else dict(zip(TERMS, out.terms[:, 0].tolist(), strict=True))
    return {"diverged": bool(out.diverged[0]), "is_success": bool(out.success[0]), "terms": terms}

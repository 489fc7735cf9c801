"""The stand-up task as a stable-baselines3 `VecEnv`: many robots on all cores, episodes that restart from a pool."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from frasa_rl.config import Task
from frasa_rl.episodes import make_episodes
from frasa_rl.observation import bounds

_START = Task()


class StandUpVecEnv(VecEnv):
    """Many robots, one call of MuJoCo for all of them.

    An episode that ends is followed by one of another start from the pool, chosen by the generator of its place.

    Args:
        model: a model file; a calibrated one brings its ranges along.
        task: poses, rates, rewards, ranges.
        count: of robots.
        randomize: False keeps the model as it is in its file.
        pool: starts to choose from, each with a robot of its own.
        seed: of the pool and of the choices.
        threads: None for one a core.
        keep: keep the pool in the cache folder.
        tell: called with the share done while the pool is made.

    Raises:
        ModelError: the file is missing or broken, or lacks a joint or sensor.
        CalibrationError: the model is calibrated and its ranges are missing or belong to another.
    """

    def __init__(
        self,
        model: Path | str = Path("robot_model/calibrated.xml"),
        task: Task = _START,
        count: int = 16,
        *,
        randomize: bool = True,
        pool: int = 512,
        seed: int = 0,
        threads: int | None = None,
        keep: bool = True,
        tell: Callable[[float], None] = lambda _: None,
    ) -> None:
        self.episodes = make_episodes(
            model, task, count, randomize=randomize, pool=pool, seed=seed, threads=threads, keep=keep, tell=tell
        )
        self.task, self.calibration_id = task, self.episodes.calibration_id
        self.pool, self.core = self.episodes.pool, self.episodes.core
        limit = bounds(task)
        self.render_mode = None
        super().__init__(
            count,
            spaces.Box(-limit, limit, dtype=np.float32),
            spaces.Box(-1.0, 1.0, (len(task.joints),), dtype=np.float32),
        )
        self._actions = np.zeros((count, len(task.joints)))

    @property
    def divergences(self) -> int:
        """Episodes that ended because the simulation blew up."""
        return self.core.divergences

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Restart the choice of starts."""
        first = 0 if seed is None else seed
        self.episodes.seed(first)
        return [first] * self.count

    @property
    def count(self) -> int:
        """Robots side by side."""
        return self.core.count

    def reset(self) -> VecEnvObs:
        """Start an episode of every robot."""
        self.reset_infos = [{} for _ in range(self.count)]
        return self.episodes.begin()

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions; they are simulated in `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate a control period of all robots."""
        step = self.episodes.step(self._actions)
        out = step.out
        infos: list[dict[str, Any]] = [{"posture": one} for one in out.terms[0].tolist()]
        for place in np.flatnonzero(step.over):
            infos[place] |= {
                "terminal_observation": out.observation[place],
                "TimeLimit.truncated": bool(out.truncated[place]),
                "is_success": bool(out.success[place]),
                "diverged": bool(out.diverged[place]),
            }
        return step.following, step.reward.astype(np.float32), step.over, infos

    def close(self) -> None:
        """End the threads."""
        self.episodes.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute, once for every place asked for."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:  # noqa: ANN401
        """Set an attribute of all robots."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:  # noqa: ANN401
        """Call a method, once for every place asked for."""
        return [getattr(self, method_name)(*args, **kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """No robot is wrapped."""
        return [False for _ in self._get_indices(indices)]

"""Standing up, as a gymnasium environment: reset and step, and what they are made of stands above it.

action in [-1, 1]^5 -> rates of 5 joints on both sides -> 50 ms of physics -> 22 observed numbers, a reward
"""

from pathlib import Path
from typing import Any, get_args

import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from frasa_rl import reward
from frasa_rl.config import Task
from frasa_rl.falls import Kind, diverged, settle_start
from frasa_rl.observation import Observation, bounds, observe
from frasa_rl.randomize import Randomizer
from frasa_rl.render import Camera, Frame
from frasa_rl.robot import Floats, find_robot, pitch_of
from frasa_sysid.calibration import UsageError, calibration_id, load_calibration, load_model

Action = npt.NDArray[np.float32]
_START = Task()


class StandUp(gymnasium.Env[Observation, Action]):
    """A fallen humanoid learns to stand up.

    One model belongs to one environment: every episode draws its robot anew from the
    calibration's measured ranges and the task's assumed ones, settles a fall under it,
    and runs until it falls over, spins too fast, or `episode_s` is over. All chance
    comes from `np_random`.

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
        self.task = task
        self.model = load_model(Path(model))
        self.robot = find_robot(self.model, task)
        self.data = mujoco.MjData(self.model)
        self.calibration_id = calibration_id(self.model)
        self.randomizer = Randomizer(self.model, self.robot, task, load_calibration(Path(model)))
        self.render_mode = render_mode
        self.drawn: dict[str, float] = {}
        self.divergences = 0  # episodes that ended because the simulation blew up

        n = len(task.joints)
        self._bounds = bounds(task)
        self.observation_space = spaces.Box(-self._bounds, self._bounds, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n,), dtype=np.float32)
        self._randomize = randomize
        self._camera: Camera | None = None
        self._action = np.zeros(n)
        self._steps = self._standing_steps = 0

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
        if self._randomize:
            self.drawn = self.randomizer.draw(self.np_random)
        settle_start(self.model, self.data, self.robot, self.task, self.np_random, kind)
        self._action = np.zeros(len(self.task.joints))
        self._steps = self._standing_steps = 0
        self._last = self._observe()
        return self._last, self._info({})

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply one action for a control period.

        Args:
            action: joint rates as a share of the rate limit, clipped to [-1, 1], shape (5,).

        Raises:
            ValueError: another shape, or numbers that are not finite.
        """
        wanted = np.asarray(action, dtype=np.float64)
        if wanted.shape != self._action.shape or not np.isfinite(wanted).all():
            raise ValueError(f"action {wanted}: expected {self._action.size} finite numbers")
        previous, self._action = self._action, np.clip(wanted, -1.0, 1.0)
        self._steps += 1
        truncated = self._steps * self.task.control_period_s >= self.task.episode_s - 1e-9
        self._advance(self._action * self.task.rate_limit)
        if diverged(self.data):
            self.divergences += 1
            self._standing_steps = 0
            return self._last, 0.0, True, False, {"diverged": True, "is_success": False, "terms": {}}
        mujoco.mj_forward(self.model, self.data)  # the sensors now speak of this instant, not of a substep ago
        terms = self._reward_terms(previous)
        self._last = self._observe()
        over = self._over()
        return self._last, sum(terms.values()), over, truncated and not over, self._info(terms)

    def errors(self) -> Floats:
        """The 5 joint errors (mean of both sides) and the pitch error to the standing pose [rad], shape (6,)."""
        return reward.errors(self.robot, self.data, self.task)

    def render(self) -> Frame | None:
        """The scene now, shape (height, width, 3), in render mode `rgb_array`."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = Camera(self.model)
        return self._camera.picture(self.data)

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _advance(self, rates: Floats) -> None:
        """Ramp the commands linearly over the period, inside the command limits.

        A Python loop over `mj_step` is as fast here as `mujoco.rollout` with a control
        sequence (1.12 and 1.20 ms a period, MuJoCo 3.17), and keeps the warm start.
        """
        start = self.robot.mean_of_sides(self.data.ctrl[self.robot.actuators])
        goal = np.clip(start + rates * self.task.control_period_s, *self.robot.limits.T)
        for share in np.arange(1, self.robot.substeps + 1) / self.robot.substeps:
            self.data.ctrl[self.robot.actuators] = self.robot.both_sides(start + share * (goal - start))
            mujoco.mj_step(self.model, self.data)

    def _reward_terms(self, previous: Floats) -> dict[str, float]:
        weights, limit = self.task.reward, self.task.rate_limit
        error = self.errors()
        standing = np.degrees(np.abs(error)).max() < self.task.success_deg
        self._standing_steps = self._standing_steps + 1 if standing else 0
        return {
            "posture": reward.posture(weights, error),
            "action": reward.action(weights, self._action * limit),
            "variation": reward.variation(weights, self._action * limit, previous * limit),
            "self_contact": reward.self_contact(weights, reward.self_contact_force(self.robot, self.data)),
        }

    def _over(self) -> bool:
        """Fallen beyond the pitch limit, or turning too fast, tested at the end of a control period."""
        pitch = np.degrees(pitch_of(self.data.sensordata[self.robot.orientation]))
        rate = self.data.sensordata[self.robot.gyro][1]
        return bool(abs(pitch) > self.task.end_pitch_deg or abs(rate) > self.task.end_gyro)

    def _observe(self) -> Observation:
        return observe(self.robot, self.data, self._action, self._bounds)

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        held_s = (self._standing_steps - 1) * self.task.control_period_s
        return {"diverged": False, "is_success": held_s >= self.task.success_hold_s - 1e-9, "terms": terms}

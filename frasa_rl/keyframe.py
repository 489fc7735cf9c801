"""Standing up by keyframes, through the same actions and observations as a policy.

observation -> fall detector -> which routine, and where in it -> commands wanted -> action

A key's pose becomes an action as (wanted - present command) / (rate limit x period), so the
commands move along straight lines between the keys whatever the period of the decisions is.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from frasa_rl.config import Task
from frasa_rl.fall_detector import FallDetector, Posture
from frasa_rl.keyframe_file import load_keyframes
from frasa_rl.observation import layout
from frasa_rl.robot import Floats
from frasa_rl.routine import KeyframeError, Keyframes, Routine, check_limits

KEYFRAMES = Path("robot_model/keyframes.yaml")

_SLACK = 1e-3  # of a segment's shortest duration, so that rounding never asks for more than the rate limit


class KeyframeController:
    """Starts a routine when the detector sees a robot lying, and holds the standing command while it is upright.

    A routine that ends with the robot lying starts again. Robots do not know of each
    other: each has its own clock, routine and correction.

    Args:
        keyframes: routines, standing command, detector.
        task: names the joints, their rate limit and the standing pose.

    Raises:
        KeyframeError: the file is for other joints.
    """

    name = "keyframe"

    def __init__(self, keyframes: Keyframes, task: Task) -> None:
        joints = tuple(one.name for one in task.joints)
        if keyframes.joints != joints:
            raise KeyframeError(f"the keyframes move {', '.join(keyframes.joints)}; the task {', '.join(joints)}")
        self._file, self._rate = keyframes, task.rate_limit
        self._target = np.radians([one.target_deg for one in task.joints])
        self._command = np.radians(keyframes.standing.command_deg)
        self._parts = _slices(task)
        self.start(0, task.control_period_s)

    def start(self, count: int, period_s: float) -> None:
        """Forget everything.

        Args:
            count: robots.
            period_s: time between two calls of `act` [s].
        """
        self._period = period_s
        self._detector = FallDetector(self._file.detector, count, period_s)
        self._plans: list[_Plan | None] = [None] * count
        self._correction = np.zeros((count, len(self._target)))

    def act(self, observation: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Actions in [-1, 1] for n joints, shape (count, n).

        Args:
            observation: laid out as `frasa_rl.observation.layout`, shape (count, 22 for 5 joints).
        """
        seen = {name: np.asarray(observation[:, part], dtype=np.float64) for name, part in self._parts.items()}
        postures = self._detector.look(seen["pitch"][:, 0], seen["pitch_rate"][:, 0])
        self._start_and_end_plans(postures, seen["command"])
        wanted = self._wanted(postures, seen["command"], seen["position"])
        action = (wanted - seen["command"]) / (self._rate * self._period)
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def _start_and_end_plans(self, postures: npt.NDArray[np.int64], commands: Floats) -> None:
        """A lying robot without a plan gets one; a plan that is over is forgotten."""
        for robot, posture in enumerate(postures):
            plan = self._plans[robot]
            if plan is not None and plan.over:
                plan = self._plans[robot] = None
            if plan is None and posture in (Posture.PRONE, Posture.SUPINE):
                routine = self._file.prone if posture == Posture.PRONE else self._file.supine
                self._plans[robot] = _Plan(routine, commands[robot], self._command, self._rate)
                self._correction[robot] = 0.0

    def _wanted(self, postures: npt.NDArray[np.int64], commands: Floats, positions: Floats) -> Floats:
        """Commands at the end of this period [rad], shape (count, n); a falling robot holds those it has."""
        standing = self._file.standing
        upright = postures == Posture.STANDING
        free = upright & np.array([plan is None for plan in self._plans], dtype=bool)
        step = standing.gain * self._period * (self._target - positions[free])
        largest = np.radians(standing.correction_max_deg)
        self._correction[free] = np.clip(self._correction[free] + step, -largest, largest)
        wanted = np.where(upright[:, None], self._command + self._correction, commands)
        for robot, plan in enumerate(self._plans):
            if plan is not None:
                wanted[robot] = plan.advance(self._period)
        return wanted


class _Plan:
    """One robot's way through a routine, from the commands it has.

    Args:
        routine: keys to pass.
        command: where the joints' commands are now [rad], shape (n,).
        standing: where they end [rad], shape (n,).
        rate: limit of every joint [rad/s]; no segment is shorter than it allows.
    """

    def __init__(self, routine: Routine, command: Floats, standing: Floats, rate: float) -> None:
        poses = [command, *(np.radians(key.angles_deg) for key in routine.keys), standing]
        self._poses = np.stack(poses)
        asked = np.array([*(key.duration_s for key in routine.keys), routine.rise_s])
        needed = np.abs(np.diff(self._poses, axis=0)).max(axis=1) / rate * (1.0 + _SLACK)
        self._times = np.concatenate([[0.0], np.cumsum(np.maximum(asked, needed))])
        self._clock_s = 0.0

    @property
    def over(self) -> bool:
        """Whether the standing command has been reached."""
        return bool(self._clock_s >= self._times[-1])

    def advance(self, period_s: float) -> Floats:
        """Let time pass; the commands wanted then [rad], shape (n,)."""
        self._clock_s += period_s
        return np.array([np.interp(self._clock_s, self._times, joint) for joint in self._poses.T])


def load_controller(path: Path, task: Task, limits_deg: Floats) -> KeyframeController:
    """The controller of a file.

    Args:
        path: of the keyframes.
        task: names the joints.
        limits_deg: lowest and highest command of each joint [deg], shape (n, 2).

    Raises:
        KeyframeError: the file is missing, broken, for other joints, or asks for angles outside the limits.
    """
    keyframes = load_keyframes(path)
    try:
        controller = KeyframeController(keyframes, task)
        check_limits(keyframes, limits_deg)
    except KeyframeError as error:
        raise KeyframeError(f"{path}: {error}") from None
    return controller


def _slices(task: Task) -> dict[str, slice]:
    """Where each part of an observation is."""
    places, start = {}, 0
    for part in layout(task):
        places[part.name] = slice(start, start + part.size)
        start += part.size
    return places

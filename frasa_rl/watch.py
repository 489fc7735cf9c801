"""One trial of the protocol as numbers over time: what a controller saw, told and did, and where the robot was."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from frasa_rl.controllers import Controller
from frasa_rl.observation import Observation
from frasa_rl.policy import Array
from frasa_rl.protocol import LIMIT_S, Conditions, Side
from frasa_rl.protocol_push import Cell, PushRun
from frasa_rl.protocol_standup import judge_standup, start_standup
from frasa_rl.robot import Floats
from frasa_rl.trials import Trials

_ROWS = ("t", "joints", "commands", "actions", "pitch", "height", "worst_deg", "states")


@dataclass(frozen=True)
class Watched:
    """A trial, one row a control period; the first is the start.

    Attributes:
        t: since the trial began [s], shape (T,).
        names: of the n moved joints.
        joints: mean of both sides, seen from the left [rad], shape (T, n).
        commands: what the servos were told, likewise [rad], shape (T, n).
        actions: of the last decision before, as shares of the rate limit, shape (T, n); the first row is zero.
        pitch: of the trunk, forward positive [rad], shape (T,).
        height: of the trunk [m], shape (T,).
        worst_deg: largest of the six errors to the standing pose [deg], shape (T,).
        states: full physics states of `model`, shape (T, ns).
        model: of this trial.
        trunk: name of the trunk's body.
        time_s: until it stood, or of instability after the push [s]; None: it did not, in the time watched.
        stood: it stood before the push, which else does not come.
    """

    t: Floats
    names: tuple[str, ...]
    joints: Floats
    commands: Floats
    actions: Floats
    pitch: Floats
    height: Floats
    worst_deg: Floats
    states: Floats
    model: mujoco.MjModel
    trunk: str
    time_s: float | None
    stood: bool = True

    @property
    def words(self) -> str:
        """How it ended: the time, or that it did not."""
        if not self.stood:
            return "did not stand before the push"
        return f"not within {self.t[-1]:.1f} s" if self.time_s is None else f"{self.time_s:.2f} s"

    def until_decided(self, more_s: float = 0.15) -> "Watched":
        """The rows until shortly after it stood up; all of them where it did not."""
        return self if self.time_s is None else self.between(0.0, self.time_s + more_s)

    def between(self, begin: float, end: float) -> "Watched":
        """The rows of a stretch of time [s], both ends included."""
        kept = (self.t >= begin - 1e-9) & (self.t <= end + 1e-9)
        return replace(self, **{name: getattr(self, name)[kept] for name in _ROWS})


def watch_standup(
    controller: Controller,
    conditions: Conditions,
    side: Side,
    seconds: float = LIMIT_S,
    more_s: float = 1.0,
    textures: bool = False,
) -> Watched:
    """Watch the first stand-up trial from a side.

    Args:
        controller: of the robot.
        conditions: model, task, rate.
        side: how the robot lies.
        seconds: after which it ends in any case.
        more_s: after it stood up [s].
        textures: keep what only pictures need.

    Raises:
        ModelError: the model is broken, lacks something, or does not come to rest as asked.
        CalibrationError: its ranges are missing or belong to another.
        UsageError: the rate does not fit the task.
    """
    trials, kinds = start_standup(conditions, 1, [side], textures)
    try:
        heard = _Heard(controller)
        heard.start(1, trials.batch.period_s)

        def decided() -> float | None:
            return judge_standup(trials, kinds)[0].time_s

        return _record(trials, heard, trials.decide, decided, seconds, more_s)
    finally:
        trials.batch.close()


def watch_push(
    controller: Controller,
    conditions: Conditions,
    cell: Cell,
    seconds: float = LIMIT_S,
    more_s: float = 1.0,
    textures: bool = False,
) -> Watched:
    """Watch the first trial of a push, from the pendulum's release on; arguments and errors as in `watch_standup`.

    Args:
        controller: of the robot.
        conditions: model, task with its pendulum, rate.
        cell: direction and energy [J].
        seconds: after which it ends in any case.
        more_s: after it is stable again [s].
        textures: keep what only pictures need.
    """
    run = PushRun(conditions, [cell], [0], textures)
    try:
        heard = _Heard(controller)
        run.stand(heard)
        run.release()

        def decided() -> float | None:
            return run.judge()[0].time_s

        return replace(_record(run.trials, heard, run.step, decided, seconds, more_s), stood=bool(run.stood[0]))
    finally:
        run.trials.batch.close()


class _Heard:
    """A controller whose last actions are kept."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self.name = controller, controller.name
        self.last: Array = np.zeros((0, 0), dtype=np.float32)

    def start(self, count: int, period_s: float) -> None:
        self._controller.start(count, period_s)

    def act(self, observation: Observation) -> Array:
        self.last = self._controller.act(observation)
        return self.last


def _record(
    trials: Trials,
    heard: _Heard,
    step: Callable[[Controller], None],
    decided: Callable[[], float | None],
    seconds: float,
    more_s: float,
) -> Watched:
    """Step the only robot, until some time after the trial is decided or time is up."""
    batch, period = trials.batch, trials.batch.task.control_period_s
    rows = [_row(trials, np.zeros(batch.commands.shape[1]))]
    more = round(more_s / period)
    while trials.now_s < seconds - 1e-9 and more > 0:
        step(heard)
        if trials.every(period):
            rows.append(_row(trials, np.asarray(heard.last[0], dtype=np.float64)))
            more -= decided() is not None
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in _ROWS}
    return Watched(
        **columns,
        names=tuple(one.name for one in batch.task.joints),
        model=batch.sim.models[0],
        trunk=batch.task.names.trunk,
        time_s=decided(),
    )


def _row(trials: Trials, action: Floats) -> dict[str, Floats | float]:
    batch = trials.batch
    return {
        "t": trials.now_s,
        "joints": batch.robot.mean_of_sides(batch.now.positions)[0],
        "commands": batch.commands[0].copy(),
        "actions": action,
        "pitch": float(batch.now.pitch[0]),
        "height": float(batch.now.height[0]),
        "worst_deg": float(trials.worst_deg()[0, -1]),
        "states": batch.sim.state[0].copy(),
    }

"""One trial of the protocol as pictures."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from frasa_rl.controllers import Controller
from frasa_rl.protocol import LIMIT_S, Conditions, Side
from frasa_rl.protocol_push import Cell, PushRun
from frasa_rl.protocol_standup import judge_standup, start_standup
from frasa_rl.render import Camera, Frame
from frasa_rl.robot import Floats
from frasa_rl.simulation import set_state
from frasa_rl.trials import Trials

_PUSH_VIEW = 1.9  # distance from the trunk that shows the pendulum come [m]


@dataclass(frozen=True)
class Film:
    """Pictures of a trial, one every control period.

    Attributes:
        frames: at least one.
        frames_per_s: of them.
        time_s: to stand up, or of instability after the push [s]; None: it did not, in the time filmed.
        times_s: of each picture since the film begins [s].
        stood: the robot stood before the push, which else does not come.
    """

    frames: list[Frame]
    frames_per_s: float
    time_s: float | None
    times_s: list[float]
    stood: bool = True


@dataclass(frozen=True)
class Shots:
    """Which pictures are taken, and how large.

    Attributes:
        count: evenly spaced ones, first and last among them; None for one every control period.
        width, height: of each [pixel].
        more_s: after the trial is decided [s].
    """

    count: int | None = None
    width: int = 480
    height: int = 360
    more_s: float = 1.0


def film_standup(
    controller: Controller, conditions: Conditions, side: Side, seconds: float = LIMIT_S, shots: Shots | None = None
) -> Film:
    """Film the first stand-up trial from a side, until some time after it stood up (`Shots.more_s`) or time is up.

    Raises:
        RenderError: this machine cannot draw.
    """
    trials, kinds = start_standup(conditions, 1, [side], textures=True)
    try:
        shots = shots or Shots()
        camera = Camera(trials.batch.sim.models[0], conditions.task.names.trunk, shots.width, shots.height)
        controller.start(1, trials.batch.period_s)
        states = _record(
            trials,
            lambda: trials.decide(controller),
            lambda: judge_standup(trials, kinds)[0].time_s,
            seconds,
            shots.more_s,
        )
        return _film(trials, states, judge_standup(trials, kinds)[0].time_s, camera, shots.count)
    finally:
        trials.batch.close()


def film_push(
    controller: Controller, conditions: Conditions, cell: Cell, seconds: float = LIMIT_S, shots: Shots | None = None
) -> Film:
    """Film the first trial of a push from its release on, until some time after it is stable or time is up.

    Raises:
        RenderError: this machine cannot draw.
    """
    run = PushRun(conditions, [cell], [0], textures=True)
    try:
        shots = shots or Shots()
        model, trunk = run.trials.batch.sim.models[0], conditions.task.names.trunk
        camera = Camera(model, trunk, shots.width, shots.height, distance=_PUSH_VIEW, azimuth=90.0)
        run.stand(controller)
        run.release()
        states = _record(run.trials, lambda: run.step(controller), lambda: run.judge()[0].time_s, seconds, shots.more_s)
        film = _film(run.trials, states, run.judge()[0].time_s, camera, shots.count)
        return replace(film, stood=bool(run.stood[0]))
    finally:
        run.trials.batch.close()


def _record(
    trials: Trials, step: Callable[[], None], decided: Callable[[], float | None], seconds: float, more_s: float
) -> list[Floats]:
    """States of the only robot, one a control period."""
    period = trials.batch.task.control_period_s
    states = [trials.batch.sim.state[0].copy()]
    more = round(more_s / period)
    while trials.now_s < seconds - 1e-9 and more > 0:
        step()
        if trials.every(period):
            states.append(trials.batch.sim.state[0].copy())
            more -= decided() is not None
    return states


def _film(trials: Trials, states: list[Floats], time_s: float | None, camera: Camera, count: int | None = None) -> Film:
    """Draw the states, or so many of them."""
    model = trials.batch.sim.models[0]
    data = mujoco.MjData(model)
    frames, period = [], trials.batch.task.control_period_s
    shown = np.linspace(0, len(states) - 1, min(count or len(states), len(states))).round().astype(int)
    try:
        for index in shown:
            set_state(model, data, states[index])
            frames.append(camera.picture(data))
    finally:
        camera.close()
    return Film(frames, 1.0 / period, time_s, [float(index * period) for index in shown])

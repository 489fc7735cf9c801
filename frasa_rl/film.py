"""One trial of the protocol as pictures."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco

from frasa_rl.controllers import Controller
from frasa_rl.protocol import LIMIT_S, Conditions, Side
from frasa_rl.protocol_push import Cell, PushRun
from frasa_rl.protocol_standup import judge_standup, start_standup
from frasa_rl.render import Camera, Frame
from frasa_rl.robot import Floats
from frasa_rl.simulation import set_state
from frasa_rl.trials import Trials

_MORE_S = 1.0  # of film after the trial is decided
_PUSH_VIEW = 1.9  # distance from the trunk that shows the pendulum come [m]


@dataclass(frozen=True)
class Film:
    """Pictures of a trial, one every control period.

    Attributes:
        frames: at least one.
        frames_per_s: of them.
        time_s: to stand up, or of instability after the push [s]; None: it did not, in the time filmed.
        stood: the robot stood before the push, which else does not come.
    """

    frames: list[Frame]
    frames_per_s: float
    time_s: float | None
    stood: bool = True


def film_standup(controller: Controller, conditions: Conditions, side: Side, seconds: float = LIMIT_S) -> Film:
    """Film the first stand-up trial from a side, until a second after it stood up or time is up.

    Raises:
        RenderError: this machine cannot draw.
    """
    trials, kinds = start_standup(conditions, 1, [side], textures=True)
    try:
        camera = Camera(trials.batch.sim.models[0], conditions.task.names.trunk)
        controller.start(1, trials.batch.period_s)
        states = _record(
            trials, lambda: trials.decide(controller), lambda: judge_standup(trials, kinds)[0].time_s, seconds
        )
        return _film(trials, states, judge_standup(trials, kinds)[0].time_s, camera)
    finally:
        trials.batch.close()


def film_push(controller: Controller, conditions: Conditions, cell: Cell, seconds: float = LIMIT_S) -> Film:
    """Film the first trial of a push from its release on, until a second after it is stable or time is up.

    Raises:
        RenderError: this machine cannot draw.
    """
    run = PushRun(conditions, [cell], [0], textures=True)
    try:
        camera = Camera(run.trials.batch.sim.models[0], conditions.task.names.trunk, distance=_PUSH_VIEW, azimuth=90.0)
        run.stand(controller)
        run.release()
        states = _record(run.trials, lambda: run.step(controller), lambda: run.judge()[0].time_s, seconds)
        film = _film(run.trials, states, run.judge()[0].time_s, camera)
        return replace(film, stood=bool(run.stood[0]))
    finally:
        run.trials.batch.close()


def _record(
    trials: Trials, step: Callable[[], None], decided: Callable[[], float | None], seconds: float
) -> list[Floats]:
    """States of the only robot, one a control period."""
    period = trials.batch.task.control_period_s
    states = [trials.batch.sim.state[0].copy()]
    more = round(_MORE_S / period)
    while trials.now_s < seconds - 1e-9 and more > 0:
        step()
        if trials.every(period):
            states.append(trials.batch.sim.state[0].copy())
            more -= decided() is not None
    return states


def _film(trials: Trials, states: list[Floats], time_s: float | None, camera: Camera) -> Film:
    model = trials.batch.sim.models[0]
    data = mujoco.MjData(model)
    frames = []
    try:
        for state in states:
            set_state(model, data, state)
            frames.append(camera.picture(data))
    finally:
        camera.close()
    return Film(frames, 1.0 / trials.batch.task.control_period_s, time_s)

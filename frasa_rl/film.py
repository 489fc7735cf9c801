"""One trial of the protocol as pictures."""

from dataclasses import dataclass

import mujoco
import numpy as np

from frasa_rl.controllers import Controller
from frasa_rl.protocol import LIMIT_S, Conditions, Side
from frasa_rl.protocol_push import Cell
from frasa_rl.render import Camera, Frame, check_drawing
from frasa_rl.simulation import set_state
from frasa_rl.watch import Watched, watch_push, watch_standup

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
    check_drawing()
    shots = shots or Shots()
    return film_of(watch_standup(controller, conditions, side, seconds, shots.more_s, textures=True), shots)


def film_push(
    controller: Controller, conditions: Conditions, cell: Cell, seconds: float = LIMIT_S, shots: Shots | None = None
) -> Film:
    """Film the first trial of a push from its release on, until some time after it is stable or time is up.

    Raises:
        RenderError: this machine cannot draw.
    """
    check_drawing()
    shots = shots or Shots()
    watched = watch_push(controller, conditions, cell, seconds, shots.more_s, textures=True)
    return film_of(watched, shots, distance=_PUSH_VIEW, azimuth=90.0)


def film_of(watched: Watched, shots: Shots, distance: float = 1.1, azimuth: float = 120.0) -> Film:
    """Draw a trial, or some moments of it.

    Args:
        watched: with textures, or it looks plain.
        shots: which pictures, and how large.
        distance: of the camera from the trunk [m].
        azimuth: from which side [deg], see `Camera`.

    Raises:
        RenderError: this machine cannot draw.
    """
    camera = Camera(watched.model, watched.trunk, shots.width, shots.height, distance, azimuth)
    data, frames = mujoco.MjData(watched.model), []
    shown = evenly(len(watched.t), shots.count)
    try:
        for index in shown:
            set_state(watched.model, data, watched.states[index])
            frames.append(camera.picture(data))
    finally:
        camera.close()
    rate = 1.0 / float(watched.t[1] - watched.t[0]) if len(watched.t) > 1 else 1.0
    return Film(frames, rate, watched.time_s, [float(watched.t[index]) for index in shown], watched.stood)


def evenly(samples: int, count: int | None) -> list[int]:
    """So many of all samples, evenly spaced, the first and the last among them; None for all."""
    return [int(one) for one in np.linspace(0, samples - 1, min(count or samples, samples)).round()]

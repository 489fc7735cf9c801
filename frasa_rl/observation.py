"""What the policy sees: 22 numbers, read from the model's own delayed sensors.

The age of every number is a property of the model (`sensor_delay`): nothing is buffered here.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frasa_rl.config import Task
from frasa_rl.readings import Readings
from frasa_rl.robot import Floats, Robot

Observation = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Part:
    """A group of observed numbers.

    Attributes:
        name: what it is.
        size: how many numbers.
        unit: of each.
        bound: largest magnitude; anything beyond is clipped, so that the declared space holds.
    """

    name: str
    size: int
    unit: str
    bound: float


def layout(task: Task) -> tuple[Part, ...]:
    """The parts of an observation, in order.

    Positions and velocities are the mean of both sides, as the paper says. The previous
    action is what was applied over the last control period: without it the variation reward
    would not be a function of what is observed.
    """
    n = len(task.joints)
    return (
        Part("position", n, "rad", 2.0 * np.pi),
        Part("velocity", n, "rad/s", 30.0),
        Part("command", n, "rad", np.pi),
        Part("pitch", 1, "rad", np.pi),
        Part("pitch_rate", 1, "rad/s", 30.0),
        Part("previous_action", n, "1", 1.0),
    )


def bounds(task: Task) -> Observation:
    """Largest magnitude of every observed number, shape (22,)."""
    return np.concatenate([np.full(part.size, part.bound, dtype=np.float32) for part in layout(task)])


def observe(robot: Robot, read: Readings, commands: Floats, action: Floats, bound: Observation) -> Observation:
    """What all robots see, shape (count, 22).

    Args:
        robot: mirrors the sides.
        read: what the sensors say.
        commands: present ones of the moved joints, seen from the left [rad], shape (count, n).
        action: mean of what was applied over the last control period, in [-1, 1], shape (count, n).
        bound: from `bounds`.
    """
    seen = np.concatenate(
        [
            robot.mean_of_sides(read.positions),
            robot.mean_of_sides(read.velocities),
            commands,
            read.pitch[:, None],
            read.pitch_rate[:, None],
            action,
        ],
        axis=1,
    )
    clipped: Observation = np.clip(seen, -bound, bound).astype(np.float32)
    return clipped

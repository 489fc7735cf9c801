"""Where the robot's mass is above its feet, and how flat they are: found in the model, no name in the task tells.

The feet are what the robot stands on in its standing pose: the bodies whose lowest points are within a centimetre of
the lowest of all. The sensors are the simulation's alone; no policy sees them.
"""

import mujoco
import numpy as np

from frasa_rl.config import Task
from frasa_rl.poses import lowest_point, place, standing
from frasa_rl.robot import ADDED_SUPPORT, Floats, Robot, find_robot

_SAME_HEIGHT = 0.01  # [m]


def add_support(spec: mujoco.MjSpec, model: mujoco.MjModel, task: Task) -> None:
    """Add sensors of the centre of mass, of where the feet are and how they are turned.

    Args:
        spec: to add them to.
        model: compiled from it, just now.
        task: the standing pose.

    Raises:
        ModelError: the model lacks what the task names.
    """
    robot = find_robot(model, task)
    wanted = [(mujoco.mjtSensor.mjSENS_SUBTREECOM, mujoco.mjtObj.mjOBJ_BODY, model.body(robot.trunk).name)]
    for number, index in enumerate(feet(model, robot, task), start=1):
        foot = next(body for body in spec.bodies if body.id == index)
        foot.name = foot.name or f"frasa_foot_{number}"
        for kind in (mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtSensor.mjSENS_FRAMEQUAT):
            wanted.append((kind, mujoco.mjtObj.mjOBJ_XBODY, foot.name))
    for number, (kind, of_kind, name) in enumerate(wanted):
        spec.add_sensor(name=ADDED_SUPPORT.format(number), type=kind, objtype=of_kind, objname=name)


def feet(model: mujoco.MjModel, robot: Robot, task: Task) -> list[int]:
    """The bodies that the robot stands on."""
    data = mujoco.MjData(model)
    place(model, data, robot, *standing(task))  # its heights are off by as much for all bodies
    bodies = np.unique(model.geom_bodyid[model.body_rootid[model.geom_bodyid] == robot.trunk])
    lowest = np.array([lowest_point(model, data, robot, body) for body in bodies])
    return [int(one) for one in bodies[lowest < lowest.min() + _SAME_HEIGHT]]


class Support:
    """What the numbers of these sensors say.

    Attributes:
        standing: height of the centre of mass above the feet in the standing pose [m].

    Args:
        model: of the task (`build_model`), which asks for them.
        robot: where things are in it.
        task: the standing pose.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, task: Task) -> None:
        data = mujoco.MjData(model)
        place(model, data, robot, *standing(task))
        mujoco.mj_forward(model, data)
        numbers = data.sensordata[robot.support]
        self.standing = float(self.above(numbers)[2])
        self._upward = _third_rows(_turns(numbers))  # the world's up as each foot sees it, (feet, 3)

    def above(self, numbers: Floats) -> Floats:
        """The centre of mass seen from between the feet [m], shape (..., 3), from numbers of (..., 3 + 7 feet)."""
        places = numbers[..., 3:].reshape(*numbers.shape[:-1], -1, 7)[..., :3]
        return np.asarray(numbers[..., :3] - places.mean(axis=-2))

    def flat(self, numbers: Floats) -> Floats:
        """How flat the feet are, from 0 (soles up) to 1 (as when standing), shape (...,)."""
        cosines = np.sum(_third_rows(_turns(numbers)) * self._upward, axis=-1)
        return np.asarray((1.0 + cosines.mean(axis=-1)) / 2.0)


def _turns(numbers: Floats) -> Floats:
    """Quaternions of the feet, shape (..., feet, 4)."""
    return np.asarray(numbers[..., 3:].reshape(*numbers.shape[:-1], -1, 7)[..., 3:])


def _third_rows(quaternion: Floats) -> Floats:
    """Third rows of the rotations of quaternions w x y z (..., 4): the world's up in the turned frame, (..., 3)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)

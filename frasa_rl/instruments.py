"""What a laboratory would measure on a robot that the robot itself does not read: forces and speeds of every step."""

from dataclasses import dataclass

import mujoco
import numpy as np

from frasa_rl.config import Names
from frasa_rl.robot import Floats, Robot
from frasa_rl.simulation import Simulation

_FLOOR, _TORQUE = "frasa_floor_contact", "frasa_torque_{}"


@dataclass(frozen=True)
class Measure:
    """One number about the strain of a trial.

    Attributes:
        name: in tables and JSON.
        unit: of it.
        meaning: in words.
    """

    name: str
    unit: str
    meaning: str


MEASURES = (
    Measure("peak_torque", "N m", "largest torque of any servo at any instant"),
    Measure("peak_speed", "rad/s", "largest speed of any joint at any instant"),
    Measure("peak_floor_force", "N", "largest net force between robot and floor"),
    Measure("self_contact", "N s", "forces between parts of the robot, summed over contacts and time"),
    Measure("shaking", "rad/s", "mean speed of the joints at the end, while the pose is held"),
)


def add_instruments(spec: mujoco.MjSpec, names: Names) -> None:
    """A torque sensor for every actuator and a force sensor between robot and floor, after all other sensors."""
    for index, actuator in enumerate(spec.actuators):
        spec.add_sensor(
            name=_TORQUE.format(index), type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
            objtype=mujoco.mjtObj.mjOBJ_ACTUATOR, objname=actuator.name,
        )  # fmt: skip
    if spec.body(names.trunk) is None or spec.geom(names.floor) is None:
        return  # said with all that is missing by `find_robot`
    spec.add_sensor(
        name=_FLOOR, type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=names.floor,
        reftype=mujoco.mjtObj.mjOBJ_XBODY, refname=names.trunk,
        intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],  # 3: net force
    )  # fmt: skip


class Instruments:
    """Reads them.

    Args:
        model: made with `add_instruments`.
        robot: where things are.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self._torques = np.array([int(model.sensor(_TORQUE.format(i)).adr[0]) for i in range(model.nu)])
        start = int(model.sensor(_FLOOR).adr[0])
        self._floor, self._self = slice(start, start + 3), robot.self_contact
        moved = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        self._speeds = model.jnt_dofadr[model.actuator_trnid[moved, 0]]

    def read(self, sim: Simulation) -> Floats:
        """The measures of `MEASURES` over the last `advance`, shape (count, 5): peaks, then a sum, then a mean."""
        seen = sim.sensor_path
        speeds = sim.path[:, :, 1 + sim.nq + self._speeds]
        inner = seen[:, :, self._self].reshape(*seen.shape[:2], -1, 3)
        return np.stack(
            [
                np.abs(seen[:, :, self._torques]).max(axis=(1, 2)),
                np.abs(speeds).max(axis=(1, 2)),
                np.linalg.norm(seen[:, :, self._floor], axis=2).max(axis=1),
                np.linalg.norm(inner, axis=3).sum(axis=(1, 2)) * sim.timestep,
                np.abs(speeds).mean(axis=(1, 2)),
            ],
            axis=1,
        )


def over_time(periods: Floats, held: int) -> Floats:
    """The measures of a whole trial from those of its periods.

    Args:
        periods: shape (periods, 5).
        held: how many of the last ones the pose was held in.

    Returns:
        Shape (5,).
    """
    if not len(periods):
        return np.zeros(len(MEASURES))
    return np.array([*periods[:, :3].max(axis=0), periods[:, 3].sum(), periods[-held:, 4].mean()])

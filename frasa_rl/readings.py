"""What is true of every robot at an instant, and what it reads: arrays for n joints, both from the same state."""

from dataclasses import dataclass

import numpy as np

from frasa_rl.robot import Floats, Robot, Sensors, pitch_of
from frasa_rl.simulation import Simulation, young


@dataclass(frozen=True)
class Truth:
    """The state of the robots now.

    Attributes:
        positions: of the moved joints on both sides [rad], shape (count, n, 2).
        velocities: [rad/s], shape (count, n, 2).
        quaternion: of the trunk, w x y z, shape (count, 4).
        turning: angular rate of the trunk in its own axes [rad/s], shape (count, 3).
        contact: sum of the forces between parts of a robot [N], one physics step old, shape (count,).
        height: of the trunk in the world [m], shape (count,).
        support: what these sensors say (`support`), one physics step old, shape (count, 3 + 7 feet); no columns where
            the task does not ask.
    """

    positions: Floats
    velocities: Floats
    quaternion: Floats
    turning: Floats
    contact: Floats
    height: Floats
    support: Floats

    @property
    def pitch(self) -> Floats:
        """Of the trunk, forward positive [rad], shape (count,)."""
        return pitch_of(self.quaternion)


@dataclass(frozen=True)
class Readings:
    """What the robots measure, delayed as their sensors are; shapes as in `Truth`, pitch and its rate (count,)."""

    positions: Floats
    velocities: Floats
    pitch: Floats
    pitch_rate: Floats


def truth(robot: Robot, sim: Simulation) -> Truth:
    """Read the present state."""
    root, free = robot.root_qpos + 3, robot.root_dof + 3
    forces = sim.sensors[:, robot.self_contact].reshape(sim.count, -1, 3)
    return Truth(
        positions=sim.qpos[:, robot.qpos],
        velocities=sim.qvel[:, robot.dofs],
        quaternion=sim.qpos[:, root : root + 4].copy(),
        turning=sim.qvel[:, free : free + 3].copy(),
        contact=np.linalg.norm(forces, axis=2).sum(axis=1),
        height=sim.qpos[:, robot.root_qpos + 2].copy(),
        support=sim.sensors[:, robot.support or slice(0)].copy(),
    )


def read(robot: Robot, sim: Simulation, now: Truth, ages: Floats) -> Readings:
    """What the sensors say.

    Args:
        robot: where they are.
        sim: after a step of models made `fresh`.
        now: the truth.
        ages: delay of every sensor [s], shape (count, nsensor).
    """
    shares = _shares(ages, sim.timestep)
    orientation = _trunk(robot.orientation, sim, now.quaternion, shares)
    turning = _trunk(robot.gyro, sim, now.turning, shares)
    return Readings(
        positions=_joints(robot.position, sim, now.positions, shares),
        velocities=_joints(robot.velocity, sim, now.velocities, shares),
        pitch=pitch_of(orientation),
        pitch_rate=turning[:, 1].copy(),
    )


def _shares(ages: Floats, timestep: float) -> tuple[Floats, Floats]:
    """Shares of what is now and of what was two steps ago, between which and a step ago a young reading lies."""
    steps = ages / timestep
    return np.clip(1.0 - steps, 0.0, 1.0), np.where(young(ages, timestep), np.clip(steps - 1.0, 0.0, 1.0), 0.0)


def _trunk(sensors: Sensors, sim: Simulation, now: Floats, shares: tuple[Floats, Floats]) -> Floats:
    """A reading of the trunk, interpolated as MuJoCo does: number by number, a quaternion too."""
    if not sensors:
        return now
    start = int(sensors.start[0])
    columns, index = slice(start, start + now.shape[1]), int(sensors.ids[0])
    near, far = (share[:, index, None] for share in shares)
    old, older = sim.sensors[:, columns], sim.older[:, columns]
    return np.asarray(old + near * (now - old) + far * (older - old))


def _joints(sensors: Sensors, sim: Simulation, now: Floats, shares: tuple[Floats, Floats]) -> Floats:
    if not sensors:
        return now
    near, far = (share[:, sensors.ids] for share in shares)
    old, older = sim.sensors[:, sensors.start], sim.older[:, sensors.start]
    return np.asarray(old + near * (now - old) + far * (older - old))

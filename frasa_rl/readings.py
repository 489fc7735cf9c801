"""What is true of every robot at an instant, and what it reads: arrays for n joints, both from the same state."""

from dataclasses import dataclass

import numpy as np

from frasa_rl.robot import Floats, Robot, Sensors, pitch_of
from frasa_rl.simulation import Simulation


@dataclass(frozen=True)
class Truth:
    """The state of the robots now.

    Attributes:
        positions: of the moved joints on both sides [rad], shape (count, n, 2).
        velocities: [rad/s], shape (count, n, 2).
        quaternion: of the trunk, w x y z, shape (count, 4).
        turning: angular rate of the trunk in its own axes [rad/s], shape (count, 3).
        contact: sum of the forces between parts of a robot [N], one physics step old, shape (count,).
    """

    positions: Floats
    velocities: Floats
    quaternion: Floats
    turning: Floats
    contact: Floats

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
    )


def read(robot: Robot, sim: Simulation, now: Truth, ages: Floats) -> Readings:
    """What the sensors say.

    Args:
        robot: where they are.
        sim: after a step of models made `fresh`.
        now: the truth.
        ages: delay of every sensor [s], shape (count, nsensor).
    """
    share = np.clip(1.0 - ages / sim.timestep, 0.0, 1.0)  # of the present in a reading younger than a step
    orientation = _trunk(robot.orientation, sim, 4)
    turning = _trunk(robot.gyro, sim, 3)
    pitch = now.pitch if orientation is None else _mix(pitch_of(orientation), now.pitch, share, robot.orientation)
    rate = now.turning[:, 1] if turning is None else _mix(turning[:, 1], now.turning[:, 1], share, robot.gyro)
    return Readings(
        positions=_joints(robot.position, sim, now.positions, share),
        velocities=_joints(robot.velocity, sim, now.velocities, share),
        pitch=pitch,
        pitch_rate=rate,
    )


def _trunk(sensors: Sensors, sim: Simulation, size: int) -> Floats | None:
    if not sensors:
        return None
    start = int(sensors.start[0])
    return sim.sensors[:, start : start + size]


def _mix(old: Floats, now: Floats, share: Floats, sensors: Sensors) -> Floats:
    young = share[:, int(sensors.ids[0])]
    return np.asarray(old + young * (now - old))


def _joints(sensors: Sensors, sim: Simulation, now: Floats, share: Floats) -> Floats:
    if not sensors:
        return now
    old = sim.sensors[:, sensors.start]
    return np.asarray(old + share[:, sensors.ids] * (now - old))

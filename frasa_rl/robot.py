"""Where the task's joints, sensors and bodies are in a compiled model; every name is resolved once, here."""

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_rl.config import Task
from frasa_sysid.calibration import ModelError

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

TRUNK = "trunk"
FLOOR = "floor"


@dataclass(frozen=True)
class Robot:
    """Indices into a model, for n joints on two sides (left, right).

    Attributes:
        actuators: shape (n, 2).
        qpos: addresses of joint positions, shape (n, 2).
        position, velocity: addresses in `sensordata` of what the robot measures, shape (n, 2).
        mirror: sign of the right side, shape (n, 2), ones on the left.
        limits: control range both sides share, seen from the left, shape (n, 2).
        held: command of every actuator that the policy does not move [rad], shape (nu,).
        orientation, measured_orientation: trunk quaternion, true and delayed, shape (4,).
        gyro, measured_gyro: trunk angular rate, true and delayed, shape (3,).
        self_contact: forces between parts of the robot, shape (3 k,).
        trunk, floor: body and geom.
        substeps: physics steps in a control period.
    """

    actuators: Indices
    qpos: Indices
    position: Indices
    velocity: Indices
    mirror: Floats
    limits: Floats
    held: Floats
    orientation: slice
    measured_orientation: slice
    gyro: slice
    measured_gyro: slice
    self_contact: slice
    trunk: int
    floor: int
    substeps: int

    def both_sides(self, joint_values: Floats) -> Floats:
        """Commands for actuators from the left-side values (n,): shape (n, 2)."""
        return joint_values[:, None] * self.mirror

    def mean_of_sides(self, values: Floats) -> Floats:
        """One number a joint from the two sides (n, 2), mirrored: shape (n,)."""
        mean: Floats = np.mean(values * self.mirror, axis=1)
        return mean


def find_robot(model: mujoco.MjModel, task: Task) -> Robot:
    """Resolve every name the task needs.

    Raises:
        ModelError: some are missing (all are listed, with what the model has), or the
            time step does not divide the control period.
    """
    pairs = [(f"left_{one.name}", f"right_{one.name}") for one in task.joints]
    sides = [name for pair in pairs for name in pair]
    held = [name for name, _ in task.held_deg]
    sensors = ["orientation", "measured_orientation", "gyro", "measured_gyro", "self_contact"]
    measured = [f"{name}.{what}" for name in sides for what in ("position", "velocity")]
    _require(model, "joint", sides)
    _require(model, "actuator", [*sides, *held])
    _require(model, "sensor", [*sensors, *measured])
    _require(model, "body", [TRUNK])
    _require(model, "geom", [FLOOR])

    actuators = np.array([[model.actuator(name).id for name in pair] for pair in pairs])
    mirror = np.array([[1.0, one.mirror] for one in task.joints])
    ranges = model.actuator_ctrlrange[actuators] * mirror[:, :, None]
    ranges.sort(axis=2)
    commands = np.zeros(model.nu)
    for name, angle in task.held_deg:
        commands[model.actuator(name).id] = np.radians(angle)
    return Robot(
        actuators=actuators,
        qpos=np.array([[model.joint(name).qposadr[0] for name in pair] for pair in pairs]),
        position=np.array([[_sensor(model, f"{name}.position").start for name in pair] for pair in pairs]),
        velocity=np.array([[_sensor(model, f"{name}.velocity").start for name in pair] for pair in pairs]),
        mirror=mirror,
        limits=np.stack([ranges[:, :, 0].max(axis=1), ranges[:, :, 1].min(axis=1)], axis=1),
        held=commands,
        orientation=_sensor(model, "orientation"),
        measured_orientation=_sensor(model, "measured_orientation"),
        gyro=_sensor(model, "gyro"),
        measured_gyro=_sensor(model, "measured_gyro"),
        self_contact=_sensor(model, "self_contact"),
        trunk=int(model.body(TRUNK).id),
        floor=int(model.geom(FLOOR).id),
        substeps=_substeps(model.opt.timestep, task.control_period_s),
    )


def pitch_of(quaternion: Floats) -> float:
    """Trunk pitch [rad], forward positive, of a quaternion w x y z, shape (4,): atan2(-R[2, 0], R[2, 2])."""
    w, x, y, z = quaternion
    return float(np.arctan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y)))


def _require(model: mujoco.MjModel, kind: str, names: Iterable[str]) -> None:
    count = {"joint": "njnt", "actuator": "nu", "sensor": "nsensor", "body": "nbody", "geom": "ngeom"}[kind]
    present = [getattr(model, kind)(i).name for i in range(getattr(model, count))]
    missing = [name for name in names if name not in present]
    if missing:
        known = ", ".join(name for name in present if name) or "none with a name"
        raise ModelError(f"the model lacks {kind} {', '.join(missing)}; it has {known}")


def _sensor(model: mujoco.MjModel, name: str) -> slice:
    index = model.sensor(name).id
    start = int(model.sensor_adr[index])
    return slice(start, start + int(model.sensor_dim[index]))


def _substeps(timestep: float, period: float) -> int:
    count = round(period / timestep)
    if count < 1 or abs(count * timestep - period) > 1e-9:
        raise ModelError(
            f"the model's time step of {timestep * 1e3:g} ms does not divide the control period of {period * 1e3:g} ms"
        )
    return count

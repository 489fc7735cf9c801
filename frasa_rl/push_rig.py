"""The paper's pendulum as a body of the scene: hung, placed so that it just touches the robot, released, pulled back.

FRASA (arXiv 2410.08655) hits the robot's trunk with 0.9 kg on 1.28 m, hung at 1.74 m, at 4.0, 5.5 and 7.3 J.

The motor is an equality constraint of the hinge, not an actuator: switched on it draws the pendulum to its release
angle and keeps it there, switched off it is not there at all (no friction, no inertia). So the robot's actuators,
commands and randomization know nothing of the rig. The switch and the place are fields of each trial's own model.
"""

from math import cos, degrees, sin
from typing import Literal

import mujoco
import numpy as np

from frasa_rl.config import PushRig
from frasa_rl.robot import Floats, Robot
from frasa_rl.simulation import FULL
from frasa_sysid.calibration import ModelError

Direction = Literal["front", "back"]
DIRECTIONS: tuple[Direction, ...] = ("front", "back")

_STAND, _PENDULUM, _HINGE, _BOB, _MOTOR = "push_stand", "push_pendulum", "push_hinge", "push_bob", "push_motor"
TOUCH = "push_touch"  # contact sensor: force between bob and robot [N], 3 numbers
_PARKED = (0.0, -30.0)  # x, y of the stand until it is placed [m]: nowhere near a robot
_FAR = 1.5  # the bob is brought up to the robot from this far in front of its trunk [m]
_CLOSE = 1e-5  # gap at which it touches [m]


def add_rig(spec: mujoco.MjSpec, rig: PushRig, trunk: str) -> None:
    """Hang the pendulum out of reach, after everything else, so that no index of the robot changes.

    Args:
        spec: of the robot on its floor.
        rig: sizes.
        trunk: body of the robot; a contact sensor `TOUCH` reports what the bob does to it and all its parts.
    """
    highest = max((int(geom.priority) for geom in spec.geoms), default=0)
    stand = spec.worldbody.add_body(name=_STAND, pos=(*_PARKED, rig.height))
    _add_decor(stand, rig)
    bob = stand.add_body(name=_PENDULUM)
    bob.explicitinertial = True
    bob.mass, bob.ipos = rig.mass, (0.0, 0.0, -rig.length)
    bob.inertia = (0.4 * rig.mass * rig.radius**2,) * 3
    bob.add_joint(
        name=_HINGE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 1, 0), limited=False,
        damping=0.0, frictionloss=0.0, armature=0.0, stiffness=0.0,
    )  # fmt: skip
    bob.add_geom(
        name=_BOB, type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=(0, 0, -rig.length), size=(rig.radius, 0, 0), mass=rig.mass,
        rgba=(0.75, 0.15, 0.12, 1), contype=1, conaffinity=1, condim=3, priority=highest + 1, margin=0.0, gap=0.0,
        friction=(rig.friction, 0.005, 0.0001), solref=(rig.contact_s, 1.0), solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    )  # fmt: skip
    motor = spec.add_equality(name=_MOTOR, type=mujoco.mjtEq.mjEQ_JOINT, name1=_HINGE, active=True)
    motor.solref, motor.solimp = (rig.retrieve_s, 1.0), (0.98, 0.99, 0.001, 0.5, 2.0)
    spec.add_exclude(bodyname1="world", bodyname2=_PENDULUM)
    if spec.body(trunk) is None:
        return  # said with all that is missing by `find_robot`
    spec.add_sensor(
        name=TOUCH, type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=_BOB, reftype=mujoco.mjtObj.mjOBJ_XBODY, refname=trunk,
        intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],  # 3: net force
    )  # fmt: skip


def _add_decor(stand: mujoco.MjsBody, rig: PushRig) -> None:
    """What a picture shows of the stand: a beam on two posts beside the robot's way. It touches nothing."""
    half = 0.45
    corners = [((0, -half, 0), (0, half, 0)), *(((0, y, 0), (0, y, -rig.height)) for y in (-half, half))]
    for start, end in corners:
        stand.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(*start, *end), size=(0.012, 0, 0), mass=0.0,
            contype=0, conaffinity=0, rgba=(0.45, 0.47, 0.5, 1),
        )  # fmt: skip


class Rig:
    """Where the rig is in compiled models, and what is done with it in one of them.

    Attributes:
        touch: of the contact force in `sensordata`, 3 numbers.
        angle, rate: of the hinge in a physics state.

    Args:
        model: made with `add_rig`; its bob is made to collide with whatever the robot collides with.
        robot: where things are.
        rig: sizes.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, rig: PushRig) -> None:
        if abs(model.opt.gravity[2] + rig.gravity) > 1e-6 or np.abs(model.opt.gravity[:2]).max() > 1e-6:
            raise ModelError(f"the model's gravity is {model.opt.gravity}, that of the task's rig {rig.gravity} down")
        self._rig, self._robot = rig, robot
        self._stand, self._bob = model.body(_STAND).id, model.geom(_BOB).id
        self._motor, self._pendulum = model.equality(_MOTOR).id, model.body(_PENDULUM).id
        joint = model.joint(_HINGE)
        self.angle, self.rate = 1 + int(joint.qposadr[0]), 1 + model.nq + int(joint.dofadr[0])
        start = int(model.sensor(TOUCH).adr[0])
        self.touch = slice(start, start + 3)
        own = model.body_rootid[model.geom_bodyid] == robot.trunk
        self._targets = np.flatnonzero(own & ((model.geom_contype | model.geom_conaffinity) != 0))
        self._collide(model)

    def _collide(self, model: mujoco.MjModel) -> None:
        """The robot's collision bits may be anyone's choice: answer all of them."""
        types = int(np.bitwise_or.reduce(model.geom_conaffinity[self._targets], initial=0))
        answers = int(np.bitwise_or.reduce(model.geom_contype[self._targets], initial=0))
        model.geom_contype[self._bob] = model.body_contype[self._pendulum] = types
        model.geom_conaffinity[self._bob] = model.body_conaffinity[self._pendulum] = answers

    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, state: Floats, direction: Direction, energy_j: float
    ) -> Floats:
        """Set up the stand before a robot that stands, and let the pendulum go.

        Hanging still, the bob would just touch the robot: it arrives with its full energy.

        Args:
            model: of this trial alone; written to.
            data: to compute with.
            state: full physics state of the trial, shape (ns,).
            direction: `front` comes from where the robot looks to.
            energy_j: at the lowest point [J].

        Returns:
            The state with the pendulum at its release angle, at rest, shape (ns,).

        Raises:
            ModelError: nothing of the robot is where the bob passes.
        """
        mujoco.mj_setState(model, data, state, FULL)
        mujoco.mj_kinematics(model, data)
        forward = data.xmat[self._robot.trunk].reshape(3, 3)[:2, 0]
        yaw = float(np.arctan2(forward[1], forward[0]))
        sign = 1.0 if direction == "front" else -1.0
        towards = -sign * np.array([cos(yaw), sin(yaw), 0.0])  # the bob's way
        floor = float(data.geom_xpos[self._robot.floor, 2])
        hanging = data.xpos[self._robot.trunk] - _FAR * towards
        hanging[2] = floor + self._rig.height - self._rig.length
        hanging += self._way_to_touch(model, data, hanging, towards) * towards
        model.body_pos[self._stand] = (hanging[0], hanging[1], floor + self._rig.height)
        model.body_quat[self._stand] = (cos(yaw / 2), 0.0, 0.0, sin(yaw / 2))
        release = -sign * self._rig.release_angle(energy_j)
        model.eq_data[self._motor, 0] = release
        model.eq_active0[self._motor] = 0
        placed = state.copy()
        placed[self.angle], placed[self.rate] = release, 0.0
        return placed

    def _way_to_touch(self, model: mujoco.MjModel, data: mujoco.MjData, start: Floats, towards: Floats) -> float:
        """How far the bob moves from `start` until it touches the robot [m].

        Each step goes as far as the nearest surface in any direction is, so none goes too far.
        """
        way = 0.0
        while way < 2.0 * _FAR:
            data.geom_xpos[self._bob] = start + way * towards
            gap = min(
                mujoco.mj_geomDistance(model, data, self._bob, int(one), 2.0 * _FAR, None) for one in self._targets
            )
            if gap < _CLOSE:
                return way
            way += gap
        raise ModelError(
            f"the pendulum, whose bob hangs {self._rig.height - self._rig.length:.2f} m above the floor, passes the "
            "robot without touching it: give the task file's rig another height or length"
        )

    def retrieve(self, model: mujoco.MjModel) -> None:
        """Switch the motor on: it pulls the pendulum back to where it was released, and keeps it."""
        model.eq_active0[self._motor] = 1

    def describe(self, energy_j: float) -> str:
        """For people."""
        angle = degrees(self._rig.release_angle(energy_j))
        return f"{self._rig.mass:g} kg on {self._rig.length:g} m, released at {angle:.0f} deg: {energy_j:g} J"

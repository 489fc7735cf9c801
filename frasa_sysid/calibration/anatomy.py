"""What a humanoid's joints are, found in its model: sides, mirrored pairs, what each turns about, legs and feet.

No name is looked at. The trunk is the body with the free joint; its axes are x forward, y left, z up. Two joints are a
pair if one's anchor and axis are the other's, seen in a mirror between left and right.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.errors import ModelError

Floats = npt.NDArray[np.float64]
MIDLINE = 0.008  # [m] from it at most an anchor counts as on it
APART = 0.02  # [m] that anchors of a pair may differ from mirror images, for parts screwed on a little differently
PARALLEL = 0.97  # cosine of axes that are one
SAME_HEIGHT = 0.01  # [m] above the lowest point within which bodies count as feet
TURNS = ("roll", "pitch", "yaw")  # about the trunk's x, y, z
SLANTED = 0.8  # cosine to the nearest of these axes below which a joint turns about none


@dataclass(frozen=True)
class Hinge:
    """A joint with a servo.

    Attributes:
        name: of the joint.
        actuator: index of its actuator.
        joint: index of it.
        side: `left`, `right` or `middle`.
        axis: in the trunk's frame, joints at the model's own zero, shape (3,).
        anchor: likewise [m].
        turns: `roll`, `pitch`, `yaw`, or `slanted`.
        partner: name of its mirror image; None on the midline, or without one.
        mirror: 1 where the same number on both sides is the symmetric pose, else -1.
        carries: share of the robot's mass beyond it.
    """

    name: str
    actuator: int
    joint: int
    side: str
    axis: Floats
    anchor: Floats
    turns: str
    partner: str | None = None
    mirror: int = 1
    carries: float = 0.0


@dataclass(frozen=True)
class Leg:
    """Joints of one leg, from the hip down, by what they turn about; those it lacks are None.

    Attributes:
        side: `left` or `right`.
        foot: index of the body it stands on.
        hip_pitch, knee, ankle_pitch, hip_roll, ankle_roll: names of joints.
    """

    side: str
    foot: int
    hip_pitch: str
    knee: str
    ankle_pitch: str
    hip_roll: str | None = None
    ankle_roll: str | None = None


def trunk_body(model: mujoco.MjModel) -> int:
    """The body that can move freely.

    Raises:
        ModelError: there is none, or several.
    """
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if free.size != 1:
        found = ", ".join(model.body(int(model.jnt_bodyid[i])).name or "one without a name" for i in free) or "none"
        raise ModelError(f"expected one body with a free joint, the trunk; found {found}")
    return int(model.jnt_bodyid[free[0]])


def hinges(model: mujoco.MjModel, trunk: int) -> tuple[Hinge, ...]:
    """All hinges of the robot that an actuator turns, in the order of its joints, with their mirror images."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn, place = data.xmat[trunk].reshape(3, 3), data.xpos[trunk]
    total = float(model.body_subtreemass[trunk])
    found = []
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        turned = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        if not turned or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        axis, anchor = turn.T @ data.xaxis[joint], turn.T @ (data.xanchor[joint] - place)
        nearest = int(np.argmax(np.abs(axis)))
        side = "middle" if abs(anchor[1]) <= MIDLINE else "left" if anchor[1] > 0.0 else "right"
        turns = TURNS[nearest] if abs(axis[nearest]) >= SLANTED else "slanted"
        carries = float(model.body_subtreemass[model.jnt_bodyid[joint]]) / total
        name = model.joint(joint).name
        found.append(Hinge(name, actuator, joint, side, axis, anchor, turns, carries=carries))
    found.sort(key=lambda one: one.joint)
    return tuple(_paired(one, found) for one in found)


def _paired(one: Hinge, every: Sequence[Hinge]) -> Hinge:
    if one.side == "middle":
        return one
    best, nearest = None, APART
    for other in every:
        # Rotations see a mirror as other vectors do not: of an axis the part across the mirror stays.
        image = other.axis * (-1.0, 1.0, -1.0)
        apart = float(np.linalg.norm(one.anchor - other.anchor * (1.0, -1.0, 1.0)))
        if {one.side, other.side} == {"left", "right"} and apart < nearest and abs(one.axis @ image) > PARALLEL:
            best, nearest = other, apart
    if best is None:
        return one
    mirror = 1 if float(one.axis @ (best.axis * (-1.0, 1.0, -1.0))) > 0.0 else -1
    return Hinge(
        one.name, one.actuator, one.joint, one.side, one.axis, one.anchor, one.turns, best.name, mirror, one.carries
    )


def lowest_points(model: mujoco.MjModel, data: mujoco.MjData, trunk: int) -> dict[int, float]:
    """Height of the lowest point of what collides of each body of the robot [m], by body; boxes around the geoms."""
    own = (model.body_rootid[model.geom_bodyid] == trunk) & ((model.geom_contype > 0) | (model.geom_conaffinity > 0))
    geoms = np.flatnonzero(own)
    up = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
    centre, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    bottoms = data.geom_xpos[geoms, 2] + np.sum(up * centre - np.abs(up) * half, axis=1)
    found: dict[int, float] = {}
    for geom, height in zip(geoms, bottoms, strict=True):
        body = int(model.geom_bodyid[geom])
        found[body] = min(float(height), found.get(body, np.inf))
    return found


def legs(model: mujoco.MjModel, trunk: int, qpos: Floats | None = None) -> tuple[Leg, ...]:
    """The legs of a robot that stands upright in a pose; none where two are not found.

    Args:
        model: of the robot.
        trunk: its root body.
        qpos: the pose; by default the model's own zero.
    """
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    heights = lowest_points(model, data, trunk)
    if not heights:
        return ()
    low = [body for body, height in heights.items() if height < min(heights.values()) + SAME_HEIGHT]
    feet = np.unique(model.body_weldid[low])  # parts screwed to a foot are the foot
    by_body = {int(model.jnt_bodyid[one.joint]): one for one in hinges(model, trunk)}
    found = [one for foot in feet if (one := _leg(model, trunk, int(foot), by_body)) is not None]
    sides = [one.side for one in found]
    return tuple(found) if sorted(sides) == ["left", "right"] else ()


def _leg(model: mujoco.MjModel, trunk: int, foot: int, by_body: dict[int, Hinge]) -> Leg | None:
    chain, body = [], foot
    while body not in (trunk, 0):
        if body in by_body:
            chain.append(by_body[body])
        body = int(model.body_parentid[body])
    pitch = [one for one in chain if one.turns == "pitch" and one.side != "middle"]
    roll = [one for one in chain if one.turns == "roll" and one.side != "middle"]
    if len(pitch) != 3:
        return None
    ankle, knee, hip = pitch
    below = [one for one in roll if chain.index(one) < chain.index(knee)]
    above = [one for one in roll if chain.index(one) > chain.index(knee)]
    return Leg(
        hip.side, foot, hip.name, knee.name, ankle.name,
        above[-1].name if above else None, below[0].name if below else None,
    )  # fmt: skip

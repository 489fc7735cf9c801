"""A pose that a foreign humanoid stands in: looked for among its keyframes, crouches and its zero, and tried out."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from frasa_rl.own_look import Looked
from frasa_rl.robot import Floats, pitch_of
from frasa_sysid.calibration import ModelError, hold_history
from frasa_sysid.calibration.anatomy import Leg, legs, lowest_points

SECONDS = 3.0  # [s] that a pose is tried for
UPRIGHT = np.radians(20.0)  # [rad] most that it may lean in the end, and ...
SINKS = 0.15  # ... share of its height that it may lose
STILL = 0.2  # [rad/s, m/s] most that anything moves then
_CROUCHES = (40.0, 30.0, 20.0, 10.0)  # [deg] of each hip; the knee has twice as much
_LEANS = (0.0, 5.0, 10.0, 15.0, 20.0, -5.0, -10.0)  # [deg] of the trunk
_ENOUGH = 0.85  # of the widest margin: a deeper crouch, which is tried first, is worth the rest
_KEYFRAME = "keyframe"
_STANDING = ("stand", "standing", "neutral", "home", "init", "default")  # names of keyframes, the likeliest first


@dataclass(frozen=True)
class Stance:
    """A pose the robot stands in.

    Attributes:
        origin: where it is from, in words.
        commands: of all actuators [rad], shape (nu,).
        qpos: with every joint where it is told to be, on the floor, shape (nq,).
        pitch: of the trunk then, forward positive [rad].
        height: of the robot once it has come to rest [m].
        margin: how far the centre of mass is inside of what the feet touch, to the front or to the back [m], the less.
        sag: largest distance of a joint from its command [rad], and whose it is.
        legs: the robot's.
    """

    origin: str
    commands: Floats
    qpos: Floats
    pitch: float
    height: float
    margin: float
    sag: tuple[float, str]
    legs: tuple[Leg, ...]


def find_stance(looked: Looked) -> Stance:
    """The first keyframe that the robot keeps for some seconds; without one a deep crouch, hard to tip.

    Raises:
        ModelError: none of those tried.
    """
    tried, stood = [], []
    for origin, commands, pitch in _candidates(looked):
        found = _try(looked, origin, commands, pitch)
        if isinstance(found, str):
            tried.append(f"{origin}: {found}")
        elif origin.startswith(_KEYFRAME):
            return found
        else:
            stood.append(found)
    if stood:
        enough = _ENOUGH * max(one.margin for one in stood)
        return next(one for one in stood if one.margin >= enough)
    said = "; ".join([*dict.fromkeys(tried)][:4])
    raise ModelError(
        f"{looked.path}: no pose was found that the robot stands in ({said}); add a <keyframe> named 'stand' with qpos "
        "and ctrl, feet flat on the floor"
    )


def _candidates(looked: Looked) -> Iterator[tuple[str, Floats, float]]:
    """Words, commands and pitch of poses to try."""
    model = looked.model
    names = [model.key(i).name for i in range(model.nkey)]
    order = sorted(
        range(model.nkey), key=lambda i: next((k for k, n in enumerate(_STANDING) if n in names[i].lower()), 9)
    )
    for i in order:
        qpos = np.array(model.key_qpos[i])
        commands = np.array(model.key_ctrl[i])
        if not commands.any():
            commands = _angles(looked, qpos)
        start = int(model.jnt_qposadr[model.body_jntadr[looked.trunk]])
        yield f"{_KEYFRAME} '{names[i] or i}'", _within(looked, commands), float(pitch_of(qpos[start + 3 : start + 7]))
    zero = _within(looked, np.zeros(model.nu))
    walking = legs(model, looked.trunk)
    if walking:
        for crouch in _CROUCHES:
            for lean in _LEANS:
                pose = _crouched(looked, zero, walking, np.radians(crouch), np.radians(lean))
                if pose is not None:
                    words = f", leaning by {lean:g} deg" if lean else ""
                    yield f"a crouch of {2 * crouch:g} deg at the knees{words}", pose, np.radians(lean)
    yield "all joints at 0", zero, 0.0


def _angles(looked: Looked, qpos: Floats) -> Floats:
    return np.array([qpos[looked.model.jnt_qposadr[j]] for j in looked.model.actuator_trnid[:, 0]])


def _within(looked: Looked, commands: Floats) -> Floats:
    limits = np.zeros((looked.model.nu, 2))
    for one in looked.hinges:
        limits[one.actuator] = looked.limits[one.name]
    return np.clip(commands, limits[:, 0], limits[:, 1])


def _crouched(looked: Looked, zero: Floats, walking: tuple[Leg, ...], hip: float, lean: float) -> Floats | None:
    """Thigh forward, knee twice as much back, foot flat below the trunk; None where a joint cannot go there."""
    pose = zero.copy()
    for leg in walking:
        for name, angle in ((leg.hip_pitch, -hip - lean), (leg.knee, 2.0 * hip), (leg.ankle_pitch, -hip)):
            one = looked.hinge(name)
            command = angle * np.sign(one.axis[1])
            low, high = looked.limits[name]
            if not low <= command <= high:
                return None
            pose[one.actuator] = command
    return pose


def _try(looked: Looked, origin: str, commands: Floats, pitch: float) -> Stance | str:
    """The pose after some seconds, or in words why it is none."""
    model = looked.model
    data = mujoco.MjData(model)
    place = int(model.jnt_qposadr[model.body_jntadr[looked.trunk]])
    data.ctrl[:] = commands
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = commands
    data.qpos[place : place + 7] = (0.0, 0.0, 1.0, np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0)
    mujoco.mj_kinematics(model, data)
    floor = float(data.geom_xpos[looked.floor, 2])
    data.qpos[place + 2] += floor - min(lowest_points(model, data, looked.trunk).values()) + 1e-3
    placed = np.array(data.qpos)
    hold_history(model, data)
    before = _height(looked, data)
    steps = int(SECONDS / model.opt.timestep)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all():
            return "the simulation blew up"
        up = 1.0 - 2.0 * (data.qpos[place + 4] ** 2 + data.qpos[place + 5] ** 2)
        if up < np.cos(np.radians(45.0)):
            return f"it falls after {step * model.opt.timestep:.1f} s"
    if np.arccos(np.clip(up, -1.0, 1.0)) > UPRIGHT:
        return f"it leans by {np.degrees(np.arccos(up)):.0f} deg"
    mujoco.mj_forward(model, data)
    after = _height(looked, data)
    if after < (1.0 - SINKS) * before:
        return f"it sinks from {before:.2f} to {after:.2f} m"
    if np.abs(data.qvel).max() > STILL:
        return "it does not come to rest"
    distances = np.abs(_angles(looked, data.qpos) - commands)
    worst = int(np.argmax(distances))
    whose = model.joint(int(model.actuator_trnid[worst, 0])).name
    sag = (float(distances[worst]), whose)
    margin = _margin(looked, data)
    return Stance(origin, commands, placed, pitch, after, margin, sag, legs(model, looked.trunk, placed))


def _margin(looked: Looked, data: mujoco.MjData) -> float:
    """From the centre of mass to the nearer end, front or back, of where the robot touches the floor [m]."""
    touching = (data.contact.geom == looked.floor).any(axis=1)
    if not touching.any():
        return 0.0
    place = data.contact.pos[touching, 0]
    middle = float(data.subtree_com[looked.trunk, 0])
    return float(min(place.max() - middle, middle - place.min()))


def _height(looked: Looked, data: mujoco.MjData) -> float:
    """Of the highest point above the floor [m]."""
    model = looked.model
    own = (model.body_rootid[model.geom_bodyid] == looked.trunk) & (model.geom_contype + model.geom_conaffinity > 0)
    up = data.geom_xmat[own].reshape(-1, 3, 3)[:, 2]
    centre, half = model.geom_aabb[own, :3], model.geom_aabb[own, 3:]
    tops = data.geom_xpos[own, 2] + np.sum(up * centre + np.abs(up) * half, axis=1)
    return float(tops.max() - data.geom_xpos[looked.floor, 2])

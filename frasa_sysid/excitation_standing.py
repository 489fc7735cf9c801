"""Excitation of a robot on its feet: squats, leans and arm motions that it stands through.

The trunk moves, so the ages of gyro and orientation show, and gravity loads the legs through the ground.
"""

import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.anatomy import Hinge
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import PERIOD, Excitation, joined
from frasa_sysid.robot_body import Joints

FloatArray = npt.NDArray[np.float64]
PURPOSES = {
    "stand": "noise of every channel, gyro bias, joint zeros under the robot's own weight",
    "squats": "gain and friction of the legs under load, trunk mass",
    "nods": "trunk pitch at several speeds: ages of gyro and orientation, centre of mass",
    "sways": "trunk roll likewise, and the roll joints",
    "arms": "gain, damping and friction of arms and head; the trunk answers",
}
SHARES = {"stand": 0.08, "squats": 0.2, "nods": 0.28, "sways": 0.2, "arms": 0.24}
TAPER = 0.6  # [s] in and out of a part
SMALL = 0.2  # share of the mass beyond a joint above which moving it would topple the robot


def design(joints: Joints, seconds: float, seed: int = 0) -> Excitation:
    """The whole excitation.

    Args:
        joints: of the model, with two legs of a hip, a knee and an ankle that pitch each.
        seconds: duration.
        seed: of phases.

    Raises:
        UsageError: the model has no such legs.
    """
    if not joints.legs:
        raise UsageError(
            "--base floating needs two legs that stand on the floor in the keyframe 'neutral', each with a hip, a knee "
            "and an ankle that pitch, which the model has not"
        )
    rng = np.random.default_rng((seed, 11))
    motions = {"stand": _stand, "squats": _squats, "nods": _nods, "sways": _sways, "arms": _arms}
    pieces = []
    for name, share in SHARES.items():
        t: FloatArray = np.asarray(np.arange(max(1, round(share * seconds / PERIOD))) * PERIOD, dtype=np.float64)
        taper = np.clip(np.minimum(t, t[-1] - t) / TAPER, 0.0, 1.0)
        shape = motions[name](joints, t, rng) * (taper**2 * (3.0 - 2.0 * taper))[:, None]
        pieces.append((name, PURPOSES[name], np.clip(stance(joints) + shape, joints.low, joints.high)))
    return joined(joints.names, pieces)


def stance(joints: Joints) -> FloatArray:
    """The neutral pose, feet flat below the hips [rad], shape (n,)."""
    return joints.neutral


def _placed(joints: Joints, t: FloatArray, waves: dict[str, FloatArray]) -> FloatArray:
    """Waves by joint, as turns about the trunk's own axes: a joint mounted the other way round gets minus the wave."""
    shape = np.zeros((t.size, len(joints.names)))
    hinges = {one.name: one for one in joints.hinges}
    for name, wave in waves.items():
        axis = hinges[name].axis
        shape[:, joints.names.index(name)] = wave * np.sign(axis[np.argmax(np.abs(axis))])
    return shape


def _on_legs(joints: Joints, t: FloatArray, waves: dict[str, FloatArray]) -> FloatArray:
    """Waves by what a leg calls a joint, the same on both sides; joints that a leg lacks are left out."""
    each = {getattr(leg, part): wave for leg in joints.legs for part, wave in waves.items() if getattr(leg, part)}
    return _placed(joints, t, each)


def _waves(rng: np.random.Generator, t: FloatArray, lines: tuple[float, ...]) -> FloatArray:
    """Sines of equal speed [Hz] with random phases, scaled to a largest value of 1."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    weights = lines[0] / np.array(lines)
    wave = np.sin(2.0 * np.pi * np.outer(t, lines) + phases) @ weights
    return np.asarray(wave / np.abs(wave).max())


def _stand(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.zeros((t.size, len(joints.names)))


def _squats(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    # Thigh and shank are as long as each other: half of the knee each keeps foot and trunk level.
    knee = 0.30 * np.sin(2.0 * np.pi * 0.35 * t) + 0.08 * np.sin(2.0 * np.pi * 0.9 * t)
    return _on_legs(joints, t, {"knee": knee, "hip_pitch": -knee / 2.0, "ankle_pitch": -knee / 2.0})


def _nods(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    wave = _waves(rng, t, (0.4, 0.9, 1.7, 2.9))
    return _on_legs(joints, t, {"hip_pitch": 0.14 * wave, "ankle_pitch": -0.03 * wave})


def _sways(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    wave = _waves(rng, t, (0.45, 1.0, 1.9))
    # Without ankles that roll a foot would stand on its edge.
    size = 0.10 if all(leg.ankle_roll for leg in joints.legs) else 0.02
    return _on_legs(joints, t, {"hip_roll": size * wave, "ankle_roll": -size * wave})


def _arms(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    waves = {}
    for one, size in _free(joints):
        wave = size * _waves(rng, t, (0.5, 1.1, 2.1) if one.side != "middle" and one.partner else (0.6, 1.3, 2.3))
        if one.turns == "roll":
            # Arms held in move out only.
            i = joints.names.index(one.name)
            middle = np.sign(joints.low[i] + joints.high[i]) * np.sign(one.axis[0]) * size
            wave = middle + wave
        waves[one.name] = wave
    return _placed(joints, t, waves)


def _free(joints: Joints) -> list[tuple[Hinge, float]]:
    """Joints of arms and head, that is light ones of no leg, with how far they move [rad]."""
    legged = {getattr(leg, part) for leg in joints.legs for part in ("hip_pitch", "knee", "ankle_pitch")}
    legged |= {name for leg in joints.legs for name in (leg.hip_roll, leg.ankle_roll) if name}
    light = [one for one in joints.hinges if one.name not in legged and one.carries < SMALL]
    by_name = {one.name: one for one in joints.hinges}
    found = []
    for turns, size in (("pitch", 0.5), ("roll", 0.2)):
        for one in light:
            if one.turns == turns and one.side == "left" and one.partner is not None and not _below(joints, one):
                found += [(one, size), (by_name[one.partner], size)]
    for turns, size in (("yaw", 0.5), ("pitch", 0.25)):
        found += [(one, size) for one in light if one.turns == turns and one.partner is None]
    return found


def _below(joints: Joints, one: Hinge) -> bool:
    """Whether a joint is as low as a leg's: its own part of the leg, whatever it turns about."""
    hips = [hinge.anchor[2] for hinge in joints.hinges if hinge.name in {leg.hip_pitch for leg in joints.legs}]
    return bool(one.anchor[2] <= max(hips))

"""Excitation of a robot on its feet: squats, leans and arm motions that it stands through.

The trunk moves, so the ages of gyro and orientation show, and gravity loads the legs through the ground.
"""

import numpy as np
import numpy.typing as npt

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
LEGS = ("hip_pitch", "knee", "ankle_pitch", "hip_roll", "ankle_roll")


def design(joints: Joints, seconds: float, seed: int = 0) -> Excitation:
    """The whole excitation.

    Args:
        joints: of the model; legs named left_knee and so on.
        seconds: duration.
        seed: of phases.

    Raises:
        UsageError: the model's joints are not named as a humanoid's legs.
    """
    missing = [f"{side}_{name}" for side in ("left", "right") for name in LEGS]
    missing = [name for name in missing if name not in joints.names]
    if missing:
        raise UsageError(f"--base floating needs legs with joints {', '.join(missing)}, which the model has not")
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


def _placed(joints: Joints, t: FloatArray, both: dict[str, FloatArray]) -> FloatArray:
    """Waves by joint name without its side, shape (T, n)."""
    shape = np.zeros((t.size, len(joints.names)))
    for i, name in enumerate(joints.names):
        wave = both.get(name, both.get(name.partition("_")[2]))
        if wave is not None:
            shape[:, i] = wave
    return shape


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
    return _placed(joints, t, {"knee": knee, "hip_pitch": -knee / 2.0, "ankle_pitch": -knee / 2.0})


def _nods(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    wave = _waves(rng, t, (0.4, 0.9, 1.7, 2.9))
    return _placed(joints, t, {"hip_pitch": 0.14 * wave, "ankle_pitch": -0.03 * wave})


def _sways(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    wave = _waves(rng, t, (0.45, 1.0, 1.9))
    return _placed(joints, t, {"hip_roll": 0.10 * wave, "ankle_roll": -0.10 * wave})


def _arms(joints: Joints, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    both = {}
    for name, size in (("shoulder_pitch", 0.5), ("elbow", 0.5), ("shoulder_roll", 0.2)):
        for side in ("left", "right"):
            if f"{side}_{name}" in joints.names:
                i = joints.names.index(f"{side}_{name}")
                # Arms held in move out only.
                middle = np.sign(joints.low[i] + joints.high[i]) * size if name == "shoulder_roll" else 0.0
                both[f"{side}_{name}"] = middle + size * _waves(rng, t, (0.5, 1.1, 2.1))
    for name, size in (("head_yaw", 0.5), ("head_pitch", 0.25)):
        both[name] = size * _waves(rng, t, (0.6, 1.3, 2.3))
    return _placed(joints, t, both)

"""What a file of keyframes says: stand-up routines, the standing command, when a robot has fallen.

Nothing here knows a robot: the joints are named in the file and compared with the task's where it is used.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration import InputError

LONGEST_S = 10.0
LARGEST_DEG = 360.0


class KeyframeError(InputError):
    """A file of keyframes is missing, broken, or made for another robot."""


@dataclass(frozen=True)
class Key:
    """A pose to be commanded.

    Attributes:
        duration_s: from the key before to this one; longer where the joints' rate limit needs it [s].
        angles_deg: command of every joint, seen from the left [deg].
    """

    duration_s: float
    angles_deg: tuple[float, ...]

    def __post_init__(self) -> None:
        _require("duration_s", self.duration_s, 0.0, LONGEST_S)
        for angle in self.angles_deg:
            _require("angles_deg", angle, -LARGEST_DEG, LARGEST_DEG)


@dataclass(frozen=True)
class Routine:
    """How to stand up from one side: the keys, then the standing command.

    Attributes:
        keys: in order; the first is reached from wherever the joints are.
        rise_s: from the last key to the standing command [s].
    """

    keys: tuple[Key, ...]
    rise_s: float

    def __post_init__(self) -> None:
        if not self.keys:
            raise KeyframeError("a routine needs at least one key")
        _require("rise_s", self.rise_s, 0.0, LONGEST_S)


@dataclass(frozen=True)
class Standing:
    """What is commanded while standing: a pose, corrected slowly until the joints are where they should be.

    Servos without an integral term sag under the robot's weight, each robot's a little differently.

    Attributes:
        command_deg: what a robot of the model commands to stand in its pose [deg].
        gain: correction a second, as a share of the joint's error [1/s].
        correction_max_deg: largest correction [deg].
    """

    command_deg: tuple[float, ...]
    gain: float
    correction_max_deg: float

    def __post_init__(self) -> None:
        for angle in self.command_deg:
            _require("command_deg", angle, -LARGEST_DEG, LARGEST_DEG)
        _require("gain", self.gain, 0.0, 10.0)
        _require("correction_max_deg", self.correction_max_deg, 0.0, 45.0)


@dataclass(frozen=True)
class Detector:
    """When a robot counts as fallen, as lying, and as upright again.

    Attributes:
        fallen_deg: an upright robot has fallen beyond this pitch [deg].
        upright_deg: a fallen robot is upright again below this pitch [deg].
        still_rate: pitch rate below which a fallen robot lies [rad/s].
        hold_s: how long it must stay below [s].
    """

    fallen_deg: float = 45.0
    upright_deg: float = 30.0
    still_rate: float = 0.3
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        _require("upright_deg", self.upright_deg, 1.0, 90.0)
        _require("fallen_deg", self.fallen_deg, 1.0, 90.0)
        _require("still_rate", self.still_rate, 1e-3, 10.0)
        _require("hold_s", self.hold_s, 0.0, LONGEST_S)
        if self.upright_deg >= self.fallen_deg:
            raise KeyframeError(f"upright_deg {self.upright_deg:g} is not below fallen_deg {self.fallen_deg:g}")


@dataclass(frozen=True)
class Keyframes:
    """The whole file.

    Attributes:
        joints: names without the side, in the order of every pose.
        prone, supine: the routines.
        standing: what holds the robot up afterwards.
        detector: when to start which.
    """

    joints: tuple[str, ...]
    prone: Routine
    supine: Routine
    standing: Standing
    detector: Detector

    def __post_init__(self) -> None:
        poses = [key.angles_deg for one in (self.prone, self.supine) for key in one.keys]
        for pose in (*poses, self.standing.command_deg):
            if len(pose) != len(self.joints):
                raise KeyframeError(f"a pose has {len(pose)} angles, there are {len(self.joints)} joints")
        if not self.joints or len(set(self.joints)) != len(self.joints):
            raise KeyframeError("joints: expected different names, at least one")


def check_limits(keyframes: Keyframes, limits_deg: npt.NDArray[np.float64]) -> None:
    """Raise when a pose cannot be commanded.

    Args:
        keyframes: with n joints.
        limits_deg: lowest and highest command of each joint [deg], shape (n, 2).

    Raises:
        KeyframeError: an angle is outside (all are listed), or the number of joints differs.
    """
    if len(keyframes.joints) != len(limits_deg):
        raise KeyframeError(f"the keyframes move {len(keyframes.joints)} joints, the task {len(limits_deg)}")
    poses = {
        f"{side} key {i + 1}": key.angles_deg
        for side in ("prone", "supine")
        for i, key in enumerate(getattr(keyframes, side).keys)
    }
    poses["standing"] = keyframes.standing.command_deg
    outside = [
        f"{where} {joint} {angle:g} (limits {low:g} to {high:g})"
        for where, pose in poses.items()
        for joint, angle, (low, high) in zip(keyframes.joints, pose, limits_deg, strict=True)
        if not low - 0.01 <= angle <= high + 0.01  # a file holds hundredths
    ]
    if outside:
        raise KeyframeError(f"outside the command limits [deg]: {', '.join(outside)}")


def _require(name: str, value: float, low: float, high: float) -> None:
    if not (isfinite(value) and low <= value <= high):
        raise KeyframeError(f"{name} is {value:g}: expected {low:g} to {high:g}")

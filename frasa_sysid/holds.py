"""Ways to hold a robot by its trunk while it is recorded, so that gravity turns every joint.

A joint's zero shows only through gravity: upright nothing turns a yaw joint, face down everything hangs across it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import UsageError

FloatArray = npt.NDArray[np.float64]
UPRIGHT = "upright"


@dataclass(frozen=True)
class Hold:
    """One way.

    Attributes:
        roll, pitch: of the trunk [rad], about x, then about the world's y (pitch is positive forward).
        words: what to do, for people.
    """

    roll: float
    pitch: float
    words: str


HOLDS: Mapping[str, Hold] = {
    UPRIGHT: Hold(0.0, 0.0, "trunk upright, feet off the ground"),
    "face-down": Hold(0.0, math.pi / 2, "trunk level, face down, arms and legs hanging free"),
    "face-up": Hold(0.0, -math.pi / 2, "trunk level, face up, arms and legs free"),
    "side": Hold(math.pi / 2, 0.0, "trunk level on its right side, arms and legs free"),
}
RECOMMENDED = (UPRIGHT, "face-down")  # a third tells no more within the same time
# P of the position loop while a held robot is recorded. A third of the usual one lets gravity turn a joint by three
# times as many counts of its encoder, and a zero is known three times as well.
SOFTER = 3.0
RECOMMENDED_GAIN = 4.0  # of the Sigmaban, whose usual one is 12


def holds_of(text: str | None) -> tuple[str, ...]:
    """Names out of a list with commas; those recommended when nobody says.

    Raises:
        UsageError: an unknown name, or one said twice.
    """
    names = RECOMMENDED if text is None else tuple(text.split(","))
    unknown = sorted(set(names) - set(HOLDS))
    if unknown or len(set(names)) < len(names):
        raise UsageError(f"--holds {text}: expected some of {','.join(HOLDS)}, each once")
    return names


def gain_of(asked: float | None, usual: float) -> float:
    """P of the servos while a held robot is recorded: that recommended when nobody says.

    Args:
        asked: by the user.
        usual: at which the model's gains hold.

    Raises:
        UsageError: not a gain, or one far from the usual.
    """
    gain = usual / SOFTER if asked is None else asked
    low, high = usual / 12.0, usual * 16.0 / 3.0
    if not low <= gain <= high:
        raise UsageError(f"--firmware-gain {gain:g}: expected the servos' P, {low:g} to {high:g}")
    return gain


def index_of(name: str) -> int:
    """Number of a hold, for seeds; upright is 0."""
    return list(HOLDS).index(name)


def down(name: str) -> FloatArray:
    """Direction of gravity as a trunk in that hold sees it, shape (3,)."""
    roll, pitch = HOLDS[name].roll, HOLDS[name].pitch
    level = math.cos(pitch)
    return np.array([math.sin(pitch), -math.sin(roll) * level, -math.cos(roll) * level])


def up_of(orientation: FloatArray) -> FloatArray:
    """The world's vertical as a trunk sees it, shape (T, 3), from orientations (w, x, y, z), shape (T, 4)."""
    w, x, y, z = orientation.T / np.linalg.norm(orientation, axis=1)
    # The third row of the rotation.
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])


def part_seconds(seconds: float, holds: Sequence[object]) -> float:
    """What each hold gets of the whole [s], to a hundredth."""
    return round(seconds / len(holds), 2)

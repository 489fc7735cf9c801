"""Has the robot fallen, and on which side does it lie? From what it measures: pitch and pitch rate of the trunk."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from frasa_rl.robot import Floats
from frasa_rl.routine import Detector


class Posture(IntEnum):
    """What the detector says of a robot."""

    STANDING = 0
    FALLING = 1
    PRONE = 2
    SUPINE = 3


class FallDetector:
    """One verdict a robot, with hysteresis in the pitch and a time that lying still must last.

    Upright and fallen have two thresholds, so a pitch that trembles about one does not
    change the verdict back and forth. A fallen robot that moves is FALLING; when its pitch
    rate has been small for `hold_s`, it is PRONE or SUPINE by the sign of its pitch.

    Args:
        thresholds: of the keyframe file.
        count: robots.
        period_s: time between two looks [s].
    """

    def __init__(self, thresholds: Detector, count: int, period_s: float) -> None:
        self._thresholds, self._period = thresholds, period_s
        self._fallen = np.zeros(count, dtype=bool)
        self._still_s = np.zeros(count)
        self._fresh = True

    def look(self, pitch: Floats, rate: Floats) -> npt.NDArray[np.int64]:
        """A `Posture` for every robot, shape (count,).

        Args:
            pitch: of the trunk, forward positive [rad], shape (count,).
            rate: its rate [rad/s], shape (count,).
        """
        limits, tilt = self._thresholds, np.degrees(np.abs(pitch))
        self._fallen = np.where(self._fallen, tilt >= limits.upright_deg, tilt > limits.fallen_deg)
        if self._fresh:  # nothing is known of the time before: between the thresholds a robot is fallen
            self._fallen, self._fresh = tilt >= limits.upright_deg, False
        still = self._fallen & (np.abs(rate) < limits.still_rate)
        lying = still & (self._still_s >= limits.hold_s - 1e-9)
        self._still_s = np.where(still, self._still_s + self._period, 0.0)
        side = np.where(pitch > 0.0, Posture.PRONE, Posture.SUPINE)
        verdict = np.where(lying, side, np.where(self._fallen, Posture.FALLING, Posture.STANDING))
        return verdict.astype(np.int64)

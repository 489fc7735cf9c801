"""Joint trajectories to record: what is sent to the robot, joint by joint, and what each part is for.

Every part starts and ends at one centre pose, so parts can be joined in any order.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from frasa_sysid.holds import UPRIGHT

FloatArray = npt.NDArray[np.float64]
PERIOD = 0.01  # [s] between goals


@dataclass(frozen=True)
class Part:
    """One stretch of an excitation.

    Attributes:
        name: short.
        start, end: [s].
        purpose: what it tells, for people.
    """

    name: str
    start: float
    end: float
    purpose: str


@dataclass(frozen=True)
class Excitation:
    """Goals to send.

    Attributes:
        joints: n names.
        t: times [s], shape (T,), from 0.
        goals: [rad], shape (T, n).
        parts: in order of time.
        hold: how the trunk is held meanwhile, one of `holds.HOLDS`; upright for a robot on its feet.
        firmware_gain: P of the servos meanwhile, in the firmware's unit; None for the model's own.
    """

    joints: tuple[str, ...]
    t: FloatArray
    goals: FloatArray
    parts: tuple[Part, ...]
    hold: str = UPRIGHT
    firmware_gain: float | None = None

    @property
    def seconds(self) -> float:
        """Duration [s]: the last goal is held for a period."""
        return float(self.t[-1]) + PERIOD

    def for_joints(self, names: tuple[str, ...]) -> "Excitation":
        """The same with the joints in another order."""
        order = [self.joints.index(name) for name in names]
        return replace(self, joints=names, goals=self.goals[:, order])

    def at(self, times: FloatArray) -> FloatArray:
        """Goals [rad] at other times [s], shape (K, n); held before the first and after the last."""
        columns = [np.interp(times, self.t, column) for column in self.goals.T]
        return np.stack(columns, axis=1)


def joined(joints: tuple[str, ...], pieces: list[tuple[str, str, FloatArray]]) -> Excitation:
    """One excitation of pieces that follow each other.

    Args:
        joints: n names.
        pieces: name, purpose and goals [rad] (T_i, n) of each.
    """
    parts, start = [], 0.0
    for name, purpose, goals in pieces:
        end = start + len(goals) * PERIOD
        parts.append(Part(name, round(start, 6), round(end, 6), purpose))
        start = end
    goals = np.concatenate([goals for _, _, goals in pieces])
    return Excitation(joints, np.asarray(np.arange(len(goals)) * PERIOD, dtype=np.float64), goals, tuple(parts))

"""Trials side by side, followed through every physics step: the six errors, the fall, the strain.

What is measured does not depend on how often a controller decides: all times are of physics steps.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_rl.batch import Batch
from frasa_rl.controllers import Controller
from frasa_rl.instruments import MEASURES, Instruments
from frasa_rl.reward import target
from frasa_rl.robot import Floats, pitch_of
from frasa_rl.simulation import Start


class Trials:
    """Robots that are told what to do and watched.

    Attributes:
        batch: the robots.
        diverged: whose simulation blew up; they stay where they began, shape (count,).

    Args:
        batch: nobody else's; all robots are put anew.
        model: that the batch was made of.
        starts: of the trials.
    """

    def __init__(self, batch: Batch, model: mujoco.MjModel, starts: Sequence[Start]) -> None:
        self.batch, self._starts = batch, starts
        self._instruments = Instruments(model, batch.robot)
        self.timestep = batch.sim.timestep
        self.diverged = np.zeros(len(starts), dtype=bool)
        for index, start in enumerate(starts):
            batch.put(index, start, look=False)
        batch.look()
        self._worst: list[Floats] = []
        self._tilt: list[Floats] = []
        self._strain: list[Floats] = []
        self._moved = np.full(len(starts), np.nan)
        self._commands = batch.commands.copy()
        self.begin()

    def begin(self) -> None:
        """Forget what was seen; the present is sample 0."""
        worst, tilt = self._errors(self.batch.sim.state[:, None])
        self._worst, self._tilt, self._strain = [worst], [tilt], []
        self._moved[:] = np.nan
        self._commands[:] = self.batch.commands

    @property
    def samples(self) -> int:
        """How many there are, one a physics step and one before the first."""
        return 1 + len(self._strain) * int(self.batch.sim.path.shape[1])

    @property
    def now_s(self) -> float:
        """Time since `begin` [s]."""
        return (self.samples - 1) * self.timestep

    @property
    def moved_s(self) -> Floats:
        """When the first decision that moved a command was taken [s], NaN for none yet, shape (count,)."""
        return self._moved

    def worst_deg(self) -> Floats:
        """Largest of the six errors at every sample [deg], infinite once diverged, shape (count, samples)."""
        return np.concatenate(self._worst, axis=1)

    def tilt_deg(self) -> Floats:
        """Of the trunk's axis from where it is in the standing pose [deg], shape (count, samples)."""
        return np.concatenate(self._tilt, axis=1)

    def strain(self) -> Floats:
        """`MEASURES` of every decision's period, shape (count, periods, 5)."""
        if not self._strain:
            return np.zeros((self.batch.count, 0, len(MEASURES)))
        return np.stack(self._strain, axis=1)

    @property
    def held_periods(self) -> int:
        """Decisions while the pose must be held."""
        return max(1, round(self.batch.task.success_hold_s / self.batch.period_s))

    def every(self, seconds: float) -> bool:
        """Whether the last decision's period ended or passed a multiple of a time [s] since `begin`."""
        now, before = self.now_s + 1e-9, self.now_s - self.batch.period_s + 1e-9
        return int(now / seconds) > int(before / seconds)

    def act(self, actions: npt.ArrayLike) -> None:
        """Apply rates in [-1, 1] for a period, shape (count, n), and watch."""
        batch = self.batch
        before = self.now_s
        batch.act(np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0))
        self._strain.append(self._instruments.read(batch.sim))
        moves = np.abs(batch.commands - self._commands).max(axis=1) > 1e-9
        self._moved[np.isnan(self._moved) & moves] = before
        self.diverged |= batch.sim.diverged
        self._put_back()
        worst, tilt = self._errors(batch.sim.path)
        worst[self.diverged], tilt[self.diverged] = np.inf, np.inf
        self._worst.append(worst)
        self._tilt.append(tilt)

    def decide(self, controller: Controller) -> None:
        """One decision of a controller."""
        self.act(controller.act(self.batch.observation))

    def _put_back(self) -> None:
        """A robot whose simulation blew up begins anew, so that its numbers are numbers; its trial is lost."""
        lost = [index for index, blown in enumerate(self.diverged) if blown]
        for index in lost:
            self.batch.put(index, self._starts[index], look=False)
        if lost:
            self.batch.look()

    def _errors(self, states: Floats) -> tuple[Floats, Floats]:
        """Largest error and tilt [deg] of states, shape (count, steps, ns): two of shape (count, steps)."""
        robot, wanted = self.batch.robot, target(self.batch.task)
        root = 1 + robot.root_qpos + 3
        quaternion = states[:, :, root : root + 4]
        joints = robot.mean_of_sides(states[:, :, 1 + robot.qpos]) - wanted[:-1]
        pitch = pitch_of(quaternion) - wanted[-1]
        worst = np.maximum(np.abs(joints).max(axis=2), np.abs(pitch))
        return np.degrees(worst).astype(np.float32), _tilt(quaternion, wanted[-1]).astype(np.float32)


def _tilt(quaternion: Floats, pitch: float) -> Floats:
    """Angle between the vertical as the trunk sees it and as it does in the standing pose [deg], shape (...,)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    up = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)
    along = up @ np.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    return np.asarray(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))))


def first_hold(good: npt.NDArray[np.bool_], samples: int, begin: int = 0) -> int | None:
    """Where the first `samples` in a row that are good begin, not before `begin`; None when there are none.

    Args:
        good: shape (all samples,).
        samples: length of the hold.
        begin: index of the first sample looked at.
    """
    count = np.concatenate([[0], np.cumsum(good[begin:])])
    if count.size <= samples:
        return None
    found = np.flatnonzero(count[samples:] - count[:-samples] == samples)
    return begin + int(found[0]) if found.size else None


def hold_samples(hold_s: float, timestep: float) -> int:
    """Samples that a hold [s] spans, both ends included."""
    return round(hold_s / timestep) + 1

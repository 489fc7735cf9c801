"""Settled starts, many at once: each robot drawn, released and simulated until it is still, from its own generator."""

import copy
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.compat2024 import CompatStarts, Draw
from frasa_rl.config import Task
from frasa_rl.falls import Kind, as_asked, draw_release, let_go, pushed
from frasa_rl.randomize import Randomizer
from frasa_rl.robot import Robot, find_robot
from frasa_rl.simulation import Simulation, Start
from frasa_rl.task_model import substeps
from frasa_sysid.calibration import Calibration, ModelError

_ATTEMPTS = 50
_ATONCE = 64


class StartMaker:
    """Makes starts of a task.

    Attributes:
        model: that of the robot drawn last.
        original: as it was given.
        robot: where things are in both.

    Args:
        model: of the task (`build_model`), nobody else's: it is written to.
        task: how robots are released.
        calibration: measured ranges; None for a nominal model.
        randomize: False makes every robot the model as it is.
        threads: None for one a core.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        task: Task,
        calibration: Calibration | None,
        *,
        randomize: bool = True,
        threads: int | None = None,
    ) -> None:
        self.model, self.task = model, task
        self.original = copy.copy(model)  # what no draw has written to
        self.robot: Robot = find_robot(model, task)
        self.randomizer = Randomizer(model, self.robot, task, calibration) if randomize else None
        self._threads = threads
        self._steps = substeps(model, task.control_period_s)
        self._data = mujoco.MjData(model)

    def draw_robot(self, rng: Generator) -> tuple[mujoco.MjModel, dict[str, float]]:
        """A model of its own, and what was randomized in it."""
        if self.randomizer is None:
            return copy.copy(self.model), {}
        drawn = self.randomizer.draw(rng)
        return copy.copy(self.model), drawn

    def make(
        self, rngs: Sequence[Generator], kinds: Sequence[Kind], tell: Callable[[float], None] = lambda _: None
    ) -> list[Start]:
        """One start from each generator; it does not depend on what the others are.

        A draw that diverges, or comes to rest where the episode would already be over or on another side
        than asked, is released anew.

        Args:
            rngs: of every start.
            kinds: of every start.
            tell: called with the share done, whenever it has grown.

        Raises:
            ModelError: no release came to rest as asked.
        """
        done: dict[int, Start] = {}
        tries = [_Try(self, index, rng, kind) for index, (rng, kind) in enumerate(zip(rngs, kinds, strict=True))]
        waiting = deque(tries)
        slots: list[_Try | None] = [None] * min(_ATONCE, len(tries))
        if not slots:
            return []
        sim = Simulation(self.model, len(slots), self._threads)
        try:
            while len(done) < len(tries):
                for slot, one in enumerate(slots):
                    if one is None and waiting:
                        slots[slot] = following = waiting.popleft()
                        sim.put(slot, following.begin())
                sim.advance(np.repeat(sim.ctrl[:, None], self._steps, axis=1))
                for slot, one in enumerate(slots):
                    if one is not None and one.over(sim, slot):
                        settled = one.settled(sim, slot)
                        if settled is None:
                            sim.put(slot, one.begin())
                            continue
                        done[one.index], slots[slot] = settled, None
                        tell(len(done) / len(tries))
        finally:
            sim.close()
        return [done[index] for index in range(len(tries))]


def compat_starts(maker: StartMaker) -> CompatStarts:
    """Starts of a maker's model and task as the published environment makes them."""
    draw = Draw(maker.model, maker.robot, maker.task) if maker.randomizer else None
    return CompatStarts(maker.model, maker.robot, maker.task, draw)


class _Try:
    """One start on its way."""

    def __init__(self, maker: StartMaker, index: int, rng: Generator, kind: Kind) -> None:
        self.index, self._maker, self._rng, self._kind = index, maker, rng, kind
        self._attempts = 0
        self._start: Start | None = None

    def begin(self) -> Start:
        """Release the robot, anew when it was before."""
        maker, task = self._maker, self._maker.task
        self._attempts += 1
        if self._attempts > _ATTEMPTS:
            raise ModelError(
                f"none of {_ATTEMPTS} random '{self._kind}' starts came to rest as it should: does the model stand?"
            )
        if self._start is None:
            model, drawn = maker.draw_robot(self._rng)
        else:
            model, drawn = self._start.model, self._start.drawn
            model.sensor_delay[:] = self._start.ages
        how = draw_release(maker.robot, task, self._rng, self._kind)
        self._start = let_go(model, maker._data, maker.robot, task, how, drawn)
        self._left = round(how.settle_s / task.control_period_s)
        self._quiet = 0
        return self._start

    def over(self, sim: Simulation, slot: int) -> bool:
        """Whether it has come to rest, its time is up, or it diverged."""
        task = self._maker.task
        self._left -= 1
        self._quiet = self._quiet + 1 if np.abs(sim.qvel[slot]).max() < task.still_speed else 0
        still = self._quiet * task.control_period_s >= task.still_s
        return bool(still or self._left <= 0 or sim.diverged[slot])

    def settled(self, sim: Simulation, slot: int) -> Start | None:
        """The start; None when the robot is not as asked."""
        assert self._start is not None
        state = sim.state[slot].copy()
        if sim.diverged[slot] or not as_asked(self._maker.robot, state, self._maker.task, self._kind):
            return None
        if self._start.kind == "target" and self._maker.task.near_target_push:
            maker = self._maker
            state = pushed(self._start.model, maker._data, maker.robot, maker.task, state, self._rng)
        return replace(self._start, state=state, sensors=sim.sensors[slot].copy(), older=sim.older[slot].copy())

"""The task's physics for many robots: actions in; truths, readings and observations out. No rewards, no ends."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from frasa_rl import compat2024
from frasa_rl.config import Task
from frasa_rl.observation import Observation, bounds, observe
from frasa_rl.readings import Truth, read, truth
from frasa_rl.reward import errors
from frasa_rl.robot import Floats, find_robot
from frasa_rl.simulation import Simulation, Start
from frasa_rl.snapshots import Arrays, nested, part, put_back, taken
from frasa_rl.task_model import substeps
from frasa_sysid.calibration import UsageError

_KEPT = ("commands", "held", "fastest", "_recent", "_ages")


def _parts_and_steps(all_steps: int, task: Task, period_s: float) -> tuple[int, int]:
    """Decisions in a control period of so many physics steps, and physics steps in a decision's period [s].

    Raises:
        UsageError: the period is not a whole part of the control period, in whole physics steps.
    """
    fitting = [parts for parts in range(1, all_steps + 1) if all_steps % parts == 0]
    for parts in fitting:
        if abs(parts * period_s - task.control_period_s) < 1e-9:
            return parts, all_steps // parts
    rates = ", ".join(f"{round(parts / task.control_period_s, 2):g}" for parts in fitting)
    raise UsageError(
        f"{round(1.0 / period_s, 2):g} decisions a second do not fit into the task's control period of "
        f"{task.control_period_s:g} s and the model's time step: expected one of {rates}"
    )


class Batch:
    """Robots that are told rates and say what they see.

    Attributes:
        robot: where things are in the model.
        sim: the physics.
        commands: present ones of the moved joints, seen from the left [rad], shape (count, n).
        held: what is commanded to all other actuators, shape (count, nu); may be written between two steps.
        now: the truth at this instant.
        observation: what the robots see at this instant, shape (count, 22).

    Args:
        model: of the task (`build_model`).
        task: joints, rates, what is observed.
        count: of robots; `put` each before the first `act`.
        threads: None for one a core.
        period_s: time between two actions [s]; None for the task's control period, of which it must be a part.
    """

    def __init__(
        self, model: mujoco.MjModel, task: Task, count: int, threads: int | None = None, period_s: float | None = None
    ) -> None:
        self.task, self.count = task, count
        self.robot = find_robot(model, task)
        self.sim = Simulation(model, count, threads)
        self.period_s = task.control_period_s if period_s is None else period_s
        self._parts, steps = _parts_and_steps(substeps(model, task.control_period_s), task, self.period_s)
        self._ramp = np.arange(1, steps + 1) / steps
        n = len(task.joints)
        self.commands = np.zeros((count, n))
        self.held = np.tile(self.robot.held, (count, 1))
        self.fastest = np.ones(count)  # largest action, below 1 for some of frasa2024's robots
        self._recent = np.zeros((self._parts, count, n))  # actions of the last control period, the newest last
        self._ages = np.zeros((count, model.nsensor))
        self._bounds = bounds(task)
        self._old = compat2024.Memory(count, n) if task.compat else None
        if self._old is not None and self._parts > 1:
            raise UsageError("compat frasa2024 decides once a control period: its readings are counted in steps")
        self.now: Truth = truth(self.robot, self.sim)
        self.observation: Observation = np.zeros((count, self._bounds.size), dtype=np.float32)

    def put(self, index: int, start: Start, *, look: bool = True) -> None:
        """Make one robot another; `look` refreshes truths and observations (else do so with `look`)."""
        self.sim.put(index, start)
        self._ages[index] = start.ages
        self.commands[index] = self.robot.mean_of_sides(start.ctrl[self.robot.actuators])
        self.held[index] = start.ctrl
        self._recent[:, index] = 0.0
        if self._old is not None:
            self._old.forget(index)
        if look:
            self.look()

    def act(self, actions: Floats) -> None:
        """Ramp the commands linearly over the period, inside the command limits, and look.

        Args:
            actions: joint rates as a share of the rate limit, clipped to [-1, 1], shape (count, n).
        """
        task, robot = self.task, self.robot
        most, asked = self.fastest[:, None], np.clip(actions, -1.0, 1.0)
        wanted = self.commands + np.clip(asked, -most, most) * task.rate_limit * self.period_s
        goal = np.clip(wanted, *robot.limits.T)
        between = self.commands[:, None] + self._ramp[:, None] * (goal - self.commands)[:, None]
        controls = np.repeat(self.held[:, None], self._ramp.size, axis=1)
        controls[:, :, robot.actuators] = robot.both_sides(between)
        self._recent[:-1], self._recent[-1] = self._recent[1:], asked
        before = self.now
        self.sim.advance(controls)
        self.commands = goal
        if self._old is not None:
            self._old.keep(self.sim, robot, before, self._recent[-1])
        self.look()

    def look(self) -> None:
        """Refresh truths and observations."""
        self.now = truth(self.robot, self.sim)
        if self._old is not None:
            readings, action = self._old.read(self.now)
        else:
            readings, action = read(self.robot, self.sim, self.now, self._ages), self._recent.mean(axis=0)
        self.observation = observe(self.robot, readings, self.commands, action, self._bounds)

    def snapshot(self) -> Arrays:
        """All robots as they are, for a checkpoint; which models they have is not part of it."""
        old = {} if self._old is None else nested("old", self._old.snapshot())
        return {**taken(self, _KEPT), **nested("sim", self.sim.snapshot()), **old}

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round, after every robot was `put` with its model."""
        put_back(self, _KEPT, kept)
        self.sim.restore(part("sim", kept))
        if self._old is not None:
            self._old.restore(part("old", kept))
        self.look()

    def errors(self) -> Floats:
        """Joint errors and pitch error to the standing pose [rad], shape (count, 6)."""
        return errors(self.robot, self.now, self.task)

    def close(self) -> None:
        """End the threads."""
        self.sim.close()

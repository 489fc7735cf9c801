"""The push trials: robots standing in their target pose, a controller, a pendulum, a clock.

stand up by hand -> balance -> the controller stands for 2 s -> place and release the pendulum -> hit -> pulled back
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from frasa_rl.balance import balance, first_correction, goals, upright
from frasa_rl.batch import Batch
from frasa_rl.controllers import Controller
from frasa_rl.instruments import add_instruments, over_time
from frasa_rl.protocol import FALL_DEG, LIMIT_S, Conditions
from frasa_rl.push_rig import DIRECTIONS, Direction, Rig, add_rig
from frasa_rl.robot import Floats
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_rl.trials import Trials, first_hold, hold_samples
from frasa_sysid.calibration import load_calibration

Tell = Callable[[float], None]
Cell = tuple[Direction, float]
WAIT_S = 2.0  # the controller stands before the push
_SWING_S = 1.5  # the pendulum has hit by then, or never will; its quarter swing takes 0.6 s
_REACT_S = 2.0  # a robot that deviates later than this after the hit does so for another reason
_CHECK_S = 0.5  # how often to see whether all trials are over: looking costs more than a decision
_IMPACT_S = 0.2  # the longest the bob may lean on the robot before it is pulled back


@dataclass(frozen=True)
class PushTrial:
    """How one push went.

    Attributes:
        direction, energy_j: of it.
        stood: the controller kept the robot in its pose before the push; nothing else is said when not.
        hit: the bob met the robot.
        impulse: of the bob on the robot [N s].
        time_s: from the first deviation above 5 deg to the start of the hold [s], 0 without one; None: never stable.
        fell: the trunk tilted by more than 45 deg from its standing pose before it was stable again.
        diverged: the simulation blew up.
        strain: the `MEASURES` from the release until stable or time was up, shape (5,).
    """

    direction: Direction
    energy_j: float
    stood: bool
    hit: bool
    impulse: float
    time_s: float | None
    fell: bool
    diverged: bool
    strain: Floats


def run_push(
    controller: Controller, conditions: Conditions, count: int, tell: Tell = lambda _: None,
    cells: Sequence[Cell] | None = None,
) -> list[PushTrial]:  # fmt: skip
    """Run `count` trials of each push, all at once.

    Args:
        controller: of all of them.
        conditions: model, task with its pendulum, rate.
        count: trials a push; each depends on its own number alone.
        tell: called with the share done.
        cells: direction and energy of the pushes; None for each of the rig's energies from front and back.

    Raises:
        ModelError: the model is broken, lacks something, or the pendulum passes the robot by.
        CalibrationError: its ranges are missing or belong to another.
        UsageError: the rate does not fit the task, or an energy the pendulum.
    """
    if cells is None:
        cells = [(direction, energy) for direction in DIRECTIONS for energy in conditions.task.rig.energies_j]
    run = PushRun(conditions, [cell for cell in cells for _ in range(count)], list(range(count)) * len(cells))
    try:
        run.stand(controller)
        tell(0.3)
        run.release()
        while not run.over():
            run.step(controller)
            tell(0.3 + 0.7 * run.trials.now_s / (_SWING_S + LIMIT_S))
        tell(1.0)
        return run.judge()
    finally:
        run.trials.batch.close()


class PushRun:
    """Push trials on their way.

    Attributes:
        trials: the robots; their clocks begin at the release.
        rig: the pendulum of each.
        stood: whose controller kept it standing before the push, shape (count,).

    Args:
        conditions: of all trials.
        cells: of each.
        numbers: of each among those of its cell; they choose its chance.
        textures: keep what only pictures need.
    """

    def __init__(
        self, conditions: Conditions, cells: Sequence[Cell], numbers: Sequence[int], textures: bool = False
    ) -> None:
        task, rig = conditions.task, conditions.task.rig
        for _, energy in cells:
            rig.release_angle(energy)  # says early what the pendulum cannot do

        def add(spec: mujoco.MjSpec) -> None:
            add_instruments(spec, task.names)
            add_rig(spec, rig, task.names.trunk)

        model = build_model(conditions.model, task, textures=textures, add=add)
        calibration = load_calibration(conditions.model)
        maker = StartMaker(model, task, calibration, randomize=conditions.randomize, threads=conditions.threads)
        self.rig = Rig(model, maker.robot, rig)
        self._cells, self._data = cells, mujoco.MjData(model)
        chances = [
            conditions.generator(2 + DIRECTIONS.index(direction), round(1e3 * energy), number)
            for (direction, energy), number in zip(cells, numbers, strict=True)
        ]
        correction = first_correction(copy.copy(model), maker.robot, task, conditions.threads)
        wanted = goals(task, chances)
        starts = [
            upright(maker.draw_robot(chance)[0], maker.robot, task, pose, correction)
            for chance, pose in zip(chances, wanted, strict=True)
        ]
        batch = Batch(model, task, len(cells), conditions.threads, conditions.period_s)
        self.trials = Trials(batch, model, starts)
        balance(batch, wanted)
        self.trials.begin()
        self.stood = np.ones(len(cells), dtype=bool)
        self._hit = np.full(len(cells), -1)  # sample of the first touch
        self._pulled = np.zeros(len(cells), dtype=bool)
        self._impulse = np.zeros(len(cells))

    def stand(self, controller: Controller) -> None:
        """Let the controller hold the robots in their pose; see who is stable at the end."""
        trials, task = self.trials, self.trials.batch.task
        controller.start(len(self._cells), trials.batch.period_s)
        while trials.now_s < WAIT_S - 1e-9:
            trials.decide(controller)
        hold = hold_samples(task.success_hold_s, trials.timestep)
        self.stood = np.asarray((trials.worst_deg()[:, -hold:] < task.success_deg).all(axis=1))

    def release(self) -> None:
        """Place every standing robot's pendulum and let it go; the clocks begin."""
        sim = self.trials.batch.sim
        for index, (direction, energy) in enumerate(self._cells):
            if self.stood[index]:
                sim.state[index] = self.rig.place(
                    sim.models[index], self._data, sim.state[index].copy(), direction, energy
                )
        self.trials.begin()

    def step(self, controller: Controller) -> None:
        """One decision; the rig is looked after once a control period, whatever the rate of decisions is."""
        trials = self.trials
        before = trials.samples
        trials.decide(controller)
        sim = trials.batch.sim
        force = np.linalg.norm(sim.sensor_path[:, :, self.rig.touch], axis=2)
        self._impulse += force.sum(axis=1) * sim.timestep
        first = np.flatnonzero(force.any(axis=1) & (self._hit < 0))
        self._hit[first] = before - 1 + np.argmax(force[first] > 0.0, axis=1)
        if trials.every(trials.batch.task.control_period_s):
            self._retrieve(force[:, -1])

    def _retrieve(self, force: Floats) -> None:
        """Pull back the pendulums whose hit is over, whose bob leans on the robot, or that missed."""
        now = self.trials.samples - 1
        leaning = (now - self._hit) * self.trials.timestep >= _IMPACT_S
        hit = (self._hit >= 0) & ((force == 0.0) | leaning)
        missed = (self._hit < 0) & (self.trials.now_s >= _SWING_S)
        for index in np.flatnonzero((hit | missed) & self.stood & ~self._pulled):
            self.rig.retrieve(self.trials.batch.sim.models[index])
            self._pulled[index] = True

    def over(self) -> bool:
        """Whether every trial is decided."""
        trials = self.trials
        if trials.now_s >= _SWING_S + LIMIT_S - 1e-9 or not self.stood.any():
            return True
        if trials.now_s < _SWING_S or not trials.every(_CHECK_S):
            return False
        worst = trials.worst_deg()
        hit = np.flatnonzero(self.stood & (self._hit >= 0))
        return all(self._stable(worst, int(index)) is not None for index in hit)

    def _stable(self, worst: Floats, index: int) -> tuple[int, int] | None:
        """The samples of the first deviation after the hit and of the hold; twice the same without a deviation."""
        task, step = self.trials.batch.task, self.trials.timestep
        begin, reacts = int(self._hit[index]), round(_REACT_S / step)
        near = worst[index, : begin + round(LIMIT_S / step) + 1] < task.success_deg
        hold = hold_samples(task.success_hold_s, step)
        away = np.flatnonzero(~near[begin : begin + reacts + 1])
        if not away.size:
            return (begin, begin) if near.size > begin + reacts else None
        back = first_hold(near, hold, begin + int(away[0]))
        return None if back is None else (begin + int(away[0]), back)

    def judge(self) -> list[PushTrial]:
        """How all trials went."""
        worst, tilt, strain = self.trials.worst_deg(), self.trials.tilt_deg(), self.trials.strain()
        return [self._judge_one(index, worst, tilt, strain) for index in range(len(self._cells))]

    def _judge_one(self, index: int, worst: Floats, tilt: Floats, strain: Floats) -> PushTrial:
        trials, task = self.trials, self.trials.batch.task
        hit = bool(self.stood[index] and self._hit[index] >= 0)
        stable = self._stable(worst, index) if hit else None
        begin, last = max(0, int(self._hit[index])), trials.samples - 1
        if stable is not None:
            last = min(last, stable[1] + hold_samples(task.success_hold_s, trials.timestep) - 1)
        elif hit:
            last = min(last, begin + round(LIMIT_S / trials.timestep))
        periods = int(np.ceil(last * trials.timestep / trials.batch.period_s - 1e-9))
        return PushTrial(
            direction=self._cells[index][0],
            energy_j=self._cells[index][1],
            stood=bool(self.stood[index]),
            hit=hit,
            impulse=float(self._impulse[index]),
            time_s=None if stable is None else (stable[1] - stable[0]) * trials.timestep,
            fell=hit and bool((tilt[index, begin : last + 1] > FALL_DEG).any()),
            diverged=bool(trials.diverged[index]),
            strain=over_time(strain[index, :periods], trials.held_periods),
        )

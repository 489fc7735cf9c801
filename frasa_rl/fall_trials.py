"""Stand-up trials of many controllers side by side, with the ends of the task: for tuning, and to watch training.

A trial starts lying and ends with success, with the end of the episode, or when its time is up; its robot then rests.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frasa_rl.batch_env import StandUpBatch
from frasa_rl.config import Task
from frasa_rl.controllers import Controller
from frasa_rl.protocol import Side
from frasa_rl.robot import Floats
from frasa_rl.simulation import Start
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import load_calibration

_RECENT_S = 0.5  # over which a failure's distance from the standing pose is averaged


@dataclass(frozen=True)
class Trial:
    """How one trial went.

    Attributes:
        time_s: from the first action to the start of the time held in the standing pose; NaN for a failure [s].
        worst_error: largest of the six errors, averaged over the trial's last half second [rad].
        ended: whether the episode ended early: fallen over or spinning too fast.
        lasted_s: until success, the early end, or the end of the time [s].
    """

    time_s: float
    worst_error: float
    ended: bool
    lasted_s: float


class Falls:
    """Robots that fall, and trials that begin there. No result depends on how many there are, or on the threads.

    Attributes:
        task: with an `episode_s` that is long enough for a trial.
        robot: where things are in the model.
        maker: makes the falls.

    Args:
        model: a model file; a calibrated one brings its ranges along.
        task: of all trials.
        randomize: every fall draws its robot and floor; else all are as the model file says.
        threads: None for one a core.

    Raises:
        ModelError: the file is missing or broken, or lacks a joint or sensor.
        CalibrationError: the model is calibrated and its ranges are missing or belong to another.
    """

    def __init__(self, model: Path, task: Task, *, randomize: bool = False, threads: int | None = None) -> None:
        self.task, self._threads = task, threads
        self._model = build_model(model, task)
        self.maker = StartMaker(self._model, task, load_calibration(model), randomize=randomize, threads=threads)
        self.robot = self.maker.robot

    def make(self, side: Side, seeds: Sequence[int]) -> list[Start]:
        """Robots at rest on a side, one for each seed, which decides all of its chance.

        Raises:
            ModelError: no release came to rest as asked.
        """
        return self.maker.make([np.random.default_rng(seed) for seed in seeds], [side] * len(seeds))

    def run(
        self, controllers: Sequence[Controller], starts: Sequence[Start], longest_s: Sequence[float]
    ) -> list[list[Trial]]:
        """Let every controller try every start.

        Args:
            controllers: started anew.
            starts: the same for all controllers.
            longest_s: when each controller gives up, if the episode is not over before [s].

        Returns:
            For each controller, a trial for each start.
        """
        many, period = len(starts), self.task.control_period_s
        core = StandUpBatch(self._model, self.task, len(controllers) * many, self._threads)
        try:
            for index in range(core.count):
                core.begin(index, starts[index % many], look=False)
            core.batch.look()
            for one in controllers:
                one.start(many, period)
            most = np.minimum(longest_s, self.task.episode_s) / period
            trials = _follow(core, controllers, np.repeat(np.round(most).astype(int), many))
        finally:
            core.close()
        return [trials[first : first + many] for first in range(0, len(trials), many)]


def _follow(core: StandUpBatch, controllers: Sequence[Controller], most: np.ndarray) -> list[Trial]:
    """Run until every trial is over.

    Args:
        core: robots at their starts, as many for the first controller as for each.
        controllers: of blocks of robots, in order.
        most: control periods of each trial, shape (robots,).
    """
    many, period = core.count // len(controllers), core.task.control_period_s
    done: list[Trial | None] = [None] * core.count
    resting = core.batch.sim.resting
    actions = np.zeros((core.count, len(core.task.joints)))
    worst: list[Floats] = []
    while not resting.all():
        for index, one in enumerate(controllers):
            block = slice(index * many, (index + 1) * many)
            if not resting[block].all():  # whoever rests may be where a simulation blew up
                actions[block] = np.where(resting[block, None], 0.0, one.act(core.batch.observation[block]))
        out = core.step(actions)
        worst.append(np.nan_to_num(np.abs(core.batch.errors()).max(axis=1), nan=np.pi))
        step = len(worst)
        for robot in np.flatnonzero(~resting & (out.success | out.terminated | (step >= most))):
            time_s = step * period - core.task.success_hold_s if out.success[robot] else np.nan
            recent = [errors[robot] for errors in worst[-(1 if out.success[robot] else round(_RECENT_S / period)) :]]
            ended = bool(out.terminated[robot] and not out.success[robot])
            done[robot] = Trial(float(time_s), float(np.mean(recent)), ended, step * period)
            resting[robot] = True
    return [one for one in done if one is not None]

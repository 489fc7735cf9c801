"""The stand-up trials: prone and supine robots at rest, a controller, a clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from frasa_rl.batch import Batch
from frasa_rl.controllers import Controller
from frasa_rl.instruments import add_instruments, over_time
from frasa_rl.protocol import LIMIT_S, SIDES, Conditions, Side
from frasa_rl.robot import Floats
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_rl.trials import Trials, first_hold, hold_samples
from frasa_sysid.calibration import load_calibration

Tell = Callable[[float], None]
_CHECK_S = 0.5  # how often to see whether all trials are over: looking costs more than a decision


@dataclass(frozen=True)
class StandUpTrial:
    """How one trial went.

    Attributes:
        side: how the robot lay.
        time_s: from the first movement of a command to the start of the hold [s]; None for a failure.
        from_decision_s: the same from the first decision, the wait of a fall detector included [s].
        diverged: the simulation blew up.
        strain: the `MEASURES` until the hold was over or time was up, shape (5,).
    """

    side: Side
    time_s: float | None
    from_decision_s: float | None
    diverged: bool
    strain: Floats


def run_standup(
    controller: Controller, conditions: Conditions, count: int, tell: Tell = lambda _: None,
    sides: Sequence[Side] = SIDES,
) -> list[StandUpTrial]:  # fmt: skip
    """Run `count` trials from each side, all at once.

    Args:
        controller: of all of them.
        conditions: model, task, rate.
        count: trials a side; each depends on its own number alone.
        tell: called with the share done.
        sides: which.

    Raises:
        ModelError: the model is broken, lacks something, or does not come to rest as asked.
        CalibrationError: its ranges are missing or belong to another.
        UsageError: the rate does not fit the task.
    """
    trials, kinds = start_standup(conditions, count, sides)
    try:
        controller.start(len(kinds), trials.batch.period_s)
        while trials.now_s < LIMIT_S - 1e-9:
            trials.decide(controller)
            tell(trials.now_s / LIMIT_S)
            if trials.every(_CHECK_S) and all(one is not None for one in _stood(trials)):
                break
        tell(1.0)
        return judge_standup(trials, kinds)
    finally:
        trials.batch.close()


def start_standup(conditions: Conditions, count: int, sides: Sequence[Side], textures: bool = False) -> tuple[
    Trials, list[Side]
]:  # fmt: skip
    """The robots lying at rest and the side of each; close their batch when done."""
    task = conditions.task
    model = build_model(conditions.model, task, textures=textures, add=lambda spec: add_instruments(spec, task.names))
    calibration = load_calibration(conditions.model)
    maker = StartMaker(model, task, calibration, randomize=conditions.randomize, threads=conditions.threads)
    batch = Batch(model, task, count * len(sides), conditions.threads, conditions.period_s)
    kinds: list[Side] = [side for side in sides for _ in range(count)]
    chances = [conditions.generator(SIDES.index(side), trial) for side in sides for trial in range(count)]
    return Trials(batch, model, maker.make(chances, kinds)), kinds


def _stood(trials: Trials) -> list[int | None]:
    """The sample where each hold begins."""
    task = trials.batch.task
    hold = hold_samples(task.success_hold_s, trials.timestep)
    return [first_hold(one, hold) for one in trials.worst_deg() < task.success_deg]


def judge_standup(trials: Trials, kinds: list[Side]) -> list[StandUpTrial]:
    """How all trials went so far."""
    strain, task = trials.strain(), trials.batch.task
    judged = []
    for index, begin in enumerate(_stood(trials)):
        moved = float(np.nan_to_num(trials.moved_s[index]))
        time_s = None if begin is None else begin * trials.timestep
        end_s = trials.now_s if time_s is None else time_s + task.success_hold_s
        periods = int(np.ceil(end_s / trials.batch.period_s - 1e-9))
        judged.append(
            StandUpTrial(
                side=kinds[index],
                time_s=None if time_s is None else max(0.0, time_s - moved),
                from_decision_s=time_s,
                diverged=bool(trials.diverged[index]),
                strain=over_time(strain[index, :periods], trials.held_periods),
            )
        )
    return judged

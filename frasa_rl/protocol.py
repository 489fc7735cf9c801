"""What the paper measures, its numbers, and what trials are run on.

Stand-up: from prone and supine, time from the start of movement until all six errors stay below 5 deg for 0.5 s.
Push: a pendulum hits the standing robot's trunk; time from the first deviation above 5 deg until stable again.
Source: FRASA, Gaspard et al., arXiv 2410.08655 (on the robot); None where a number is not known to this project.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from frasa_rl.config import Task

Side = Literal["prone", "supine"]
SIDES: tuple[Side, ...] = ("prone", "supine")
LIMIT_S = 10.0  # of a trial; the paper's keyframes need 5.06 s from supine
FALL_DEG = 45.0  # the trunk tilted further than this from the standing pose has fallen

# Mean and deviation [s]; the keyframes are those of the team's RoboCup 2023 robot.
PAPER_STANDUP: dict[str, dict[str, tuple[float, float | None]]] = {
    "prone": {"agent": (2.135, 0.042), "keyframes": (3.154, None)},
    "supine": {"agent": (2.678, 0.178), "keyframes": (5.06, None)},
}
PAPER_PUSH: dict[tuple[str, float], float] = {
    ("front", 4.0): 0.54, ("front", 5.5): 2.41, ("front", 7.3): 2.44, ("back", 4.0): 0.62, ("back", 5.5): 2.26,
}  # fmt: skip


@dataclass(frozen=True)
class Conditions:
    """What trials are run on.

    Attributes:
        model: a model file; a calibrated one brings its ranges along.
        task: poses, rates, what counts as standing, the pendulum.
        rate_hz: decisions a second; None for one a control period.
        randomize: every trial draws its robot and floor; else all are as the model file says and only starts differ.
        seed: of all trials.
        threads: None for one a core.
    """

    model: Path
    task: Task = field(default_factory=Task)
    rate_hz: float | None = None
    randomize: bool = False
    seed: int = 10_000
    threads: int | None = None

    @property
    def period_s(self) -> float:
        """Between two decisions [s]."""
        return self.task.control_period_s if self.rate_hz is None else 1.0 / self.rate_hz

    def generator(self, *place: int) -> np.random.Generator:
        """The chance of one trial, whatever other trials there are; `place` says which one it is."""
        return np.random.default_rng([self.seed, *place])


def evaluation_task(task: Task | None = None) -> Task:
    """The task of training, by default the Sigmaban's, with the time of a trial: an episode's hides slow keyframes."""
    return replace(task or Task(), episode_s=LIMIT_S)


def mean_and_std(times: list[float | None]) -> tuple[float | None, float | None]:
    """Of those that are known; None without any. The deviation is that of the trials themselves (divided by n)."""
    known = np.array([one for one in times if one is not None])
    return (float(known.mean()), float(known.std())) if known.size else (None, None)

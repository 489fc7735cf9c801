"""When a run ends: its budgets, success, Ctrl-C."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import numpy as np

from frasa_sysid.calibration import UsageError, say

_MOST_STEPS, _MOST_MINUTES = 1e12, 1e7  # years of either


@dataclass(frozen=True)
class Ends:
    """Whichever comes first ends a run; None for no limit.

    Attributes:
        steps: transitions.
        minutes: of training, earlier parts of a resumed run included.
        success: share of held-out falls that end standing, in two evaluations on different falls.
    """

    steps: int | None = None
    minutes: float | None = None
    success: float | None = None

    def __post_init__(self) -> None:
        if self.steps is not None and not 1 <= self.steps <= _MOST_STEPS:
            raise UsageError(f"--steps is {self.steps}: expected 1 .. {_MOST_STEPS:,g}")
        if self.minutes is not None and not 0.0 < self.minutes <= _MOST_MINUTES:  # NaN and infinity never come
            raise UsageError(f"--minutes is {self.minutes}: expected more than 0 and at most {_MOST_MINUTES:,g}")
        if self.success is not None and not 0.0 < self.success <= 1.0:
            raise UsageError(f"--until-success is {self.success}: expected more than 0 and at most 1")

    def reached(self, steps: int, elapsed_s: float) -> str | None:
        """The budget that is used up."""
        if self.minutes is not None and elapsed_s >= 60.0 * self.minutes:
            return "minutes"
        return "steps" if self.steps is not None and steps >= self.steps else None

    def left_s(self, steps: int, elapsed_s: float, steps_per_s: float) -> float:
        """Time to the nearer budget [s]; infinite where only success ends a run."""
        by_steps = (self.steps - steps) / max(steps_per_s, 1e-9) if self.steps is not None else np.inf
        by_time = 60.0 * self.minutes - elapsed_s if self.minutes is not None else np.inf
        return float(max(0.0, min(by_steps, by_time)))


class Interrupt:
    """Whether the user wants the run to end.

    Attributes:
        asked: since the first Ctrl-C or termination.
    """

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def watch(self) -> Iterator[None]:
        """The first signal ends the run after the current round, with all saved; a second one at once."""

        def stop(number: int, frame: FrameType | None) -> None:
            if self.asked:
                raise KeyboardInterrupt
            self.asked = True
            say("\nstopping after this round; everything is saved (again to stop at once)")

        kept = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in kept.items():
                signal.signal(number, handler)

"""How a sweep goes: one line for all agents, from what they write themselves, wherever they run."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from frasa_rl.bars import Line, clock
from frasa_rl.evaluations import shown
from frasa_rl.stopping import Interrupt
from frasa_rl.sweep_files import LOG_FILE, STOP_FILE, Sweep
from frasa_rl.tables import EVALUATIONS, PROGRESS

_LOOK_S = 0.25


class Watch:
    """Looks at the run folders of a sweep.

    Attributes:
        over: how those agents ended that have, by seed: `done` or `failed`.
        line: on standard error.

    Args:
        sweep: with its agents.
        at_a_time: agents.
    """

    def __init__(self, sweep: Sweep, at_a_time: int) -> None:
        self._sweep, self._at_a_time = sweep, at_a_time
        self._begun, self._begun_at = time.monotonic(), time.time()
        self.over: dict[int, str] = {}
        self.line = Line()

    @contextmanager
    def going_on(self, interrupt: Interrupt) -> Iterator[None]:
        """Tell how it goes while the work inside goes on, and pass on that the user wants it to end."""
        ended = threading.Event()

        def look() -> None:
            while not ended.wait(_LOOK_S):
                if interrupt.asked:
                    with suppress(OSError):  # a full disk may have room the next time
                        (self._sweep.out / STOP_FILE).touch()
                if self.line.due:
                    self.line.show(self.text())

        beside = threading.Thread(target=look, daemon=True)
        beside.start()
        try:
            yield
        finally:
            ended.set()
            beside.join()

    def text(self) -> str:
        """The line."""
        many, left = len(self._sweep.seeds), self.left_s()
        states = [*self.over.values()]
        words = [f"{states.count('done')}/{many} agents done, {sum(map(self._running, self._sweep.seeds))} running"]
        if "failed" in states:
            words[0] += f", {states.count('failed')} failed"
        best = self._best()
        if best is not None:
            words.append(f"best: seed {best[0]}, {shown(best[1])}")
        words += [clock(time.monotonic() - self._begun), f"left {clock(left) if np.isfinite(left) else '-'}"]
        return "  ".join(words)

    def _running(self, seed: int) -> bool:
        """Whether an agent has said anything since the sweep began, and has not ended."""
        with suppress(OSError):
            log = self._sweep.folder(seed) / LOG_FILE
            return seed not in self.over and log.stat().st_mtime >= self._begun_at - 1.0
        return False

    def _best(self) -> tuple[int, list[float]] | None:
        found = [(seed, row) for seed in self._sweep.seeds for row in EVALUATIONS.read(self._sweep.folder(seed))]
        return max(found, key=lambda one: one[1][3] + one[1][4], default=None)

    def left_s(self) -> float:
        """Time to the end of the last agent, as far as budgets say [s]; infinite where nothing is known.

        An agent that has not begun is taken to last as long as the others will.
        """
        parts = {seed: self._part(seed) for seed in self._sweep.seeds if seed not in self.over}
        known = [spent / share for spent, share in parts.values() if share > 0.0]
        if not parts:
            return 0.0
        if not known:
            return float("inf")
        whole = float(np.mean(known))
        left = [(spent / share if share > 0.0 else whole) - spent for spent, share in parts.values()]
        return max(0.0, *left, sum(left) / self._at_a_time)

    def _part(self, seed: int) -> tuple[float, float]:
        """Training time of an agent so far [s], and which share of its budget that is; 0 where nothing says so."""
        rows = PROGRESS.read(self._sweep.folder(seed))
        if not rows:
            return 0.0, 0.0
        steps, minutes = rows[-1][:2]
        ends: dict[str, Any] = self._sweep.run
        shares = [now / ends[name] for name, now in (("steps", steps), ("minutes", minutes)) if ends[name]]
        return 60.0 * minutes, min(1.0, max(shares, default=0.0))

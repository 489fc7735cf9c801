"""Which part of a log is kept in memory when all of it would be too much: the windows in which the joints move most.

A log is read once, front to back. Its readings are filed by windows of some seconds on the recorder's clock. When more
numbers are kept than there is room for, the window that tells a fit least is let go: of its values nothing is left but
a tally. A log that fits is kept whole, and none of this shows.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import UsageError
from frasa_sysid.excerpt import travel
from frasa_sysid.message_definitions import SIMULATED
from frasa_sysid.readers.series import Series, Stamps

NUMBERS = 2**24  # of eight bytes that are kept of a log: 128 MiB
WINDOW = 10 * 10**9  # ns; long enough for a motion with its beginning and end
OUTSIDE = -(2**62)  # window of what was not asked for
LATECOMERS = 2**18  # numbers of a window that was let go already which are collected before they go too
STAMP_WORDS = 4  # numbers that the stamps and the place of a reading take
MOVING = ("position", "goal", "velocity", "gyro")  # what says how much a robot moves, the first that there is
SECOND = 10**9


@dataclass(frozen=True)
class Limit:
    """How much of a log is kept.

    Attributes:
        numbers: values and stamps in memory, eight bytes each; None for all.
        between: only what was recorded from so many to so many seconds after the log's first message.
    """

    numbers: int | None = NUMBERS
    between: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.between is not None and not 0.0 <= self.between[0] < self.between[1]:
            raise UsageError(f"--between {self.between[0]:g} {self.between[1]:g}: expected two times, the later last")


@dataclass
class KeptWindows:
    """Windows of a log, while it is read.

    Attributes:
        limit: how much may be kept.
        first, last: log times of the earliest and the latest message so far [ns].
        gone: windows that were let go.
    """

    limit: Limit = field(default_factory=Limit)
    first: int = -1
    last: int = 0
    gone: set[int] = field(default_factory=set)
    _words: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    _travel: dict[int, float] = field(default_factory=dict)
    _begin: int = -1

    def of(self, log: Stamps) -> npt.NDArray[np.int64]:
        """The window of each of n messages by its log time [ns], shape (n,)."""
        times = np.minimum(log, np.uint64(2**62)).astype(np.int64)
        if self._begin < 0:
            self._begin = int(times[0])
        low, high = int(times.min()), int(times.max())
        self.first, self.last = low if self.first < 0 else min(self.first, low), max(self.last, high)
        since = times - self._begin
        found = since // WINDOW
        if self.limit.between is not None:
            begin, end = (round(one * SECOND) for one in self.limit.between)
            found = np.where((since >= begin) & (since <= end), found, OUTSIDE)
            self.gone.add(OUTSIDE)
        return found

    def count(self, window: int, rows: int, numbers: int) -> None:
        """Some readings were added to a window."""
        self._words[window] += numbers + STAMP_WORDS * rows
        self._travel.pop(window, None)

    def make_room(self, series: Iterable[Series], final: bool = False) -> None:
        """Let windows go until those before the newest are within the limit, at the end all of them.

        Args:
            series: what has been read.
            final: it was the last message.
        """
        several = list(series)
        for window in self.gone & set(self._words):
            if final or self._words[window] > LATECOMERS:
                self._let_go(window, several)
        if self.limit.numbers is None:
            return
        while True:
            # The newest window is not complete: what it is worth shows later.
            old = sorted(self._words)[: None if final else -1]
            if len(self._words) < 2 or sum(self._words[one] for one in old) <= self.limit.numbers:
                return
            for window in old:
                if window not in self._travel:
                    self._travel[window] = _travel(several, window)
            self._let_go(min(old, key=lambda one: (self._travel[one], -one)), several)

    def stretches(self) -> list[list[int]]:
        """Windows that were kept, those without a gap between them together; one stretch where none was let go."""
        kept = sorted(self._words)
        if not self.gone:
            return [kept]
        found: list[list[int]] = []
        for window in kept:
            if found and not any(found[-1][-1] < one < window for one in self.gone):
                found[-1].append(window)
            else:
                found.append([window])
        return found

    def span(self, stretch: Sequence[int]) -> tuple[float, float]:
        """From when to when a stretch goes [s from the first message]."""
        begin = stretch[0] * WINDOW + self._begin - self.first
        end = (stretch[-1] + 1) * WINDOW + self._begin - self.first
        asked = self.limit.between or (0.0, self.seconds)
        return max(begin / SECOND, asked[0]), min(end / SECOND, asked[1], self.seconds)

    @property
    def seconds(self) -> float:
        """From the first to the last message."""
        return (self.last - self.first) / SECOND

    def _let_go(self, window: int, series: Sequence[Series]) -> None:
        for one in series:
            one.let_go(window)
        self.gone.add(window)
        self._words.pop(window, None)
        self._travel.pop(window, None)


def _travel(series: Sequence[Series], window: int) -> float:
    """How far the joints go within a window, on average over them, in the unit of what says it."""
    measured = [one for one in series if not one.topic.startswith(SIMULATED)]
    for name in MOVING:
        ways = [_way(one, window) for one in measured if one.name == name]
        if ways:
            return max(ways)
    return 0.0


def _way(series: Series, window: int) -> float:
    found = 0.0
    for block in series.blocks(window):
        found = max(found, travel(block.values, WINDOW / SECOND))
    return found

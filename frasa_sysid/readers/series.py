"""The readings of one quantity on one topic as arrays, window by window of the log; of some only a tally is left."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from frasa_sysid.readers.decoders import Reading
from frasa_sysid.readers.sampling import GAP
from frasa_sysid.recording import Clock, FloatArray

Stamps = npt.NDArray[np.uint64]
Places = npt.NDArray[np.int64]
Columns = tuple[str, ...]
CLOCKS: tuple[Clock, ...] = ("header", "publish", "log")
MISSING_STAMPS = 0.01  # share (and one: simulated time begins at 0) that a stamped channel may lack
LATEST = 2**63  # ns; the year 2262
BUFFERED = 4096  # readings that are kept as lists before they become an array
BLOCKS = 64  # of a window before they are joined
KEPT_STAMPS = 32  # of each window whose values were let go: clocks can still be compared


class Block(NamedTuple):
    """n readings with the same columns.

    Attributes:
        columns: k joints or axes.
        places: where in the file they stand, shape (n,).
        stamps: header, publish and log time [ns], 0 where there is none, shape (n, 3).
        values: shape (n, k).
    """

    columns: Columns
    places: Places
    stamps: Stamps
    values: FloatArray


@dataclass(frozen=True)
class Tally:
    """What is left of the readings of a window that was let go.

    Attributes:
        rows: readings.
        not_finite: of them, with a value that is NaN or infinite.
        low, high: smallest and largest finite value; NaN without one.
        backwards, repeated, gaps: by clock: steps of time below and at zero, and above `GAP` times the usual.
        longest: by clock: longest step [ns].
        stamps: some of the stamps [ns], the first and the last among them, shape (m, 3).
    """

    rows: int
    not_finite: int
    low: float
    high: float
    backwards: dict[Clock, int]
    repeated: dict[Clock, int]
    gaps: dict[Clock, int]
    longest: dict[Clock, int]
    stamps: Stamps


@dataclass
class _Buffer:
    places: list[int] = field(default_factory=list)
    stamps: list[tuple[int, ...]] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)


@dataclass
class Series:
    """The readings of one quantity on one topic, in file order.

    Attributes:
        topic, name, unit: as the message says; None for a unit that it leaves open.
        size: readings, those that were let go too.
        lacking: readings without a stamp, by clock.
        published: a publish time differs from the log time beside it.
        orders: how often the columns came in which order.
        firsts: where in the file each of those came first.
        tallies: of windows that were let go, by number of the window.
    """

    topic: str
    name: str
    unit: str | None
    size: int = 0
    lacking: Counter[Clock] = field(default_factory=Counter)
    published: bool = False
    orders: Counter[Columns] = field(default_factory=Counter)
    firsts: dict[Columns, int] = field(default_factory=dict)
    tallies: dict[int, list[Tally]] = field(default_factory=lambda: defaultdict(list))
    _blocks: dict[int, list[Block]] = field(default_factory=lambda: defaultdict(list))
    _buffers: dict[tuple[int, Columns], _Buffer] = field(default_factory=lambda: defaultdict(_Buffer))
    _known: dict[Columns | frozenset[str], Columns] = field(default_factory=dict)

    def add(self, window: int, reading: Reading, place: int, stamps: Sequence[int]) -> int:
        """Append one reading to a window, with its three stamps [ns]; how many numbers it has."""
        values = [float(value) for value in reading.values]  # may fail: before anything is kept
        columns, order = self._sorted_in(reading.columns)
        filled = tuple(time if 0 < time < LATEST else 0 for time in stamps)
        self._count(reading.columns, place, np.array([filled], np.uint64))
        buffer = self._buffers[window, columns]
        buffer.places.append(place)
        buffer.stamps.append(filled)
        buffer.values.append(values if order is None else [values[i] for i in order])
        if len(buffer.places) >= BUFFERED:
            self._unbuffer(window)
        return len(values)

    def add_rows(self, window: int, block: Block) -> None:
        """Append n readings to a window."""
        columns, order = self._sorted_in(block.columns)
        stamps = np.where(block.stamps < LATEST, block.stamps, np.uint64(0))
        self._count(block.columns, int(block.places[0]), stamps)
        values = block.values if order is None else block.values[:, order]
        self._blocks[window].append(Block(columns, block.places, stamps, values))
        if len(self._blocks[window]) > BLOCKS:
            self.blocks(window)

    @property
    def first(self) -> int:
        """Where in the file its first reading stands."""
        return min(self.firsts.values())

    def has(self, clock: Clock) -> bool:
        """Whether (nearly) all readings carry that clock's stamp."""
        lacking = self.lacking[clock]
        return lacking <= max(1, MISSING_STAMPS * self.size) and lacking < self.size

    def blocks(self, window: int) -> list[Block]:
        """The readings of a window that were kept, in file order, those with the same columns together."""
        self._unbuffer(window)
        if window in self._blocks:
            self._blocks[window] = joined(self._blocks[window])
        return self._blocks.get(window, [])

    def stamps(self, windows: Iterable[int]) -> Stamps:
        """All stamps [ns] of some windows, of those that were let go as far as they were kept, shape (n, 3)."""
        found = [block.stamps for window in windows for block in self.blocks(window)]
        found += [tally.stamps for window in windows for tally in self.tallies.get(window, [])]
        return np.concatenate(found) if found else np.zeros((0, 3), np.uint64)

    def take(self, windows: Sequence[int]) -> list[Block]:
        """The readings of some windows, which are not kept here any longer, those with the same columns together."""
        found = joined([block for window in windows for block in self.blocks(window)])
        for window in windows:
            self._blocks.pop(window, None)
        return found

    def let_go(self, window: int) -> None:
        """Keep no more than a tally of a window's values."""
        self.tallies[window] += [tally(block) for block in self.blocks(window)]
        self._blocks.pop(window, None)

    def _unbuffer(self, window: int) -> None:
        for key in [key for key in self._buffers if key[0] == window]:
            buffer = self._buffers.pop(key)
            places, stamps = np.array(buffer.places, np.int64), np.array(buffer.stamps, np.uint64)
            self._blocks[window].append(Block(key[1], places, stamps, np.array(buffer.values, dtype=np.float64)))

    def _sorted_in(self, columns: Columns) -> tuple[Columns, list[int] | None]:
        """The same columns in the order in which they came first, and where each of those stands."""
        names = frozenset(columns)
        known = self._known.setdefault(names if len(names) == len(columns) else columns, columns)
        return known, None if known == columns else [columns.index(name) for name in known]

    def _count(self, columns: Columns, place: int, stamps: Stamps) -> None:
        self.size += len(stamps)
        self.orders[columns] += len(stamps)
        self.firsts[columns] = min(place, self.firsts.get(columns, place))
        for i, clock in enumerate(CLOCKS):
            self.lacking[clock] += int((stamps[:, i] == 0).sum())
        self.published = self.published or bool((stamps[:, 1] != stamps[:, 2]).any())


def joined(blocks: Sequence[Block]) -> list[Block]:
    """Blocks with the same columns as one, in file order."""
    by_columns: dict[Columns, list[Block]] = defaultdict(list)
    for block in blocks:
        by_columns[block.columns].append(block)
    return [_one(columns, several) for columns, several in by_columns.items()]


def _one(columns: Columns, blocks: Sequence[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]
    places, stamps, values = (np.concatenate(parts) for parts in list(zip(*blocks, strict=True))[1:])
    if (np.diff(places) < 0).any():
        order = np.argsort(places, kind="stable")
        places, stamps, values = places[order], stamps[order], values[order]
    return Block(columns, places, stamps, values)


def tally(block: Block) -> Tally:
    """What is left of a block that is let go."""
    good = np.isfinite(block.values)
    finite = block.values[good]
    steps = {clock: _steps(block.stamps[:, i]) for i, clock in enumerate(CLOCKS)}
    rows = len(block.places)
    some = np.unique(np.linspace(0, rows - 1, KEPT_STAMPS).round().astype(np.int64))
    return Tally(
        rows,
        int((~good.all(axis=1)).sum()),
        float(finite.min()) if finite.size else np.nan,
        float(finite.max()) if finite.size else np.nan,
        {clock: int((dt < 0).sum()) for clock, dt in steps.items()},
        {clock: int((dt == 0).sum()) for clock, dt in steps.items()},
        {clock: int((dt > GAP * np.median(dt)).sum()) if dt.size else 0 for clock, dt in steps.items()},
        {clock: int(dt.max()) if dt.size else 0 for clock, dt in steps.items()},
        block.stamps[some],
    )


def _steps(stamps: Stamps) -> npt.NDArray[np.int64]:
    return np.asarray(np.diff(stamps[stamps > 0].astype(np.int64)), np.int64)

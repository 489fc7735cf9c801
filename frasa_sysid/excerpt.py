"""Parts of recordings: where logs are longer than a fit has memory for, those in which the joints move most."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from frasa_sysid.recording import FloatArray, Recording, Signal

WINDOW = 10.0  # [s]; long enough for a motion with its beginning and end
SHORTEST = 2.0  # [s] of a part, where there are longer ones
RESOLUTION = 0.05  # [s] from one position to the next when motion is added up: noise is no motion
SHOWN = 4  # parts that are named


@dataclass(frozen=True)
class Window:
    """A part of a recording, [begin, end) in seconds of its own clock.

    Attributes:
        index: which recording.
        begin, end: [s].
        travel: how far its joints go [rad], on average over them.
        cost: what it takes.
    """

    index: int
    begin: float
    end: float
    travel: float
    cost: float


def travel(values: FloatArray, seconds: float) -> float:
    """How far joints go, on average over them, steps below the resolution left out.

    Args:
        values: positions, shape (T,) or (T, k).
        seconds: from first to last.
    """
    stride = max(1, round(len(values) * RESOLUTION / max(seconds, RESOLUTION)))
    steps = np.abs(np.diff(values[::stride], axis=0))
    return float(np.nan_to_num(steps, posinf=0.0).sum(axis=0).mean())


def liveliest(recordings: Sequence[Recording], cost: Callable[[Recording], int], most: int) -> list[Recording]:
    """The parts of recordings in which their joints move most; the recordings themselves where all of them fit.

    Every log keeps its share by length: what a robot did while it was held another way may be what tells its zeros.

    Args:
        recordings: with positions.
        cost: what one takes, in proportion to its length.
        most: that all of them may take.
    """
    costs = [cost(one) for one in recordings]
    if sum(costs) <= most:
        return list(recordings)
    logs: dict[str, list[int]] = defaultdict(list)
    for i, one in enumerate(recordings):
        logs[one.name.split("@")[0]].append(i)
    chosen: list[Window] = []
    for members in logs.values():
        share = most * sum(costs[i] for i in members) / sum(costs)
        windows = [window for i in members for window in _windows(i, recordings[i], costs[i])]
        # The end of a log may be a window of a few samples.
        windows = [one for one in windows if one.end - one.begin >= SHORTEST] or windows
        windows.sort(key=lambda one: (-one.travel, one.index, one.begin))
        chosen.append(windows[0])
        left = share - windows[0].cost
        for window in windows[1:]:
            if window.cost <= left:
                chosen.append(window)
                left -= window.cost
    return [part(recordings[i], begin, end) for i, begin, end in _merged(chosen)]


def part(recording: Recording, begin: float, end: float) -> Recording:
    """What a recording holds from `begin` up to `end` [s], its time zero at `begin`; its name says where it is from."""
    signals = {}
    for name, signal in recording.signals.items():
        rows = (signal.t >= begin) & (signal.t < end)
        if rows.any():
            signals[name] = Signal(name, signal.unit, signal.t[rows] - begin, signal.y[rows], signal.columns)
    told = recording.extra.get("excerpt")
    before = float(told["from_s"]) if isinstance(told, dict) else 0.0
    whole = float(told["log_s"]) if isinstance(told, dict) else recording.duration
    excerpt = {"from_s": before + begin, "to_s": before + end, "log_s": whole}
    name = f"{recording.name.split('@')[0]}@{before + begin:.0f}s"
    return replace(recording, name=name, signals=signals, extra={**recording.extra, "excerpt": excerpt})


def words(recordings: Sequence[Recording]) -> str:
    """Which parts of which logs some recordings are, in a sentence; empty where they are whole ones."""
    logs: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for one in recordings:
        told = one.extra.get("excerpt")
        if isinstance(told, dict):
            logs[one.name.split("@")[0]].append((told["from_s"], told["to_s"], told["log_s"]))
    said = []
    for name, spans in logs.items():
        used = sum(end - begin for begin, end, _ in spans)
        parts = ", ".join(f"{begin:.0f}-{end:.0f}" for begin, end, _ in spans[:SHOWN])
        parts += f" and {len(spans) - SHOWN} more" if len(spans) > SHOWN else ""
        said.append(f"{name}: {used:.0f} of {spans[0][2]:.0f} s ({parts} s)")
    more = f" and {len(said) - SHOWN} more logs" if len(said) > SHOWN else ""
    return "; ".join(said[:SHOWN]) + more


def _windows(index: int, recording: Recording, cost: int) -> list[Window]:
    position = recording.signal("position")
    first, last = float(position.t[0]), float(position.t[-1])
    count = max(round((last - first) / WINDOW), 1)
    edges = np.linspace(first, last, count + 1)
    edges[-1] = np.nextafter(last, np.inf)
    found = []
    for begin, end in pairwise(edges.tolist()):
        rows = slice(*np.searchsorted(position.t, [begin, end]))
        found.append(Window(index, begin, end, travel(position.y[rows], end - begin), cost / count))
    return found


def _merged(windows: Sequence[Window]) -> list[tuple[int, float, float]]:
    """Windows that follow one another as one: recording, begin, end."""
    found: list[tuple[int, float, float]] = []
    for one in sorted(windows, key=lambda window: (window.index, window.begin)):
        if found and found[-1][0] == one.index and found[-1][2] == one.begin:
            found[-1] = (one.index, found[-1][1], one.end)
        else:
            found.append((one.index, one.begin, one.end))
    return found

"""Errors of simulated robots by channel, log and joint, and what stands behind them sample by sample.

Channels are those of `robot_residuals`; every sample counts alike, so that long logs weigh more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_residuals import DIVERGED, IntArray, Layout, Samples

UNITS = {"position": "rad", "velocity": "rad/s", "gyro": "rad/s", "orientation": "rad"}
_AXES = {f"gyro{i}": axis for i, axis in enumerate("xyz")} | {"orientation0": "roll", "orientation1": "pitch"}


@dataclass(frozen=True)
class Compared:
    """One simulated robot against runs of one kind of base.

    Attributes:
        layout: of the R residuals.
        samples: what they are of.
        residuals: simulated minus measured, shape (R,).
    """

    layout: Layout
    samples: Samples
    residuals: FloatArray


@dataclass(frozen=True)
class ChannelErrors:
    """Errors of one channel, in its unit.

    Attributes:
        unit: SI unit as text.
        mae, rmse: mean absolute and root mean square error over all samples.
        by_log: mean absolute error by run.
        by_joint: mean absolute error by joint, or by axis of the trunk (`x`, `y`, `z`, `roll`, `pitch`).
    """

    unit: str
    mae: float
    rmse: float
    by_log: dict[str, float]
    by_joint: dict[str, float]


@dataclass(frozen=True)
class Series:
    """One joint or axis of one run.

    Attributes:
        t: stamps [s], ascending, shape (T,).
        y: measured, shape (T,).
        residuals: simulated minus measured, shape (T,).
        piece: which piece each sample is of, shape (T,).
    """

    t: FloatArray
    y: FloatArray
    residuals: FloatArray
    piece: IntArray


def errors_by_channel(compared: Sequence[Compared]) -> dict[str, ChannelErrors]:
    """Errors over all that was compared, by channel."""
    found: dict[str, dict[tuple[str, str], FloatArray]] = {}
    for one in compared:
        for group, name in enumerate(one.layout.names):
            channel, label = name.split(" ", 1)
            for run, log in enumerate(one.samples.names):
                part = one.residuals[(one.layout.column == group) & (one.samples.run == run)]
                if part.size:
                    sums = np.array([part.size, np.abs(part).sum(), np.square(part).sum()])
                    found.setdefault(channel, {})[log, _AXES.get(label, label)] = sums
    return {channel: _channel(UNITS[channel], sums) for channel, sums in found.items()}


def _channel(unit: str, sums: Mapping[tuple[str, str], FloatArray]) -> ChannelErrors:
    count, absolute, squares = np.sum(list(sums.values()), axis=0)
    by_log, by_joint = (
        {key: _mean(sums, place, key) for key in dict.fromkeys(pair[place] for pair in sums)} for place in (0, 1)
    )
    return ChannelErrors(unit, float(absolute / count), float(np.sqrt(squares / count)), by_log, by_joint)


def _mean(sums: Mapping[tuple[str, str], FloatArray], place: int, key: str) -> float:
    count, absolute, _ = np.sum([one for pair, one in sums.items() if pair[place] == key], axis=0)
    return float(absolute / count)


def blown_up(compared: Sequence[Compared]) -> int:
    """Pieces whose simulation blew up; their residuals are `robot_residuals.DIVERGED`."""
    return sum(
        int(np.unique(one.samples.piece[_of(one, "position") & (one.residuals == DIVERGED)]).size) for one in compared
    )


def pieces_in(compared: Sequence[Compared]) -> int:
    """Pieces that were compared."""
    return sum(int(np.unique(one.samples.piece).size) for one in compared)


def series(compared: Sequence[Compared], log: str, channel: str, joint: str) -> Series | None:
    """What one joint or axis did in one run; None where it was not compared.

    Args:
        compared: with the run in it.
        log: the run's name.
        channel: such as `position`.
        joint: or axis, as in `ChannelErrors.by_joint`.
    """
    for one in compared:
        labels = [name.split(" ", 1) for name in one.layout.names]
        groups = [i for i, (kind, label) in enumerate(labels) if kind == channel and _AXES.get(label, label) == joint]
        if log in one.samples.names and groups:
            kept = np.isin(one.layout.column, groups) & (one.samples.run == one.samples.names.index(log))
            rows = np.flatnonzero(kept)
            rows = rows[np.argsort(one.samples.t[rows], kind="stable")]
            return Series(one.samples.t[rows], one.samples.y[rows], one.residuals[rows], one.samples.piece[rows])
    return None


def _of(one: Compared, channel: str) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
    groups = [i for i, name in enumerate(one.layout.names) if name.split(" ", 1)[0] == channel]
    return np.isin(one.layout.column, groups)

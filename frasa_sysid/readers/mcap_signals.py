"""Readings of one quantity -> the signal of one run: one clock, one set of joints, one unit."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sampling import make_signal
from frasa_sysid.readers.series import CLOCKS, Block, Columns, Series, Stamps
from frasa_sysid.readers.sources import Unit
from frasa_sysid.recording import LINEAR_UNITS, UNITS, Clock, Fault, FloatArray, Signal


def whole_span(taken: Mapping[str, Sequence[Block]], clock: Clock) -> tuple[int, int]:
    """The first and the last stamp of all that was taken [ns]; none for nothing."""
    found = [block.stamps[:, CLOCKS.index(clock)] for blocks in taken.values() for block in blocks]
    ends = [(int(filled.min()), int(filled.max())) for one in found if (filled := one[one > 0]).size]
    return (min(begin for begin, _ in ends), max(end for _, end in ends)) if ends else (1, 0)


def signal_of(
    name: str,
    series: Series,
    blocks: Sequence[Block],
    clock: Clock,
    window: tuple[int, int],
    units: Mapping[str, str],
    found: list[Fault],
) -> Signal | None:
    """The samples of a run as a signal; None where it has none.

    Args:
        name: of the signal.
        series: it comes from.
        blocks: readings that were taken of it, those with the same columns together.
        clock: whose stamps count.
        window: of the run, by that clock [ns].
        units: as declared for the run, by name.
        found: gets what was wrong.
    """
    place = CLOCKS.index(clock)
    lacking = sum(int((block.stamps[:, place] == 0).sum()) for block in blocks)
    if lacking:
        found.append(Fault("no_stamp", lacking, f"{name}: {lacking} messages without a {clock} stamp; dropped"))
    inside = [_between(block.stamps[:, place], window) for block in blocks]
    counts = [int(rows.sum()) for rows in inside]
    if not any(counts):
        return None
    usual = max(range(len(blocks)), key=lambda i: (counts[i], -int(blocks[i].places[0])))
    block, rows = blocks[usual], inside[usual]
    if sum(counts) > counts[usual]:
        other = sum(counts) - counts[usual]
        found.append(Fault("other_joints", other, f"{name}: {other} messages name other joints than most; dropped"))
    # Subtracted as whole nanoseconds: a float cannot hold an epoch time to the nanosecond.
    whole = bool(rows.all())
    stamps, y = (block.stamps[:, place], block.values) if whole else (block.stamps[rows, place], block.values[rows])
    t = (stamps - np.uint64(window[0])).astype(np.float64) / 1e9
    columns, y = _in_order(series, block.columns, y)
    unit = _unit(name, series.unit, units.get(name))
    signal, faults = make_signal(
        name, unit, t, y[:, 0] if len(columns) == 1 else y, () if len(columns) == 1 else columns
    )
    found += faults
    return signal


def _between(stamps: Stamps, window: tuple[int, int]) -> npt.NDArray[np.bool_]:
    return np.asarray((stamps >= window[0]) & (stamps <= window[1]) & (stamps > 0))


def _in_order(series: Series, columns: Columns, y: FloatArray) -> tuple[Columns, FloatArray]:
    """Columns in the order that most messages have, and their values."""
    alike = [one for one in series.orders if len(one) == len(columns) and set(one) == set(columns)]
    usual = max(alike, key=lambda one: (series.orders[one], -series.firsts[one]))
    return (columns, y) if usual == columns else (usual, y[:, [columns.index(name) for name in usual]])


def _unit(name: str, of_type: str | None, declared: str | None) -> str:
    """The unit that the message type fixes, else the declared one, else the usual one."""
    # JointState is in radians for joints that turn and in metres for those that slide: only the record can say.
    if declared is not None and declared == LINEAR_UNITS.get(name):
        return declared
    if of_type is not None and of_type != "raw":
        return of_type
    return declared or UNITS.get(name, "raw")


def in_radians(signal: Signal, unit: Unit) -> Signal:
    """A signal whose angles were declared to be in degrees, in radians; any other as it is.

    Raises:
        LogError: it is no angle.
    """
    if unit != "deg" or signal.name.split("@")[0] not in ("position", "velocity", "goal", "goal_velocity"):
        return signal
    if signal.unit not in ("rad", "rad/s"):
        raise LogError(f"--unit deg: '{signal.name}' is in [{signal.unit}], which is no angle; leave out --unit")
    return replace(signal, y=np.deg2rad(signal.y))

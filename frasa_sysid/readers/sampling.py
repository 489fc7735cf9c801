"""Faults of sampling, whatever the quantity: NaN, order of time, repeated stamps, gaps, mixed rates."""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from frasa_sysid.recording import Fault, FloatArray, Signal

BoolArray = npt.NDArray[np.bool_]
GAP = 3.0  # times the median period
RATE_WINDOW = 50  # samples over which a rate is judged
RATE_RATIO = 1.25


def plural(count: int, noun: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def make_signal(
    name: str,
    unit: str,
    t: FloatArray,
    y: FloatArray,
    columns: tuple[str, ...] = (),
    blank: BoolArray | None = None,
) -> tuple[Signal | None, list[Fault]]:
    """A signal from raw samples, in order of time and without NaN.

    Args:
        name: of the signal.
        unit: its unit.
        t: sample times [s], shape (T,), in any order.
        y: values, shape (T,) or (T, k).
        columns: names of the k columns.
        blank: samples of which a table has nothing, shape (T,); they are no failed readings.

    Returns:
        The signal, or None when no sample is left, and what was wrong.
    """
    faults: list[Fault] = []
    if blank is not None and blank.any():
        faults.append(_blank(name, int(blank.sum()), blank.size))
        t, y = t[~blank], y[~blank]
    y, columns = _without_dead_columns(name, y, columns, faults)
    bad = ~np.isfinite(t) | ~np.isfinite(y.reshape(t.size, math.prod(y.shape[1:]))).all(axis=1)
    if bad.any():
        faults.append(_not_finite(name, int(bad.sum()), bool(bad.all())))
        t, y = t[~bad], y[~bad]
    backwards = int((np.diff(t) < 0).sum())
    if backwards:
        order = np.argsort(t, kind="stable")
        t, y = t[order], y[order]
        faults.append(
            Fault("time_order", backwards, f"{name}: time ran backwards {plural(backwards, 'time')}; sorted by stamp")
        )
    repeated = np.concatenate([[False], np.diff(t) == 0]) if t.size else np.zeros(0, dtype=bool)
    if repeated.any():
        count = int(repeated.sum())
        t, y = t[~repeated], y[~repeated]
        faults.append(
            Fault(
                "repeated_time",
                count,
                f"{name}: {plural(count, 'sample')} with a time stamp that was there before; dropped",
            )
        )
    return (Signal(name, unit, t, y, columns) if t.size else None), faults


def _blank(name: str, count: int, rows: int) -> Fault:
    what = "the column is empty" if count == rows else "left out, as where a column is slower than the table"
    return Fault("blank", count, f"{name}: blank in {count} of {rows} rows; {what}")


def _not_finite(name: str, count: int, everything: bool) -> Fault:
    what = "no sample is left" if everything else "dropped"
    return Fault("not_finite", count, f"{name}: {plural(count, 'sample')} not finite (NaN or infinity); {what}")


def _without_dead_columns(
    name: str, y: FloatArray, columns: tuple[str, ...], faults: list[Fault]
) -> tuple[FloatArray, tuple[str, ...]]:
    # One joint that never reports must not cost the samples of all the others.
    if y.ndim != 2:
        return y, columns
    alive = np.atleast_1d(np.isfinite(y).any(axis=0))
    if alive.all() or not alive.any():
        return y, columns
    dead = [column for column, lives in zip(columns, alive, strict=True) if not lives]
    faults.append(Fault("dead_joint", len(dead), f"{name}: {', '.join(dead)} never hold a finite value; left out"))
    return y[:, alive], tuple(column for column, lives in zip(columns, alive, strict=True) if lives)


def timing_faults(signals: Mapping[str, Signal]) -> list[Fault]:
    """Gaps and mixed rates, told once for signals that were read together."""
    faults = []
    periods: list[float] = []
    # Signals read together share a rate: the position stands for all of them.
    for name in sorted(signals, key=lambda one: (one != "position", one)):
        t = signals[name].t
        if t.size < 3:
            continue
        period = float(np.median(np.diff(t)))
        if all(abs(period / known - 1) > 0.1 for known in periods):
            periods.append(period)
            faults += [*_gap_fault(name, t), *_rate_fault(name, t)]
    return faults


def _gap_fault(name: str, t: FloatArray) -> list[Fault]:
    dt = np.diff(t)
    median = float(np.median(dt))
    gaps = dt[dt > GAP * median]
    if gaps.size == 0:
        return []
    text = f"{name}: {plural(int(gaps.size), 'gap')}, the longest {gaps.max():.4g} s where {median:.4g} s is usual"
    return [Fault("gap", int(gaps.size), text)]


def _rate_fault(name: str, t: FloatArray) -> list[Fault]:
    dt = np.diff(t)
    windows = dt[: dt.size // RATE_WINDOW * RATE_WINDOW].reshape(-1, RATE_WINDOW)
    if len(windows) < 2:
        return []
    medians = np.median(windows, axis=1)
    if medians.max() / medians.min() <= RATE_RATIO:
        return []
    slow = medians > np.sqrt(medians.max() * medians.min())
    text = (
        f"{name}: sampled at two rates, every {1e3 * np.median(medians[slow]):.2f} ms "
        f"and every {1e3 * np.median(medians[~slow]):.2f} ms; times are kept as they are"
    )
    return [Fault("mixed_rates", int(t.size), text)]

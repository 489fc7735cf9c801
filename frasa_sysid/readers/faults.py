"""The known faults of servo logs: found, handled and reported, the same way for every format.

Each function takes plain arrays or signals and returns what is left of them together
with a `Fault` that says what was found and what was done; nothing is mended silently.
What concerns any signal's stamps and numbers stands in `sampling`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.readers.sampling import plural, timing_faults
from frasa_sysid.recording import Fault, FloatArray, RigFacts, Signal

TURN = 2 * np.pi
# A failed read of a Feetech servo is -2047 counts of 4096; others report -pi itself.
FAILED_READS = (-2047 * TURN / 4096, -np.pi)
FAILED_READ_TOLERANCE = 5e-4  # rad, a third of one count
FAILED_READ_JUMP = 0.5  # rad in one sample; no arm moves that far
LONGEST_FAILURE = 3  # samples in a row
MISSED_SLOT = 1.7  # times the median period
MEAN_TOLERANCE = 1e-5  # rad; far below a count of 4096
WRAP_SLACK = 1.0  # rad of true motion within one sample of a wrap
VOLTAGE_TOLERANCE = 0.1
DEGREES_FROM = 4 * np.pi  # rad; two turns, more than an arm on a bench is ever told to go
SIXTEEN_BIT = ("load", "current", "present_load", "present_current", "present_pwm", "pwm", "effort")


def unique(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Each fault once, the first of its kind and wording: a file remembers what was found when it was made."""
    first: dict[tuple[str, str], Fault] = {}
    for fault in faults:
        first.setdefault((fault.code, fault.message), fault)
    return tuple(first.values())


def clean(signals: Mapping[str, Signal], rig: RigFacts) -> tuple[dict[str, Signal], tuple[Fault, ...]]:
    """Handle and report the known faults of one recording's signals.

    Args:
        signals: by name, as the format gave them.
        rig: the declared facts, to be held against what was measured.

    Returns:
        The signals to use, and the faults found in them.
    """
    result = dict(signals)
    position = result.get("position")
    # What a servo's encoder does wrong concerns angles, not the metres of a linear axis.
    turns = position is not None and position.unit == "rad"
    faults = [
        *(_drop_failed_reads(result) if turns else []),
        *(_drop_averaged_reads(result) if turns else []),
        *(_unwrap_position(result) if turns else []),
        *_make_signed(result),
        *voltage_faults(result, rig),
        *timing_faults(result),
    ]
    return result, tuple(faults)


def failed_reads(position: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which samples are the value a servo gives when a read fails, and no place the arm was.

    Args:
        position: measured position [rad], shape (T,).

    Returns:
        Mask of shape (T,): short runs of exactly that value, far from both neighbours.
    """
    suspect = np.zeros(position.size, dtype=bool)
    for value in FAILED_READS:
        suspect |= np.abs(position - value) < FAILED_READ_TOLERANCE
    edges = np.diff(np.concatenate([[False], suspect, [False]]).astype(np.int8))
    for start, stop in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        neighbours = [position[i] for i in (start - 1, stop) if 0 <= i < position.size]
        far = bool(neighbours) and all(abs(one - position[start]) > FAILED_READ_JUMP for one in neighbours)
        wrapped = far and all(_is_wrap(one - position[start]) for one in neighbours)
        suspect[start:stop] = far and not wrapped and stop - start <= LONGEST_FAILURE
    return suspect


def _is_wrap(jump: float) -> bool:
    return abs(abs(jump) - TURN) < WRAP_SLACK


def _drop_failed_reads(signals: dict[str, Signal]) -> list[Fault]:
    position = signals.get("position")
    if position is None:
        return []
    columns = position.y.reshape(position.t.size, -1)
    failed = np.zeros(position.t.size, dtype=bool)
    for column in columns.T:
        failed |= failed_reads(column)
    if not failed.any() or failed.all():
        return []
    _drop_packets(signals, position.t[failed])
    count = int(failed.sum())
    return [
        Fault(
            "failed_read", count, f"position: {plural(count, 'failed read')} (a lone -3.14 rad); dropped, with velocity"
        )
    ]


def _drop_packets(signals: dict[str, Signal], times: FloatArray) -> None:
    # The velocity of a failed read comes from the same broken packet.
    for name in ("position", "velocity"):
        if name in signals:
            keep = ~np.isin(signals[name].t, times)
            if keep.any():
                signals[name] = replace(signals[name], t=signals[name].t[keep], y=signals[name].y[keep])


def averaged_reads(t: FloatArray, position: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which samples are the mean of the two before, put in by a driver that then missed a slot.

    Before 18 of the 20 missed slots of a public STS3215 bench stands such a sample, up
    to 0.08 rad beside the motion; both signs together are hardly ever there by chance.

    Args:
        t: sample times [s], shape (T,).
        position: measured position [rad], shape (T,).

    Returns:
        Mask of shape (T,).
    """
    mask = np.zeros(t.size, dtype=bool)
    if t.size > 3:
        dt = np.diff(t)
        before, last, here = position[:-3], position[1:-2], position[2:-1]
        mean = (np.abs(2 * here - last - before) < MEAN_TOLERANCE) & (np.abs(last - before) > MEAN_TOLERANCE)
        mask[2:-1] = mean & (dt[2:] > MISSED_SLOT * np.median(dt))
    return mask


def _drop_averaged_reads(signals: dict[str, Signal]) -> list[Fault]:
    position = signals.get("position")
    if position is None or position.columns:
        return []
    averaged = averaged_reads(position.t, position.y)
    if not averaged.any():
        return []
    _drop_packets(signals, position.t[averaged])
    count = int(averaged.sum())
    text = (
        f"position: {plural(count, 'sample')} before a missed slot, the mean of the two before; dropped, with velocity"
    )
    return [Fault("averaged_read", count, text)]


def unwrap(y: FloatArray, period: float = TURN) -> tuple[FloatArray, int]:
    """Undo the jumps of an encoder that starts again after one turn.

    Args:
        y: readings, shape (T,).
        period: one turn, in the unit of `y`.

    Returns:
        Readings without jumps, and how many there were.
    """
    slack = WRAP_SLACK * period / TURN
    step = np.diff(y)
    turns = np.where(np.abs(np.abs(step) - period) < slack, -np.sign(step), 0.0)
    return y + period * np.concatenate([[0.0], np.cumsum(turns)]), int(np.count_nonzero(turns))


def _unwrap_position(signals: dict[str, Signal]) -> list[Fault]:
    position = signals.get("position")
    if position is None:
        return []
    columns = position.y.reshape(position.t.size, -1)
    unwrapped = [unwrap(column) for column in columns.T]
    count = sum(wraps for _, wraps in unwrapped)
    if count == 0:
        return []
    y = np.stack([column for column, _ in unwrapped], axis=1).reshape(position.y.shape)
    signals["position"] = replace(position, y=y)
    return [Fault("encoder_wrap", count, f"position: {plural(count, 'wrap')} of the encoder; unwrapped")]


def _make_signed(signals: dict[str, Signal]) -> list[Fault]:
    faults = []
    for name in SIXTEEN_BIT:
        signal = signals.get(name)
        if signal is None or not _is_unsigned_word(signal.y):
            continue
        wrapped = signal.y >= 2**15
        signals[name] = replace(signal, y=np.where(wrapped, signal.y - 2**16, signal.y))
        count = int(wrapped.sum())
        text = f"{name}: {plural(count, 'negative value')} stored as unsigned 16 bit (65535 for -1); made signed"
        faults.append(Fault("unsigned_load", count, text))
    return faults


def _is_unsigned_word(y: FloatArray) -> bool:
    whole = bool((y == np.round(y)).all())
    return whole and bool((y >= 0).all()) and bool((y < 2**16).all()) and bool((y >= 2**15).any())


def voltage_faults(signals: Mapping[str, Signal], rig: RigFacts) -> list[Fault]:
    """A declared supply that is not the measured one; none where either is not known."""
    measured = signals.get("supply_voltage")
    if measured is None or not rig.supply_voltage:
        return []
    median = float(np.median(measured.y))
    if abs(rig.supply_voltage - median) <= VOLTAGE_TOLERANCE * abs(median):
        return []
    text = f"declared supply {rig.supply_voltage:g} V, measured {median:.4g} V (median); the measured signal counts"
    return [Fault("voltage_contradicted", 1, text)]


def check_radians(signals: Mapping[str, Signal], rig: RigFacts, source: str, form: str) -> None:
    """Refuse a bench log whose goals can only be degrees.

    Only goals are judged, and the position that follows them: a wheel turns
    many times, but nobody commands an arm by a goal two turns away.

    Args:
        signals: by name.
        rig: facts of the rig.
        source: the file.
        form: what `import` calls its format; it is where the unit can be declared.

    Raises:
        LogError: goals beyond two turns.
    """
    goal = signals.get("goal")
    if goal is None or rig.control != "position":
        return
    for name in ("goal", "position"):
        signal = signals.get(name)
        if signal is None or signal.columns or signal.unit != "rad":
            continue
        largest = float(np.abs(signal.y).max())
        if largest > DEGREES_FROM:
            raise LogError(
                f"{source}: {name} looks like degrees: it reaches {largest:.4g}, expected radians; "
                f"say which with 'frasa-sysid import {source} --format {form} --unit deg --out DIR' (--unit rad if it "
                "is radians, of a joint that turns that far)"
            )

"""What several logs say together about one delay: their weighted mean, whether they agree, and by frequency if not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.lag import CHANCE, Lag, Verdict, apart
from frasa_sysid.lag_bands import Agreement, agreement
from frasa_sysid.recording import FloatArray

NORMAL = 1.96  # half of a 95 % interval in standard errors
_BEST: tuple[Verdict, ...] = ("identified", "periodic")
_TURNS = 3  # whole periods that a log's delay may be off, up and down


@dataclass(frozen=True)
class AtFrequency:
    """The delay where the motion of one log has its power.

    Attributes:
        frequency: [Hz].
        delay: phase delay [s].
        low: lower end of the 95 % interval [s].
        high: upper end [s].
        group_delay: slope of the phase from the frequency below to this one [s]; None for the lowest.
        recording: which log.
    """

    frequency: float
    delay: float
    low: float
    high: float
    group_delay: float | None
    recording: str


@dataclass(frozen=True)
class Joint:
    """What all logs say about one pair of channels.

    Attributes:
        joint: empty where the logs name none.
        logs: how many there are.
        used: how many of them the answer rests on.
        delay: weighted mean [s]; None where no log says anything.
        low: lower end of the 95 % interval [s], with what the logs differ by beyond their intervals.
        high: upper end [s].
        agreement: of the logs; None with fewer than two.
        verdict: as for a log.
        reason: in a sentence.
        by_frequency: the delay by frequency, where several logs move at one each.
    """

    joint: str
    logs: int
    used: int
    delay: float | None
    low: float
    high: float
    agreement: Agreement | None
    verdict: Verdict
    reason: str
    by_frequency: tuple[AtFrequency, ...]


def joint_lags(found: Sequence[Lag]) -> list[Joint]:
    """The answer of all logs for each joint, in the order in which joints appear."""
    names = list(dict.fromkeys(one.joint for one in found))
    return [_join(name, [one for one in found if one.joint == name]) for name in names]


def _join(name: str, several: Sequence[Lag]) -> Joint:
    # What a filter does to a sine is a delay, that of its frequency.
    used = [one for one in several if one.verdict in _BEST or (one.verdict == "filter" and one.pure)]
    if not used:
        used = [one for one in several if one.verdict == "known roughly"]
    if not used:
        used = [one for one in several if one.verdict == "filter"]
    if not used:
        return _unsaid(name, several)
    delays, errors = _unwrapped(used)
    by_frequency = _by_frequency(used, delays)
    if len(used) == 1:
        one = used[0]
        return Joint(name, len(several), 1, one.delay, one.low, one.high, None, one.verdict, one.reason, by_frequency)
    together = agreement(delays, errors)
    mean, error = together.mean, together.error
    if together.p < CHANCE:
        # The logs differ by more than they should: the mean of such logs is known accordingly.
        weight = 1.0 / (errors**2 + together.spread**2)
        mean, error = float(weight @ delays / weight.sum()), float(weight.sum() ** -0.5)
    verdict, reason = _judge(used, together, by_frequency)
    half = NORMAL * error
    return Joint(name, len(several), len(used), mean, mean - half, mean + half, together, verdict, reason, by_frequency)


def _judge(used: Sequence[Lag], together: Agreement, by_frequency: Sequence[AtFrequency]) -> tuple[Verdict, str]:
    test = f"chi-square {together.chi2:.1f} for {together.dof} (p = {together.p:.2g})"
    if apart(together):
        why = f"the logs disagree, {test}, by {1e3 * together.spread:.2f} ms (standard deviation)"
        if len(by_frequency) > 1:
            first, last = by_frequency[0], by_frequency[-1]
            why += (
                f": {1e3 * first.delay:.2f} ms at {first.frequency:.1f} Hz, "
                f"{1e3 * last.delay:.2f} ms at {last.frequency:.1f} Hz: a filter, not one delay"
            )
        return "filter", why
    words = "agree" if together.p >= CHANCE else f"agree to {1e3 * together.spread:.2f} ms, not to their intervals"
    if all(one.verdict == "filter" for one in used):
        return "filter", f"the logs {words}, {test}; but {used[0].reason}"
    if all(one.verdict == "known roughly" for one in used):
        return "known roughly", f"the logs {words}, {test}"
    return "identified", f"the logs {words}, {test}"


def _unsaid(name: str, several: Sequence[Lag]) -> Joint:
    slow = [one for one in several if one.verdict == "too slow"]
    best = min(slow or several, key=lambda one: one.half_width if one.delay is not None else np.inf)
    return Joint(
        name, len(several), 0, best.delay if slow else None, best.low, best.high, None, best.verdict, best.reason, ()
    )


def _unwrapped(used: Sequence[Lag]) -> tuple[FloatArray, FloatArray]:
    """Delays and errors; of logs that repeat themselves the period is taken that fits the others."""
    delays = np.array([one.delay for one in used], dtype=np.float64)
    errors = np.array([max(one.half_width / NORMAL, 1e-9) for one in used])
    open_ones = [i for i, one in enumerate(used) if one.verdict == "periodic" and one.frequency > 0.0]
    sure = [i for i in range(len(used)) if i not in open_ones]
    # Without a log that is sure, the one that repeats itself most slowly is taken at its shortest delay.
    anchor = delays[sure] if sure else delays[[min(open_ones, key=lambda i: used[i].frequency)]]
    centre = float(np.median(anchor))
    for i in open_ones:
        period = 1.0 / used[i].frequency
        turns = np.clip(np.round((centre - delays[i]) / period), -_TURNS, _TURNS)
        delays[i] += turns * period
    return delays, errors


def _by_frequency(used: Sequence[Lag], delays: FloatArray) -> tuple[AtFrequency, ...]:
    order = sorted((i for i, one in enumerate(used) if one.pure), key=lambda i: used[i].frequency)
    frequencies = np.array([used[i].frequency for i in order])
    if len(order) < 2 or not (np.diff(frequencies) > 0.2 * frequencies[:-1]).all():
        return ()
    rows: list[AtFrequency] = []
    for k, i in enumerate(order):
        f, d = used[i].frequency, float(delays[i])
        before = rows[-1] if rows else None
        group = None if before is None else (f * d - before.frequency * before.delay) / (f - before.frequency)
        half = used[i].half_width
        rows.append(AtFrequency(float(frequencies[k]), d, d - half, d + half, group, used[i].recording))
    return tuple(rows)

"""The delay of one channel of a log against another: value, interval, verdict, and what it is at each frequency.

What is called a delay may be something else: the verdict says which.

==================  ==================================================================================================
identified          one delay explains the log, and is known
known roughly       likewise, but to no better than a tenth, or a millisecond
filter              it is not the same at all frequencies, or amplitudes change: a filter, a control loop, or slip
periodic            known but for whole periods: the motion repeats itself
too slow            a sample takes too long; the interval is half a sampling period at least
not excited         the channels hardly move, or one does not explain the other
wrong sign          one is the other's negative
out of range        no delay inside the limits of the search does best
==================  ==================================================================================================
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.lag_bands import Agreement, Band, agreement, bands
from frasa_sysid.lag_channels import Pair, pairs
from frasa_sysid.lag_fit import Fitted, fit_delay, refit
from frasa_sysid.lag_reference import main_frequency, purity
from frasa_sysid.recording import FloatArray, Recording

Verdict = Literal[
    "identified", "known roughly", "filter", "periodic", "too slow", "not excited", "wrong sign", "out of range"
]
LONGEST = 0.25  # [s] that is searched, in both directions
SLOW = 0.045  # [s] a sampling period from which on half of it is the least that the interval is
ROUGH = (0.001, 0.1)  # [s] and share of the delay, up to which a half interval counts as known
PURE = 0.8  # of the power at one frequency makes a motion a sine ...
CYCLES = 3.0  # ... if there are so many
EXPLAINED = 0.8  # of the variance of a channel, or the other is not where it comes from
RATIO = 0.1  # amplitude ratio that may be missing, or differ between frequencies
SAME = (3e-4, 0.05)  # [s] and share of the delay, up to which delays of frequencies count as the same
CHANCE = 0.01  # below which estimates are said to disagree
_BACK = 0.25  # of its extent that a motion must come back
_LOOKED_AT = 4000  # samples of a motion, to see whether it turns back
BELOW = 2.0  # amplitude ratios of bands are compared up to this many times the main frequency


@dataclass(frozen=True)
class Lag:
    """What one log says about the delay of one pair of channels.

    Attributes:
        recording: its name.
        joint: empty where the log names none.
        delay: how much later the channel is [s]; None where nothing can be said.
        low: lower end of the 95 % interval [s].
        high: upper end [s].
        ratio: amplitude of the late channel over the other.
        explained: share of the late channel's variance that the other one explains.
        frequency: where most of the motion's power is [Hz].
        pure: most of the motion's power is at that frequency: what is found is the delay there, even of a filter.
        period: sampling period of the slower channel [s].
        bands: the delay by frequency.
        agreement: of the bands; None with fewer than two.
        others: delays that explain the log as well [s].
        verdict: see the table of this module.
        reason: why, in a sentence.
        held: half a period of the goal, if the other channel is a goal [s]: a goal that is held from sample to sample
            is that much older, on average, than one that moves on between samples, as the delay takes it.
    """

    recording: str
    joint: str
    delay: float | None
    low: float
    high: float
    ratio: float
    explained: float
    frequency: float
    pure: bool
    period: float
    bands: tuple[Band, ...]
    agreement: Agreement | None
    others: tuple[float, ...]
    verdict: Verdict
    reason: str
    held: float | None = None

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval [s]."""
        return (self.high - self.low) / 2


def lags(
    recordings: Sequence[Recording], of: str, against: str, joint: str | None = None, longest: float = LONGEST
) -> list[Lag]:
    """The delay in each log, for each joint.

    Args:
        recordings: the logs.
        of: the channel that is late, `SIGNAL` or `SIGNAL.COLUMN`.
        against: the channel it is held against.
        joint: only that one.
        longest: largest delay that is tried, in both directions [s].

    Raises:
        LogError: a channel that is not there, or units that do not go together.
    """
    return [
        lag_of(recording, pair, longest) for recording in recordings for pair in pairs(recording, of, against, joint)
    ]


def lag_of(recording: Recording, pair: Pair, longest: float = LONGEST) -> Lag:
    """The delay of one pair of channels in one log; never raises, a log that says nothing has a verdict too."""
    try:
        t, y, x = pair.arrays()
        fitted = fit_delay(t, y, x, (-longest, longest))
    except LogError as error:
        return _nothing(recording, pair, str(error))
    unsettled = _unsettled(pair, t, y, fitted)
    motion = x.value(t)
    frequency = main_frequency(t, motion)
    by_band = tuple(bands(t, y, x, fitted.delay)) if fitted.explained > EXPLAINED else ()
    together = None
    if len(by_band) > 1:
        together = agreement(*(np.array([getattr(one, name) for one in by_band]) for name in ("delay", "error")))
    verdict, reason = _judge(pair, fitted, by_band, together, frequency, unsettled)
    if verdict in ("identified", "known roughly") and _one_way(motion):
        verdict, reason = "not excited", "the motion goes one way only: a delay and a filter look alike in it"
    half = max(fitted.half_width + unsettled, _period(pair) / 2 if verdict == "too slow" else 0.0)
    sign = -1.0 if pair.turned else 1.0
    ends = sorted((sign * (fitted.low - half), sign * (fitted.high + half)))
    return Lag(
        recording=recording.name,
        joint=pair.joint,
        delay=sign * fitted.delay,
        low=ends[0],
        high=ends[1],
        ratio=1.0 / fitted.ratio if pair.turned and fitted.ratio else fitted.ratio,
        explained=fitted.explained,
        frequency=frequency,
        pure=frequency * float(t[-1] - t[0]) >= CYCLES and purity(t, motion) > PURE,
        period=_period(pair),
        bands=tuple(_turn(one) for one in by_band) if pair.turned else by_band,
        agreement=together,
        others=tuple(sorted(sign * one for one in fitted.others)),
        verdict=verdict,
        reason=reason,
        held=pair.against.period / 2 if pair.against.signal.name.startswith("goal") else None,
    )


def _unsettled(pair: Pair, t: FloatArray, y: FloatArray, fitted: Fitted) -> float:
    """What sampling may have moved the delay by [s]: as much as taking every second sample moves it.

    Between samples a motion is not known. Where it is as fast as they are, what is put there leans, by how the delay
    falls between samples, and the blocks of a log all lean alike.
    """
    if fitted.explained < EXPLAINED or fitted.at_edge:
        return 0.0
    try:
        again = [refit(t, y, x, fitted.delay, pair.against.period) for x in pair.thinned()]
    except LogError:
        return 0.0
    return max((abs(one - fitted.delay) for one in again if one is not None), default=0.0)


def _one_way(motion: FloatArray) -> bool:
    """Whether a motion (T,) has one transient, or none, in one direction."""
    stride = -(-motion.size // _LOOKED_AT)
    values = motion[::stride].tolist()
    enough = _BACK * (max(values) - min(values))
    direction, low, high = 0, values[0], values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
        turned = -1 if high - value > enough else 1 if value - low > enough else 0
        if turned and turned != direction:
            if direction:
                return False
            direction, low, high = turned, value, value
        elif turned:
            # It goes on: what counts from here is how far it comes back.
            low, high = value, value
    return True


def _period(pair: Pair) -> float:
    return max(pair.of.period, pair.against.period)


def _nothing(recording: Recording, pair: Pair, why: str) -> Lag:
    nan = float("nan")
    return Lag(
        recording.name,
        pair.joint,
        None,
        nan,
        nan,
        nan,
        0.0,
        0.0,
        False,
        _period(pair),
        (),
        None,
        (),
        "not excited",
        why,
    )


def _turn(band: Band) -> Band:
    return Band(band.frequency, -band.delay, band.error, 1.0 / band.ratio, band.ratio_error / band.ratio**2)


def _judge(
    pair: Pair,
    fitted: Fitted,
    by_band: Sequence[Band],
    together: Agreement | None,
    frequency: float,
    unsettled: float,
) -> tuple[Verdict, str]:
    if _period(pair) >= SLOW:
        best = f"a delay is known to about half a sample period at best, {1e3 * _period(pair) / 2:.0f} ms"
        return "too slow", f"{1 / _period(pair):.0f} Hz: {best}; record at 50 Hz or more"
    if fitted.inverted:
        return "wrong sign", "a negative ratio explains it better: the sign of one of the channels is wrong"
    if fitted.explained < EXPLAINED:
        return "not excited", f"only {100 * max(fitted.explained, 0.0):.0f} % of one is explained by the other"
    if fitted.at_edge:
        return "out of range", "no delay inside the limits of the search does best; see --longest"
    if fitted.others:
        others = ", ".join(f"{1e3 * one:.0f}" for one in fitted.others)
        return "periodic", f"the motion repeats itself at {frequency:.2f} Hz: {others} ms would do as well"
    if together is not None and apart(together):
        return "filter", f"not the same at all frequencies: {spread_words(by_band)}"
    if pair.comparable and abs(fitted.ratio - 1.0) > RATIO:
        return "filter", f"the amplitude is {fitted.ratio:.2f} of the other's: more than a delay, or a wrong scale"
    if _uneven(by_band, frequency):
        return "filter", "a delay alone would leave amplitudes the same at all frequencies"
    if fitted.half_width + unsettled + (fitted.high - fitted.low) / 2 > max(ROUGH[0], ROUGH[1] * abs(fitted.delay)):
        return "known roughly", "the interval is wide: a longer, faster or less noisy log would help"
    return "identified", "one delay explains it"


def apart(found: Agreement) -> bool:
    """Whether estimates disagree by more than chance, and by more than matters."""
    return found.p < CHANCE and found.spread > max(SAME[0], SAME[1] * abs(found.mean))


def spread_words(by_band: Sequence[Band]) -> str:
    """The delay at the lowest and at the highest frequency."""
    first, last = by_band[0], by_band[-1]
    return (
        f"{1e3 * first.delay:.2f} ms at {first.frequency:.1f} Hz, {1e3 * last.delay:.2f} ms at {last.frequency:.1f} Hz"
    )


def _uneven(by_band: Sequence[Band], frequency: float) -> bool:
    near = [one for one in by_band if one.frequency <= BELOW * frequency]
    if len(near) < 2:
        return False
    ratios = np.array([one.ratio for one in near])
    errors = np.array([one.ratio_error for one in near])
    found = agreement(ratios, errors)
    return found.p < CHANCE and found.spread > RATIO

"""Which channel of a recording is held against which, and as what: by name, column and unit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.lag_reference import (
    FEWEST,
    Reference,
    Relation,
    main_frequency,
    reference,
    smooth,
    window_mean,
)
from frasa_sysid.recording import FloatArray, Recording, Signal

RATES = {"rad": "rad/s", "m": "m/s"}
_WINDOW = 2.0  # sampling periods over which the slope of a position is taken at least ...
_NOISE = 0.03  # ... and so many that its noise is this share of the velocity ...
_OF_PERIOD = 0.2  # ... but no more than this share of the motion's period ...
_OF_LOG = 0.05  # ... and this of the log


@dataclass(frozen=True)
class Channel:
    """One column of a signal.

    Attributes:
        signal: it belongs to.
        y: values, shape (T,).
        label: the column's name; empty where the signal has but one.
    """

    signal: Signal
    y: FloatArray
    label: str

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.signal.t))) if self.signal.t.size > 1 else np.inf


@dataclass(frozen=True)
class Pair:
    """Two channels that one delay is asked of.

    Attributes:
        joint: they belong to; empty where the log names none.
        of: the channel that is late.
        against: the channel it is late against.
        relation: `same` quantity, or `derivative` of it.
        turned: the roles were exchanged, because only a slope can be taken of the other: the delay changes its sign.
    """

    joint: str
    of: Channel
    against: Channel
    relation: Relation
    turned: bool

    @property
    def comparable(self) -> bool:
        """Whether both units are known, so that their ratio should be 1."""
        return "raw" not in (self.of.signal.unit, self.against.signal.unit)

    def arrays(self) -> tuple[FloatArray, FloatArray, Reference]:
        """Times and values (T,) of the late channel, and the other as a function of time.

        Raises:
            LogError: too few samples.
        """
        window = self._window() if self.relation == "derivative" else 0.0
        x = reference(self.against.signal, self.against.y, window)
        if self.of.signal.t.size < 2:
            raise LogError(f"'{self.of.signal.name}' has a single sample")
        t, y, good = window_mean(self.of.signal.t, self.of.y, window)
        return t[good], y[good], x

    def thinned(self) -> list[Reference]:
        """The other channel by every second of its samples, in both ways there are: what finer motion may hide.

        Raises:
            LogError: too few samples.
        """
        window = self._window() if self.relation == "derivative" else 0.0
        whole = self.against.signal
        halves = [Signal(whole.name, whole.unit, whole.t[i::2], self.against.y[i::2]) for i in (0, 1)]
        return [reference(one, one.y, window) for one in halves]

    def _window(self) -> float:
        """Over which the slope of the position is taken [s]: as long as its noise asks for and its motion allows."""
        t, q = self.against.signal.t, self.against.y
        shortest = _WINDOW * max(self.of.period, self.against.period)
        if t.size < FEWEST or self.of.signal.t.size < FEWEST:
            return shortest
        noise = float(np.std(q - smooth(t, q)(t)))
        frequency = main_frequency(self.of.signal.t, self.of.y)
        longest = min(_OF_PERIOD / frequency, _OF_LOG * float(np.ptp(t))) if frequency > 0.0 else shortest
        asked = np.sqrt(2.0) * noise / (_NOISE * max(float(np.std(self.of.y)), 1e-12))
        return float(max(shortest, min(asked, longest)))


def pairs(recording: Recording, of: str, against: str, joint: str | None = None) -> list[Pair]:
    """The pairs of channels of a recording, one a joint.

    Args:
        recording: the log.
        of: signal that is late, such as `velocity`, or one column of it: `gyro.z`.
        against: likewise, what it is held against.
        joint: only that one.

    Raises:
        LogError: no such signal or column, units that have nothing to do with each other, or no joint in common.
    """
    late, early = _channels(recording, of, joint), _channels(recording, against, joint)
    relation, turned = _relation(recording, late[0].signal, early[0].signal)
    matched = _match(recording, late, early)
    told = recording.extra.get("joint")  # of a log of one joint, whose signals have no columns
    name = told if isinstance(told, str) else ""
    if turned:
        return [Pair(a.label or b.label or name, b, a, relation, True) for a, b in matched]
    return [Pair(a.label or b.label or name, a, b, relation, False) for a, b in matched]


def _channels(recording: Recording, name: str, joint: str | None) -> list[Channel]:
    column = ""
    if name not in recording.signals and "." in name:
        name, column = name.rsplit(".", 1)
    signal = recording.signal(name)
    if not signal.columns:
        if column:
            raise LogError(f"{recording.name}: '{name}' has one channel, none is called '{column}'")
        return [Channel(signal, signal.y, "")]
    wanted = column or (joint if joint is not None and signal.columns != ("x", "y", "z") else "")
    if wanted and wanted not in signal.columns:
        raise LogError(f"{recording.name}: '{name}' has no column '{wanted}'; it has {', '.join(signal.columns)}")
    # A column that was asked for by name may be held against one of another name.
    return [
        Channel(signal, signal.y[:, i], "" if column else label)
        for i, label in enumerate(signal.columns)
        if label == wanted or not wanted
    ]


def _relation(recording: Recording, late: Signal, early: Signal) -> tuple[Relation, bool]:
    if "raw" in (late.unit, early.unit) or late.unit == early.unit:
        # Of goal and measurement the goal is the one without noise, whichever is asked for.
        return "same", late.name.startswith("goal") and not early.name.startswith("goal")
    if RATES.get(early.unit) == late.unit:
        return "derivative", False
    if RATES.get(late.unit) == early.unit:
        return "derivative", True
    raise LogError(
        f"{recording.name}: '{late.name}' [{late.unit}] against '{early.name}' [{early.unit}]: expected the same "
        "unit, or one the derivative of the other"
    )


def _match(recording: Recording, late: Sequence[Channel], early: Sequence[Channel]) -> list[tuple[Channel, Channel]]:
    if len(late) == len(early) == 1 and "" in (late[0].label, early[0].label):
        return [(late[0], early[0])]
    by_label = {one.label: one for one in early}
    matched = [(one, by_label[one.label]) for one in late if one.label in by_label]
    if not matched:
        a, b = (", ".join(one.label or "one channel" for one in group) for group in (late, early))
        raise LogError(f"{recording.name}: nothing to compare: {a} against {b}; name one column as SIGNAL.COLUMN")
    return matched

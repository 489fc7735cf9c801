r"""How old a reading is: what the duty beside the position says about it, without any simulation.

Let a goal act d after its stamp (command delay), and a position be r_q old at its stamp (read-out delay), a
duty r_u. With the true angle theta the log holds :math:`q(t) = \theta(t - r_q)`, and a goal of time t acts at
t + d. Nothing else depends on time, so goal and position alone show :math:`d + r_q` and no more. The firmware
makes the duty from its own fresh angle (`servo`), and so

.. math::
    u(t) = a (g(t - L_g) - q(t - L_q)) + b, \qquad L_g = d + r_u, \quad L_q = r_u - r_q

The three delays are seen as two differences: L_q, how much older a duty is than the position beside it, and
:math:`L_g - L_q = d + r_q`, the sum again. All three follow where one of them is known otherwise. r_u is the age
of the angle behind the duty, so half a period of the firmware's loop belongs to it.

Friction, load and physics step do not come in: u, g and q are measured; a is the firmware's gain times one number
for all runs, which comes out too, and b belongs to each piece of a run. What looks alike: a D gain shortens both
lags by D / P and leaves their difference, so L_q must be the same at every P; and a back-EMF changes L_q, so a
measured current tells nothing where the firmware asks for duty. A duty simulated from the fit would say less: it is
e P times as far off as the simulated angle (on the XL330's logs about 20 to 50 times what the measured one leaves).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from frasa_sysid.loop_lags import FIRMWARE, FULL, Lags, Limits, pieces_of
from frasa_sysid.recording import FloatArray, Recording

SUM_ONLY = "command delay and read-out delay are known as a sum only"
NO_DUTY = "no duty was recorded beside the position (the present PWM would be one)"
RECORD = "the present PWM (duty) with every position, in fast motion (sin_time_square) below saturation"
PUBLISHED = "the delay that is fitted and published is their sum"
SEPARATED = "separated"
_GOAL_LAGS, _POSITION_LAGS = (-0.02, 0.06), (-0.02, 0.02)  # [s] that are searched
_COARSE = 5e-4  # [s]
_POINTS = 101  # of the second, finer look along each lag
_ROUNDS = 3  # of weighing samples anew
_FOLLOWS = 0.98  # share of the duty's variance that the law must explain to be the firmware's
_LEAST = 1e-4  # [s] half of the narrowest interval of a difference: what a bench in step with the firmware leaves
_SLOWEST = 1000.0  # [ms] of an exchange on a bus
_KNOWN = 0.002  # [s] width of an interval up to which the difference counts as told
LONGEST_AGE = 0.1  # [s] that anybody may declare

Estimate = tuple[float, float, float]  # best, low, high


@dataclass(frozen=True)
class Readout:
    """What logs say about the ages of their channels; a number is None where they do not say it.

    Attributes:
        verdict: `separated`, or `sum only`.
        reason: why.
        difference: L_q, age of the duty over that of the position [s], with its 95 % interval.
        goal_lag: 95 % interval of L_g [s]; goals and readings of one loop keep step, so it is often a cycle wide.
        total: 95 % interval of command plus read-out delay [s], by the duty alone.
        loop_gain: duty per radian and unit of firmware gain, `Servo.error_gain` as measured.
        explained: share of the duty's variance that the loop explains.
        duty_age: age of the duty [s] that somebody declared.
        bus_age: how far from its stamp a position can have been read [s], by the stamps around the exchange.
    """

    verdict: str
    reason: str
    difference: Estimate | None = None
    goal_lag: Limits | None = None
    total: Limits | None = None
    loop_gain: float | None = None
    explained: float | None = None
    duty_age: float | None = None
    bus_age: float | None = None

    @property
    def position_age(self) -> Estimate | None:
        """Read-out delay of the position alone [s], with its interval: with a declared age of the duty only."""
        if self.difference is None or self.duty_age is None:
            return None
        best, low, high = self.difference
        return self.duty_age - best, self.duty_age - high, self.duty_age - low

    @property
    def command_delay(self) -> Limits | None:
        """Interval of the command delay alone [s]: with a declared age of the duty only."""
        if self.goal_lag is None or self.duty_age is None:
            return None
        return self.goal_lag[0] - self.duty_age, self.goal_lag[1] - self.duty_age

    def words(self) -> str:
        """What is known and what is not, for people."""
        if self.difference is None or self.total is None:
            text = f"{SUM_ONLY}: {self.reason}; {PUBLISHED}"
        else:
            best, low, high = self.difference
            way = "older" if best >= 0.0 else "newer"
            ends = sorted((low if best >= 0.0 else -high, high if best >= 0.0 else -low))
            text = (
                f"a duty is {1e3 * abs(best):.2f} ms {way} than the position beside it ({_ms(*ends)}), command and "
                f"read-out delay together are {_ms(*self.total)} by the duty alone; {PUBLISHED}"
            )
            text += "" if self.duty_age is not None else "; its two parts need the age of one channel (--duty-age)"
        if self.position_age is not None and self.command_delay is not None:
            text += (
                f"; with a duty {_ms(self.duty_age or 0.0)} old, a position is {_ms(self.position_age[0])} old "
                f"({_ms(*self.position_age[1:])}) and a goal acts {_ms(*self.command_delay)} after its stamp"
            )
        if self.bus_age is not None:
            text += f"; by its exchange a position was read within {_ms(self.bus_age)} of its stamp"
        return text

    def to_json(self) -> dict[str, Any]:
        """Plain data; times in seconds."""
        names = [one.name for one in fields(self) if one.name not in ("verdict", "reason")]
        found = {name: getattr(self, name) for name in (*names, "position_age", "command_delay")}
        known = {name: list(one) if isinstance(one, tuple) else one for name, one in found.items() if one is not None}
        return {"verdict": self.verdict, "words": self.words(), **known}


def disagreement(readout: Readout, fitted: Limits, step: float) -> str:
    """Says that a fitted delay is not the one that the duty shows; empty where it is, or where the duty shows none.

    Args:
        readout: what the logs say.
        fitted: 95 % interval of the delay of a fit on them [s].
        step: of its physics [s]; MuJoCo's own delay holds about half of one.
    """
    if readout.total is None:
        return ""
    low, high = readout.total
    if fitted[0] - step <= high and low <= fitted[1]:
        return ""
    return (
        f"the fitted delay ({_ms(*fitted)}) is not what the duty shows ({_ms(low, high)}): "
        "it makes up for something that the model of the servo lacks"
    )


def separate(recordings: Sequence[Recording], duty_age: float | None = None) -> Readout:
    """What the recordings of one servo say about the ages of their channels.

    Args:
        recordings: those without a duty are not looked at.
        duty_age: age of the angle behind a logged duty at its stamp, where somebody knows it [s].
    """
    bus_age = _bus_age(recordings)
    usable = [one for one in recordings if _has_loop(one)]
    if not usable:
        return _sum_only(NO_DUTY, bus_age)
    most = max(float(np.abs(one.signals["duty"].y).max()) for one in usable)
    if most > FULL:
        return _sum_only(f"the duty reaches {most:.4g}, expected -1 to 1", bus_age)
    pieces = pieces_of(usable, _GOAL_LAGS, _POSITION_LAGS)
    if not pieces:
        return _sum_only("the duty is too short, still or saturated throughout", bus_age)
    lags = Lags(pieces, _spaced(_GOAL_LAGS), _spaced(_POSITION_LAGS))
    if lags.explained < _FOLLOWS:
        reason = f"the duty is no gain times the error (that explains {100 * lags.explained:.0f} % of it)"
        return _sum_only(reason, bus_age, lags.explained)
    for _ in range(_ROUNDS):
        lags.reweigh(*lags.best)
    goal, position = (_closer(one) for one in lags.accepted())
    # With weights made on the coarse lags: made anew on fine ones they would favour the pair they were made at.
    return _told(Lags(pieces, goal, position, lags.weights), len(pieces), duty_age, bus_age)


def _sum_only(
    reason: str, bus_age: float | None, explained: float | None = None, loop_gain: float | None = None
) -> Readout:
    return Readout("sum only", reason, loop_gain=loop_gain, explained=explained, bus_age=bus_age)


def _told(lags: Lags, pieces: int, duty_age: float | None, bus_age: float | None) -> Readout:
    """The best pair with its intervals, which the firmware's period bounds from below.

    A goal waits for the next tick, and a loop that keeps step with the firmware always as long: half a period
    either way stands for what the logs then cannot average out; for the difference `_LEAST` does.
    """
    j, k = lags.best
    goal, position = lags.accepted()
    best, tick = float(lags.position[k]), 0.5 * FIRMWARE
    loop_gain = float(lags.gain[j, k])
    if np.ptp(position) > _KNOWN:
        reason = f"the motion is too slow for the duty, which tells {_ms(float(position.min()), float(position.max()))}"
        return _sum_only(reason, bus_age, lags.explained, loop_gain)
    return Readout(
        SEPARATED,
        f"the duty is a gain times the error, in {pieces} pieces of runs",
        (best, min(float(position.min()), best - _LEAST), max(float(position.max()), best + _LEAST)),
        (float(goal.min()) - tick, float(goal.max()) + tick),
        (float((goal - position).min()) - tick, float((goal - position).max()) + tick),
        loop_gain,
        lags.explained,
        duty_age,
        bus_age,
    )


def _has_loop(recording: Recording) -> bool:
    names = ("goal", "position", "duty")
    known = all(name in recording.signals and not recording.signals[name].columns for name in names)
    return known and recording.rig.control == "position"


def _bus_age(recordings: Sequence[Recording]) -> float | None:
    """Half of the longest exchange [s], where every log says how long its exchanges take."""
    clocks = [one.extra.get("clock") for one in recordings]
    times = [clock.get("exchange_ms") if isinstance(clock, dict) else None for clock in clocks]
    known = [one for one in times if isinstance(one, int | float) and 0.0 <= one <= _SLOWEST]
    return 0.5e-3 * max(known) if known and len(known) == len(recordings) else None


def _spaced(limits: Limits) -> FloatArray:
    return np.linspace(*limits, round((limits[1] - limits[0]) / _COARSE) + 1)


def _closer(accepted: FloatArray) -> FloatArray:
    """Finer lags over what was accepted and one coarse step beyond [s]."""
    return np.linspace(accepted.min() - _COARSE, accepted.max() + _COARSE, _POINTS)


def _ms(*seconds: float) -> str:
    return " to ".join(f"{1e3 * one:.2f}" for one in seconds) + " ms"

"""The firmware's own loop in a log: how well a gain times the error makes the duty, for every pair of lags.

Least squares on measured signals, with nothing simulated; `readout` says what the lags mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.interpolate import BSpline, make_lsq_spline

from frasa_sysid.recording import FloatArray, Recording, Signal

FIRMWARE = 1e-3  # [s] period of the firmware's loop
FULL = 1.02  # a duty beyond this is in another unit
_SATURATED = 0.95  # of full duty from which on it says nothing about the error
_FEWEST = 100  # samples of a piece ...
_SHORTEST = 2.0  # [s] ... and its length; a piece with less is no witness of its own
_MOST = 4000  # samples of a piece; of more every second, third ... one
_MOST_RUNS = 100  # that are looked at; of more every second, third ... one
_PIECES = 8  # that the runs are cut into, where they are long enough
_FEWEST_POSITIONS = 16  # of a run that a spline is drawn through
_ROBUST = 3.0  # median residuals from which on a sample counts little
_NOISELESS = 1e-12  # share of a variance that counts as none
_ROUNDING = 1e-9  # of the cost

Mask = np.ndarray[tuple[int], np.dtype[np.bool_]]
Limits = tuple[float, float]


@dataclass(frozen=True)
class Piece:
    """Part of a run in which the firmware's loop was at work.

    Attributes:
        t: times of the duty [s], shape (n,).
        duty: shape (n,).
        goal: held from each sample to the next [rad].
        position: of the whole run [rad].
        gain: firmware gain of the run, or 1 where it is not known.
    """

    t: FloatArray
    duty: FloatArray
    goal: Signal
    position: Signal
    gain: float

    @cached_property
    def angle(self) -> BSpline:
        """The measured angle between the samples [rad]: a cubic spline with one piece for two samples.

        A line through every sample is noisy at the samples and smooth between them, so lags between
        samples would look better for that alone.
        """
        t = self.position.t
        return make_lsq_spline(t, self.position.y, np.r_[[t[0]] * 4, t[3:-3:2], [t[-1]] * 4], k=3)

    def goal_at(self, t: FloatArray) -> FloatArray:
        """Goal averaged over a firmware period around each time [rad]: in which tick it arrived is not known."""
        goal = self.goal
        total = np.concatenate([[0.0], np.cumsum(goal.y[:-1] * np.diff(goal.t))])

        def until(times: FloatArray) -> FloatArray:
            last = np.maximum(np.searchsorted(goal.t, times, side="right") - 1, 0)
            return np.asarray(total[last] + goal.y[last] * (times - goal.t[last]))

        return (until(t + 0.5 * FIRMWARE) - until(t - 0.5 * FIRMWARE)) / FIRMWARE


def pieces_of(recordings: Sequence[Recording], goal_lags: Limits, position_lags: Limits) -> list[Piece]:
    """Runs cut into pieces, so that there are several to compare; only where the loop was at work.

    Args:
        recordings: each with goal, position and duty of one joint.
        goal_lags: shortest and longest lag that will be tried [s]: there must be samples for all of them.
        position_lags: likewise.
    """
    recordings = recordings[:: -(-len(recordings) // _MOST_RUNS)]
    whole = sum(one.signals["duty"].t[-1] - one.signals["duty"].t[0] for one in recordings)
    length = max(whole / max(_PIECES, len(recordings)), _SHORTEST)
    found = []
    for one in recordings:
        goal, position, duty = (one.signals[name] for name in ("goal", "position", "duty"))
        if position.t.size < _FEWEST_POSITIONS:
            continue
        inside = (duty.t > position.t[0] + position_lags[1]) & (duty.t < position.t[-1] + position_lags[0])
        inside &= (duty.t > goal.t[0] + goal_lags[1]) & (np.abs(duty.y) < _SATURATED)
        for lag in goal_lags:
            inside &= _powered(one, duty.t - lag)
        count = max(int((duty.t[-1] - duty.t[0]) / length), 1)
        for part in np.array_split(np.flatnonzero(inside), count):
            if part.size >= _FEWEST and np.ptp(duty.y[part]) > 0.0:
                part = part[:: -(-part.size // _MOST)]
                found.append(Piece(duty.t[part], duty.y[part], goal, position, one.rig.firmware_gain or 1.0))
    return found


def _powered(recording: Recording, t: FloatArray) -> Mask:
    enable = recording.signals.get("torque_enable")
    if enable is None:
        return np.ones(t.size, bool)
    return np.asarray(enable.y[np.maximum(np.searchsorted(enable.t, t, side="right") - 1, 0)] > 0.5)


@dataclass(frozen=True)
class _Design:
    """Signals of one piece at every lag: goals (n, J), positions (n, K), duty (n,) and weights that sum to 1 (n,)."""

    goals: FloatArray
    positions: FloatArray
    duty: FloatArray
    weight: FloatArray

    def products(self) -> tuple[float, FloatArray, FloatArray]:
        """Mean products of duty and duty, duty and error (J, K), error and error (J, K), centred.

        They are all that least squares needs, at every pair of lags at once.
        """
        w = self.weight
        G, Q, u = self.goals - w @ self.goals, self.positions - w @ self.positions, self.duty - w @ self.duty
        slope = ((w * u) @ G)[:, None] - (w * u) @ Q
        error = (w @ G**2)[:, None] + w @ Q**2 - 2.0 * (w[:, None] * G).T @ Q
        return float(w @ u**2), slope, error

    def reweighted(self, j: int, k: int) -> "_Design":
        """The same with little weight for samples off the law: those beside a goal's step, whichever tick had it."""
        error = self.goals[:, j] - self.positions[:, k]
        level, slope = np.polynomial.polynomial.polyfit(error, self.duty, 1, w=np.sqrt(self.weight))
        off = self.duty - slope * error - level
        weight = 1.0 / (1.0 + (off / max(_ROBUST * float(np.median(np.abs(off))), 1e-12)) ** 2)
        return replace(self, weight=weight / weight.sum())


class Lags:
    """How well every piece is explained at every pair of lags.

    Args:
        pieces: p of them.
        goal: lags of the goal [s], shape (J,).
        position: lags of the position [s], shape (K,).
        weights: of the samples of each piece; alike by default.

    Attributes:
        cost: minus twice the logarithm of the likelihood, each piece with an offset and a noise of its own, (p, J, K).
        gain: duty per radian and unit of firmware gain [1/rad], one for all pieces, (J, K): where the error goes with
            the speed, as that of a light arm does, a gain of each piece's own would pass for a lag.
        left: share of each piece's variance that is not explained, (p, J, K).
    """

    def __init__(
        self,
        pieces: Sequence[Piece],
        goal: FloatArray,
        position: FloatArray,
        weights: Sequence[FloatArray] | None = None,
    ) -> None:
        self.goal, self.position = goal, position
        self._gains = np.array([piece.gain for piece in pieces])
        weights = weights or [np.full(piece.t.size, 1.0 / piece.t.size) for piece in pieces]
        self._designs = [
            _Design(
                np.stack([piece.goal_at(piece.t - lag) for lag in goal], axis=1),
                np.stack([piece.angle(piece.t - lag) for lag in position], axis=1),
                piece.duty,
                weight,
            )
            for piece, weight in zip(pieces, weights, strict=True)
        ]
        self._weigh()

    @property
    def best(self) -> tuple[int, int]:
        """Indices of the best pair; the middle of equals along the goal's lag."""
        total = self.cost.sum(axis=0)
        j, k = np.unravel_index(int(total.argmin()), total.shape)
        equal = np.flatnonzero(total[:, k] <= total[j, k] + _ROUNDING)
        return int(equal[equal.size // 2]), int(k)

    @property
    def weights(self) -> list[FloatArray]:
        """Of the samples of each piece, with a sum of 1."""
        return [one.weight for one in self._designs]

    @property
    def explained(self) -> float:
        """Share of the duty's variance that the best pair explains, the median over the pieces."""
        j, k = self.best
        return 1.0 - float(np.median(self.left[:, j, k]))

    def reweigh(self, j: int, k: int) -> None:
        """Let samples count little that are off the law at a pair of lags, given by its indices."""
        self._designs = [one.reweighted(j, k) for one in self._designs]
        self._weigh()

    def accepted(self) -> tuple[FloatArray, FloatArray]:
        """Pairs that are not worse than the best one by a paired t test over the pieces: both lags [s], (m,) each.

        A pair is out where the mean rise of the cost is more than t / 2 of its standard errors. Where the cost
        is quadratic, that is the 95 % interval of the cluster-robust covariance with pieces as clusters (at its
        end the rise is half of what the pieces' scattered slopes make there); where it has steps or is flat,
        as that of held goals, it is still a test.
        """
        j, k = self.best
        rise = self.cost - self.cost[:, j, k][:, None, None]
        count = len(rise)
        quantile = float(stats.t.ppf(0.975, max(count - 1, 1)))
        error = rise.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(rise.shape[1:], np.inf)
        kept = np.nonzero(rise.mean(axis=0) <= 0.5 * quantile * error + _ROUNDING)
        return self.goal[kept[0]], self.position[kept[1]]

    def _weigh(self) -> None:
        found = [design.products() for design in self._designs]
        own = np.array([one[0] for one in found])[:, None, None]
        slope, error = np.array([one[1] for one in found]), np.array([one[2] for one in found])
        # What every piece leaves when it may choose its gain: its noise.
        alone = np.maximum(own - slope**2 / np.maximum(error, 1e-300), _NOISELESS * own)
        noise = alone.min(axis=(1, 2), keepdims=True)
        P, count = self._gains[:, None, None], np.array([one.duty.size for one in self._designs])[:, None, None]
        total = np.maximum(np.sum(count * P**2 * error / noise, axis=0), 1e-300)
        self.gain = np.sum(count * P * slope / noise, axis=0) / total
        left = own - 2.0 * self.gain * P * slope + (self.gain * P) ** 2 * error
        self.left = np.maximum(left / own, _NOISELESS)
        self.cost = count * np.log(self.left)

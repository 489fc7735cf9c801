"""When a servo was read: the host's stamps around the exchange, checked by the servo's own clock.

The host knows only that it asked and that it had the answer. The servo's clock says in
which of its milliseconds it answered, but not where in that, and it drifts. Together
they are better than either: the middle of the exchange, held to that millisecond.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.optimize import minimize_scalar

from frasa_sysid.recording import FloatArray

TICK = 1e-3  # s
WRAP = 32768  # ticks; the register starts again from 0
EDGES = (1.0, 99.0)  # percentiles taken for the edges of the readings, so that a few late ones do not count
SEARCH = 5.0  # ticks that the first guess may be off over the whole record
MOST = 0.9  # of the readings must belong to the line
TOLERANCE = 2.0  # ticks a reading may lie beside the line; rounding is up to one of them
DRIFT = 0.01  # clocks that differ by more are no clocks
PARTS = 10  # that are left out one by one
FEWEST = 20  # readings that a line is drawn through

Ticks = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ServoClock:
    """The line that maps a servo's clock to the host's.

    Attributes:
        drift: host time over servo time, minus one.
        drift_error: half of its 95 % interval, by leaving out tenths of the record one by one.
        spread: largest distance of a reading that belongs to the line [s].
        moved: readings that lay outside their millisecond and were put at its edge.
        outliers: readings further off than rounding and jitter explain.
    """

    drift: float
    drift_error: float
    spread: float
    moved: int
    outliers: int


def unwrap_ticks(ticks: Ticks, host: FloatArray) -> Ticks:
    """Ticks that go on where the register starts again; the host's time tells how often in a gap.

    Args:
        ticks: register values, shape (T,).
        host: host times [s], shape (T,).
    """
    steps = np.mod(np.diff(ticks), WRAP)
    turns = np.round((np.diff(host) / TICK - steps) / WRAP)
    return np.concatenate([[0.0], np.cumsum(steps + WRAP * turns)])


def reading_times(host: FloatArray, ticks: Ticks) -> tuple[FloatArray, ServoClock | None]:
    """Times at which the servo was read, on the host's clock.

    Args:
        host: the middle of each exchange [s], in order of time, shape (T,).
        ticks: the servo's clock in that reading [ms, modulo 32768], shape (T,).

    Returns:
        Times [s] of shape (T,), and the line; the host's times and None when the
        servo's clock cannot be used: too few readings, or no line through most of them.
    """
    if host.size < FEWEST or not np.isfinite(ticks).all():
        return host, None
    servo = unwrap_ticks(ticks, host) * TICK
    half = host.size // 2
    span = servo[half:] - servo[: host.size - half]
    if (span <= 0).any():
        return host, None
    # Rounding spreads the readings evenly over one tick, so the line is that of the narrowest
    # strip; least squares would lean towards where the two clocks happen to beat.
    start = float(np.median((host[half:] - host[: host.size - half]) / span))
    slope = _narrowest(host, servo, start)
    offset = float(_edges(host - slope * servo).mean())
    good = np.abs(host - slope * servo - offset) < TOLERANCE * TICK
    if good.mean() < MOST:
        return host, None
    if abs(slope - 1) > DRIFT:
        return host, None
    beside = host - slope * servo - offset
    held = np.clip(beside, -TICK / 2, TICK / 2)
    times = slope * servo + offset + held
    clock = ServoClock(
        drift=slope - 1,
        drift_error=_drift_error(host, servo, slope),
        spread=float(np.abs(beside[good]).max()),
        moved=int((np.abs(beside) > TICK / 2).sum()),
        outliers=int((~good).sum()),
    )
    return times, clock


def _narrowest(host: FloatArray, servo: Ticks, start: float) -> float:
    """Slope of the narrowest strip that holds (nearly) all readings, near a first guess."""
    reach = SEARCH * TICK / (servo[-1] - servo[0])
    found = minimize_scalar(lambda one: np.ptp(_edges(host - one * servo)), bounds=(start - reach, start + reach))
    return float(found.x)


def _drift_error(host: FloatArray, servo: Ticks, slope: float) -> float:
    parts = np.arange(host.size) * PARTS // host.size
    left = np.array([_narrowest(host[parts != k], servo[parts != k], slope) for k in range(PARTS)])
    error = np.sqrt((PARTS - 1) / PARTS * ((left - left.mean()) ** 2).sum())
    return float(stats.t.ppf(0.975, PARTS - 1) * error)


def _edges(values: FloatArray) -> FloatArray:
    return np.asarray(np.percentile(values, EDGES))


def describe(clock: ServoClock | None) -> dict[str, float | str]:
    """How reading times were made, to be kept with a recording."""
    if clock is None:
        return {"time": "middle of the exchange"}
    return {
        "time": "middle of the exchange, held to the servo's millisecond",
        "servo_drift_ppm": round(1e6 * clock.drift, 2),
        "servo_drift_error_ppm": round(1e6 * clock.drift_error, 2),
        "largest_residual_ms": round(1e3 * clock.spread, 3),
        "moved": clock.moved,
    }


def comparison(clock: ServoClock | None, samples: int) -> list[dict[str, Any]]:
    """The two clocks in the form of `clocks.compare_clocks`, as a list that is empty without a servo clock."""
    if clock is None:
        return []
    value, half = 1e6 * clock.drift, 1e6 * clock.drift_error
    drift = {"value": round(value, 2), "low": round(value - half, 2), "high": round(value + half, 2)}
    return [{"of": "host", "against": "servo", "samples": samples, "offset_ms": None, "drift_ppm": drift}]

"""How far a simulation is from a log: residuals at the measured times, robust, always finite."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from frasa_sysid.calibration.kept_compiled import kept
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun

IntArray = npt.NDArray[np.int64]

# Pseudo-Huber width: three counts of a 12-bit encoder. Below it a residual is noise, above it model error.
ROBUST_WIDTH = 3.0 * 2.0 * np.pi / 4096  # [rad]
DIVERGED = 10.0  # [rad] misfit that a diverged simulation is given: worse than any that ran, yet finite


@dataclass(frozen=True)
class Misfit:
    """Errors over a set of runs, every run with equal weight.

    Attributes:
        mae_rad: mean absolute error [rad]; the field's headline number.
        rmse_rad: root mean square error [rad].
        by_run: mean absolute error of each run [rad], by name.
    """

    mae_rad: float
    rmse_rad: float
    by_run: dict[str, float]


def residuals(runs: Sequence[BenchRun], readings: Sequence[FloatArray]) -> list[FloatArray]:
    """Simulated minus measured angle of each run [rad]; NaN where the simulation diverged."""
    return [reading - run.y for run, reading in zip(runs, readings, strict=True)]


# Sums may be taken in any order, so that vector instructions take several; NaN is left to IEEE.
_compiled = kept(nogil=True, error_model="numpy", fastmath={"reassoc", "nsz"})


@njit(inline="always")
def _scaled(reading: float, measured: float) -> float:
    """Residual in widths; a diverged one as `DIVERGED`."""
    residual = reading - measured
    sound = residual if abs(residual) <= DIVERGED else (-DIVERGED if residual < 0.0 else DIVERGED)
    return sound * (1.0 / ROBUST_WIDTH)


@njit(inline="always")
def _loss(scaled: float) -> float:
    """Pseudo-Huber: sqrt(1 + s^2) - 1, without cancellation near zero."""
    square = scaled * scaled
    return square / (math.sqrt(1.0 + square) + 1.0)


@_compiled
def robust_costs(part: IntArray, readings: FloatArray, y: FloatArray, samples: IntArray, costs: FloatArray) -> None:
    """Mean over runs of the mean pseudo-Huber residual of some candidates [rad], finite for any input.

    About the mean absolute error for residuals far beyond `ROBUST_WIDTH`.

    Args:
        part: which candidates.
        readings: of all candidates [rad], (m, T).
        y: measured [rad], (T,).
        samples: where each run's samples start, (runs + 1,).
        costs: result, (m,).
    """
    runs = samples.size - 1
    for c in part:
        total = 0.0
        for r in range(runs):
            run = slice(samples[r], samples[r + 1])
            row, measured = readings[c, run], y[run]
            one = 0.0
            for j in range(row.size):
                one += _loss(_scaled(row[j], measured[j]))
            total += one / row.size
        costs[c] = ROBUST_WIDTH * total / runs


@_compiled
def rooted_residuals(part: IntArray, readings: FloatArray, y: FloatArray, samples: IntArray) -> None:
    """Turn readings (m, T) in place into vectors whose sum of squares is the cost times twice the width."""
    runs = samples.size - 1
    for c in part:
        for r in range(runs):
            run = slice(samples[r], samples[r + 1])
            row, measured = readings[c, run], y[run]
            share = 2.0 * ROBUST_WIDTH * ROBUST_WIDTH / (row.size * runs)
            for j in range(row.size):
                scaled = _scaled(row[j], measured[j])
                root = math.sqrt(_loss(scaled) * share)
                row[j] = root if scaled >= 0.0 else -root


def robust_weights(part: FloatArray) -> FloatArray:
    """Second-order weights of the same loss (iteratively reweighted least squares), shape as given."""
    weights: FloatArray = 1.0 / np.sqrt(1.0 + (part / ROBUST_WIDTH) ** 2)
    return weights


def misfit(runs: Sequence[BenchRun], readings: Sequence[FloatArray]) -> Misfit:
    """Errors of one candidate over runs; runs that diverged count `DIVERGED` per sample."""
    if not runs:
        return Misfit(float("nan"), float("nan"), {})
    parts = [np.nan_to_num(part, nan=DIVERGED) for part in residuals(runs, readings)]
    means = [float(np.mean(np.abs(part))) for part in parts]
    squares = [float(np.mean(part**2)) for part in parts]
    by_run = {run.name: mean for run, mean in zip(runs, means, strict=True)}
    return Misfit(float(np.mean(means)), float(np.sqrt(np.mean(squares))), by_run)

"""How far a simulation is from a log: residuals at the measured times, robust, always finite."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun

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


def robust_cost(parts: Sequence[FloatArray]) -> float:
    """Mean over runs of the mean pseudo-Huber residual, finite for any input.

    Args:
        parts: residuals of each run [rad].

    Returns:
        About the mean absolute error for large residuals [rad].
    """
    costs = []
    for part in parts:
        scaled = np.nan_to_num(part, nan=DIVERGED, posinf=DIVERGED, neginf=DIVERGED) / ROBUST_WIDTH
        costs.append(ROBUST_WIDTH * float(np.mean(np.sqrt(1.0 + np.clip(scaled, -1e6, 1e6) ** 2) - 1.0)))
    return float(np.mean(costs))


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

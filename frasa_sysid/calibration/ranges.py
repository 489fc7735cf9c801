"""Calibrated values with their ranges: what `robot_model/randomization.yaml` holds."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import erf, sqrt
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from frasa_sysid.calibration.errors import CalibrationError
from frasa_sysid.calibration.parameters import parameter

SCHEMA = "frasa.randomization/1"


@dataclass(frozen=True)
class Range:
    """A value and the interval that the evidence allows.

    Attributes:
        low, value, high: in `unit`, low <= value <= high; what may be negative says `Parameter.signed`.
        unit: SI unit as text.
        origin: where the interval comes from, in words.
    """

    low: float
    value: float
    high: float
    unit: str
    origin: str

    def __post_init__(self) -> None:
        if not (np.isfinite([self.low, self.value, self.high]).all() and self.low <= self.value <= self.high):
            raise CalibrationError(f"range {self.low} .. {self.value} .. {self.high} is not in order or not finite")


@dataclass(frozen=True)
class Calibration:
    """Ranges by parameter name, how they move together, and the id they share with the model.

    Attributes:
        id: hexadecimal; the same as the custom text `calibration_id` of the model.
        ranges: by parameter name.
        correlated: the names that `correlation` speaks of, k of them.
        correlation: shape (k, k), symmetric, ones on the diagonal.
    """

    id: str
    ranges: Mapping[str, Range]
    correlated: tuple[str, ...] = ()
    correlation: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        for name, one in self.ranges.items():
            known = parameter(name)
            if known.unit != one.unit:
                raise CalibrationError(f"{name} is in [{one.unit}], expected [{known.unit}]")
            if one.low < 0.0 and not known.signed:
                raise CalibrationError(f"the range of {name} begins at {one.low}; it cannot be negative")
        matrix = np.array(self.correlation, dtype=np.float64)
        size = len(self.correlated)
        unknown = sorted(set(self.correlated) - set(self.ranges))
        if matrix.shape != (size, size) or unknown:
            raise CalibrationError(f"correlation of shape {matrix.shape} for {size} names; without a range: {unknown}")
        if len(set(self.correlated)) != size:
            raise CalibrationError("a name stands twice in the correlation")
        if size and not _is_correlation(matrix):
            raise CalibrationError("not a correlation matrix: symmetric, ones on the diagonal, no negative eigenvalue")
        matrix.setflags(write=False)
        object.__setattr__(self, "correlation", matrix)
        object.__setattr__(self, "ranges", MappingProxyType(dict(self.ranges)))

    def values(self) -> dict[str, float]:
        """The calibrated value of every parameter."""
        return {name: one.value for name, one in self.ranges.items()}

    def sample(self, rng: Generator) -> dict[str, float]:
        """One random value for every parameter, uniform in its range, correlated where known.

        Correlated parameters are drawn through a Gaussian copula: normal deviates with
        the correlation, turned into uniform ones, stretched over each range.
        """
        names = list(self.ranges)
        deviates = dict(zip(names, rng.standard_normal(len(names)), strict=True))
        if self.correlated:
            independent = np.array([deviates[name] for name in self.correlated])
            deviates.update(zip(self.correlated, self._mixing @ independent, strict=True))
        return {name: one.low + _normal_cdf(deviates[name]) * (one.high - one.low) for name, one in self.ranges.items()}

    @cached_property
    def _mixing(self) -> npt.NDArray[np.float64]:
        return _root(self.correlation)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for YAML."""
        return {
            "schema": SCHEMA,
            "calibration_id": self.id,
            "parameters": {
                name: {"low": r.low, "value": r.value, "high": r.high, "unit": r.unit, "origin": r.origin}
                for name, r in self.ranges.items()
            },
            "correlation": {"names": list(self.correlated), "matrix": self.correlation.tolist()},
        }


def _is_correlation(matrix: npt.NDArray[np.float64]) -> bool:
    """Within the rounding of the files that hold it."""
    if not (np.isfinite(matrix).all() and np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-5)):
        return False
    return bool(np.allclose(np.diag(matrix), 1.0, rtol=0.0, atol=1e-5) and np.linalg.eigvalsh(matrix).min() > -1e-5)


def _root(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """A matrix L with L L^T = matrix, also where it is only semi-definite."""
    eigenvalues, vectors = np.linalg.eigh(matrix)
    root: npt.NDArray[np.float64] = vectors * np.sqrt(np.clip(eigenvalues, 0.0, None))
    return root


def _normal_cdf(z: float) -> float:
    return 0.5 * (1.0 + erf(z / sqrt(2.0)))

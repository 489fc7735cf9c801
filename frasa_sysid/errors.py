"""Errors of the identification side; the family is `frasa_sysid.calibration.errors`."""

from frasa_sysid.calibration.errors import (
    CalibrationError,
    FrasaError,
    InputError,
    InterruptedRunError,
    ModelError,
    QualityError,
    UsageError,
)

__all__ = [
    "CalibrationError",
    "FrasaError",
    "InputError",
    "InterruptedRunError",
    "LogError",
    "ModelError",
    "QualityError",
    "UsageError",
]


class LogError(InputError):
    """A log cannot be read, or lacks a signal or fact that is needed."""

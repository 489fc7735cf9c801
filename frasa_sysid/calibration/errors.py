"""The one family of errors of frasa, with the exit code each leads to.

Raised at the boundary (a file, a channel, a name, a unit), with what was found,
what was expected and what to do. Only the command lines turn them into one line
of text and an exit status; mistakes in frasa itself keep their traceback.
"""

_LONGEST = 1500  # characters


class FrasaError(Exception):
    """Base of all errors a user can act on."""

    exit_code = 1

    def __str__(self) -> str:
        """What was said, in one printable line: parts of it may be quoted from a file of a stranger."""
        text = super().__str__()
        line = text
        if not text.isprintable():
            line = " ".join("".join(one if one.isprintable() else " " for one in text).split())
        return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 200]} ... {line[-195:]}"


class UsageError(FrasaError):
    """The command line asks for something that cannot be done."""

    exit_code = 2


class OutputError(FrasaError, OSError):
    """An output cannot be written: a full disk, a folder that may not be written; what was there is unchanged."""


class BusyError(FrasaError):
    """Another process writes the same output."""


class InputError(FrasaError):
    """A log, model or calibration that was given cannot be used."""

    exit_code = 3


class ModelError(InputError):
    """A MuJoCo model is missing, broken, or lacks an element that is needed."""


class CalibrationError(InputError):
    """A calibration or ranges file is broken or belongs to another model."""


class QualityError(FrasaError):
    """Everything ran, but a result did not pass its gate."""

    exit_code = 4


class InterruptedRunError(FrasaError):
    """The user stopped the run; the best result so far was saved."""

    exit_code = 130

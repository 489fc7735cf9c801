"""Which fit a published model comes from, by hash, and whether that fit is at hand."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from frasa_sysid.calibration import CalibrationError
from frasa_sysid.calibration.load import RANGES_FILE
from frasa_sysid.calibration.plain_yaml import read_yaml
from frasa_sysid.errors import InputError
from frasa_sysid.fit_json import read_json


def fits_behind(path: Path, key: str) -> dict[str, str]:
    """The sha256 of each fit that a model was published from, by servo or `robot`.

    Args:
        path: the model; what it is from stands in the ranges beside it.
        key: its calibration id.

    Raises:
        CalibrationError: there are no ranges of this model beside it, or they do not say.
    """
    ranges = path.with_name(RANGES_FILE)
    try:
        data = read_yaml(ranges, CalibrationError)
    except FileNotFoundError:
        raise CalibrationError(f"there is no {ranges}") from None
    if not isinstance(data, dict) or data.get("calibration_id") != key:
        raise CalibrationError(f"{ranges} belongs to another model")
    made_from = data.get("made_from")
    fits = made_from.get("fits") if isinstance(made_from, dict) else None
    if not isinstance(fits, dict):
        raise CalibrationError(f"{ranges} does not say which fits it is from")
    return {str(name): str(digest) for name, digest in fits.items()}


def fit_of(sha256: str, paths: Iterable[Path]) -> Path | None:
    """The first of some files that is a fit with this hash; None where none is."""
    for path in paths:
        with suppress(InputError):
            if read_json(path)[1] == sha256:
                return path
    return None

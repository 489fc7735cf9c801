"""Where a calibration may be written: not over its nominal model, and not over the ranges of another calibration.

A folder has one ranges file. It belongs to the model with the same calibration id, which cannot be loaded without it.
"""

from pathlib import Path

from frasa_sysid.calibration import CalibrationError, calibration_id, load_model, read_calibration, servo_law
from frasa_sysid.calibration.load import RANGES_FILE
from frasa_sysid.errors import ModelError, UsageError
from frasa_sysid.model_xml import id_of, parts_of


def check_nominal(nominal: Path, out: Path) -> None:
    """What is published from must be nominal, and no file of it the output.

    Raises:
        ModelError: it is calibrated already, carries a friction law, or would be overwritten.
    """
    model = load_model(nominal)
    if calibration_id(model) is not None:
        raise ModelError(f"{nominal} is calibrated already; publish from the nominal model")
    if servo_law.has_law(model):
        raise ModelError(f"{nominal} carries a friction law already; publish from a model without")
    if out.resolve() in {source.resolve() for source in parts_of(nominal)}:
        raise ModelError(f"{out} is part of the nominal model, which publishing never changes; choose another --out")


def check_ranges_free(out: Path, key: str | None = None) -> None:
    """The ranges beside a new model must not be those of another one.

    A copy of a model that is published again does not count: the ranges are the original's.

    Args:
        out: where the model will stand; its ranges go beside it.
        key: its calibration id, where that is known already; ranges with the same id may stay shared.

    Raises:
        UsageError: another model there has them.
    """
    ranges = out.with_name(RANGES_FILE)
    try:
        there = read_calibration(ranges).id
    except (CalibrationError, OSError):  # none, or one that no model can be loaded with
        return
    if there == key or (out.is_file() and _id(out) == there):
        return
    for path in sorted(out.parent.glob("*.xml")):
        if not path.name.startswith(".") and _id(path) == there:
            raise UsageError(
                f"{out} would take the ranges of {path.name}, {ranges}, and a folder has one such file: publish one of "
                "the two into a folder of its own, with frasa-sysid publish FIT... --out FOLDER/calibrated.xml"
            )


def _id(path: Path) -> str | None:
    """The calibration id in a file; None of what is no model."""
    try:
        return id_of(path)
    except ModelError:
        return None

"""What was written, compiled, must be the nominal model with the fitted numbers applied to it."""

import copy
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from frasa_sysid.calibration import SERVO_FIELDS, apply, calibration_id, load_model, servo_law
from frasa_sysid.calibration.apply import LEAST_FRICTION
from frasa_sysid.errors import QualityError
from frasa_sysid.stored_fit import StoredFit, model_parameters

_COMPARED = (
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_forcerange",
    "actuator_delay",
    "dof_damping",
    "dof_frictionloss",
    "dof_armature",
    "dof_invweight0",
    "body_mass",
    "body_inertia",
    "sensor_delay",
)


def check_compiled(model: mujoco.MjModel, key: str, fits: Sequence[StoredFit], nominal: Path) -> None:
    """The XML that was written and the numbers that were fitted must make one and the same model.

    Args:
        model: compiled from what was written.
        key: calibration id it must carry.
        fits: as they were published.
        nominal: the model they started from.

    Raises:
        QualityError: they do not.
        ModelError: a fitted number that the nominal model has no room for.
    """
    expected, again = load_model(nominal), copy.copy(model)
    for stored in fits:
        values = {name: float(one["value"]) for name, one in model_parameters(stored).items()}
        apply(again, values)
        law = stored.model_law
        if law is not None:
            values = {name: value for name, value in values.items() if name.rpartition(".")[2] in SERVO_FIELDS}
            values[f"{stored.servo}.frictionloss"] = max(law.coulomb, LEAST_FRICTION)
        apply(expected, values)
        # Both as it was compiled and after its own parameters were applied to it, as training does.
        if any(servo_law.law(one, stored.servo) != law for one in (model, again)):
            raise QualityError(f"the compiled model has another friction law of {stored.servo}; nothing was published")
    for field in _COMPARED:
        for one in (model, again):
            if not np.allclose(getattr(one, field), getattr(expected, field), rtol=1e-12, atol=1e-15):
                raise QualityError(f"the compiled model and the fits disagree in {field}; nothing was published")
    if calibration_id(model) != key:
        raise QualityError("the compiled model does not carry the calibration id; nothing was published")

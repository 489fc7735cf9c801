"""What was written, compiled, must be the nominal model with the fitted numbers applied to it."""

import copy
from pathlib import Path

import mujoco
import numpy as np

from frasa_sysid.calibration import (
    SERVO_FIELDS,
    Calibration,
    actuators_of,
    apply,
    calibration_id,
    delay_room,
    delayed_sensors,
    dofs_of,
    load_model,
    parameter,
    read,
    servo_classes,
    servo_law,
)
from frasa_sysid.calibration.apply import LEAST_FRICTION
from frasa_sysid.calibration.stepping import make_trapezoidal
from frasa_sysid.claims import Claims
from frasa_sysid.errors import QualityError
from frasa_sysid.history_room import longest_delays, room_for, widened

# Names, texts and custom numbers are another matter; the last are compared by name, and friction laws by value.
_PASSED_OVER = ("name", "text_", "numeric_", "plugin_attr")


def check_compiled(model: mujoco.MjModel, calibration: Calibration, claims: Claims, nominal: Path) -> None:
    """The XML that was written and the numbers that were fitted must make one and the same model, field by field.

    Args:
        model: compiled from what was written.
        calibration: ranges it is published with, whose id it must carry and whose delays it must hold.
        claims: what was published.
        nominal: the model they started from.

    Raises:
        QualityError: they do not.
        ModelError: a fitted number that the nominal model has no room for.
    """
    expected, again = _expected(calibration, claims, nominal), copy.copy(model)
    for servo, fields in claims.servos().items():
        apply(again, {f"{servo}.{field}": value for field, value in fields.items()})
    apply(again, claims.body_values())
    # Both as it was compiled and after its own parameters were applied to it, as training does.
    for one in (model, again):
        for servo in claims.servos():
            if servo_law.law(one, servo) != claims.laws().get(servo):
                raise QualityError(f"the compiled model has another friction law of {servo}; nothing was published")
        _check_fields(one, expected)
        _check_numbers(one, load_model(nominal), calibration)
    _check_delays(model, calibration)
    if calibration_id(model) != calibration.id:
        raise QualityError("the compiled model does not carry the calibration id; nothing was published")


def _expected(calibration: Calibration, claims: Claims, nominal: Path) -> mujoco.MjModel:
    """The nominal model with room for the delays and the numbers applied; the friction of laws as others see it."""
    longest = longest_delays(calibration.ranges, claims.robot_values())
    expected = widened(nominal, room_for(load_model(nominal), longest))
    if claims.trapezoidal:
        step_trapezoidally(expected)
    for servo, fields in claims.servos().items():
        law = claims.laws().get(servo)
        values = {field: value for field, value in fields.items() if law is None or field in SERVO_FIELDS}
        if law is not None:
            values["frictionloss"] = max(law.coulomb, LEAST_FRICTION)
        apply(expected, {f"{servo}.{field}": value for field, value in values.items()})
    apply(expected, claims.body_values())
    return expected


def step_trapezoidally(model: mujoco.MjModel) -> None:
    """Have all servos of a model step as those of a trapezoidal bench do, in place."""
    joints = [dofs_of(model, actuators_of(model, servo)) for servo in servo_classes(model)]
    make_trapezoidal(model, np.concatenate(joints))


def _check_fields(model: mujoco.MjModel, expected: mujoco.MjModel) -> None:
    for part, other in ((model, expected), (model.opt, expected.opt)):
        for field in (name for name in dir(other) if not name.startswith(("_", *_PASSED_OVER))):
            wanted, found = getattr(other, field), getattr(part, field)
            if not isinstance(wanted, int | float | np.ndarray) or field.startswith(("nnames", "nnumeric", "ntext")):
                continue
            if field in ("nbuffer", "narena", "signature", "nuserdata"):
                continue
            if np.shape(wanted) != np.shape(found) or not np.allclose(found, wanted, rtol=1e-12, atol=1e-15):
                raise QualityError(f"the compiled model and the fits disagree in {field}; nothing was published")


def _check_numbers(model: mujoco.MjModel, nominal: mujoco.MjModel, calibration: Calibration) -> None:
    for i in range(nominal.nnumeric):
        one = nominal.numeric(i)
        if not np.array_equal(one.data, model.numeric(one.name).data):
            raise QualityError(f"the compiled model has another '{one.name}'; nothing was published")
    supply = calibration.ranges.get("supply_voltage")
    if supply is not None and read(model, "supply_voltage") != supply.value:
        raise QualityError("the compiled model stands at another supply than its ranges; nothing was published")


def _check_delays(model: mujoco.MjModel, calibration: Calibration) -> None:
    """MuJoCo cuts a delay that is longer than its buffer in silence."""
    for name, one in calibration.ranges.items():
        known = parameter(name)
        if not known.field.endswith("delay"):
            continue
        if known.owner == "sensor":
            kept = model.sensor_history[delayed_sensors(model, known.field), 0]
            room = float(kept.min()) * model.opt.timestep if kept.size else 0.0
        else:
            room = delay_room(model, known.owner)
        if one.high > room:
            raise QualityError(
                f"the compiled model holds {name} up to {room * 1e3:.1f} ms, its range reaches "
                f"{one.high * 1e3:.1f} ms; nothing was published"
            )

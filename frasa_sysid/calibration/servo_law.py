"""Friction laws M2 to M6 in simulation: coefficients that travel in the model, evaluated at every physics step.

A servo class has the law when the model holds its coefficients as a custom number, eleven of them
in the order of `Friction` (viscous first, as part of the joint's native damping):

    <custom><numeric name="mx106_friction" data="..."/></custom>

The evaluation is compiled and runs inside MuJoCo (`servo_law_callback`), for every model of the
process that carries coefficients and for no other. `load_model` installs it; whoever compiles such a
model by other means, or receives it in another process, calls `install`. Without it the joint has
its constant `frictionloss`, which must be above zero for MuJoCo to make the row that the law fills.
Not covered: `mj_inverse` and models with actuation disabled, where MuJoCo calls nothing; dampers of
tendons along a servo's joint count as no load.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.apply import actuators_of, dofs_of, servo_classes
from frasa_sysid.calibration.errors import ModelError

if TYPE_CHECKING:  # it brings the compiler, which a model without the law does not need
    from frasa_sysid.calibration.friction import Friction

SUFFIX = "_friction"
NUMBERS = 11  # coefficients of `Friction`
_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def has_law(model: mujoco.MjModel) -> bool:
    """Whether a model carries the coefficients of any servo class."""
    return bool(_servos(model))


def law(model: mujoco.MjModel, servo: str) -> "Friction | None":
    """Coefficients of a servo class; None when the model has none for it.

    Raises:
        ModelError: they are there, but cannot be used (see `check`).
    """
    from frasa_sysid.calibration.friction import Friction

    place = _place(model, servo)
    return None if place is None else Friction(*(float(one) for one in model.numeric_data[place]))


def set_law(model: mujoco.MjModel, servo: str, friction: "Friction") -> None:
    """Change a class' coefficients in a model, in place; the joint's damping stays as it is.

    Raises:
        ModelError: the model has no place for them, or they are no numbers the law can be evaluated with.
    """
    place = _place(model, servo)
    if place is None:
        raise ModelError(
            f"the model has no friction law for '{servo}': "
            f'add <numeric name="{servo}{SUFFIX}" size="{NUMBERS}"/> to its <custom>'
        )
    values = np.array([friction.viscous, *friction.coefficients()])
    _check_values(servo, values)
    model.numeric_data[place] = values


def check(model: mujoco.MjModel) -> None:
    """See that every law of a model can be evaluated.

    Raises:
        ModelError: a wrong number of coefficients, an impossible one, no such servo class, or a joint
            of the class that is no hinge or slide with `frictionloss` above zero.
    """
    for servo in _servos(model):
        _check_values(servo, model.numeric_data[_place(model, servo)])


def install() -> None:
    """Have MuJoCo evaluate the law in every model of this process that carries it; again does nothing.

    The first call compiles for some seconds.

    Raises:
        ModelError: another `mjcb_control` is set, or this MuJoCo's structs are not as it describes them.
    """
    from frasa_sysid.calibration.servo_law_callback import servo_law

    current = mujoco.get_mjcb_control()
    if current is servo_law.ctypes:
        return
    if current is not None:
        raise ModelError("another mjcb_control is set; MuJoCo has one for all models, so the servo law cannot have it")
    mujoco.set_mjcb_control(servo_law.ctypes)


def installed() -> bool:
    """Whether MuJoCo evaluates the law in this process."""
    current = mujoco.get_mjcb_control()
    if current is None:
        return False
    from frasa_sysid.calibration.servo_law_callback import servo_law

    return current is servo_law.ctypes


def uninstall() -> None:
    """Take the law away again; another's `mjcb_control` is left in place."""
    if installed():
        mujoco.set_mjcb_control(None)


@contextmanager
def active() -> Iterator[None]:
    """The law within a `with` block; afterwards it is as it was before."""
    before = installed()
    install()
    try:
        yield
    finally:
        if not before:
            uninstall()


def _servos(model: mujoco.MjModel) -> list[str]:
    """Names before the suffix; another custom number that happens to end so is told by its size."""
    ending = [model.numeric(i) for i in range(model.nnumeric) if model.numeric(i).name.endswith(SUFFIX)]
    servos = [(one.name.removesuffix(SUFFIX), one.data.size) for one in ending]
    return [servo for servo, size in servos if size == NUMBERS or servo in servo_classes(model)]


def _place(model: mujoco.MjModel, servo: str) -> slice | None:
    """Where a class' coefficients stand in `numeric_data`; None when the model has none."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, servo + SUFFIX)
    if index < 0:
        return None
    size = int(model.numeric_size[index])
    if size != NUMBERS:
        raise ModelError(f"{servo}{SUFFIX} has {size} numbers, expected {NUMBERS}: those of Friction, in its order")
    actuators = actuators_of(model, servo)
    joints = model.actuator_trnid[actuators, 0]
    if (model.actuator_trntype[actuators] != mujoco.mjtTrn.mjTRN_JOINT).any() or not np.isin(
        model.jnt_type[joints], _JOINTS
    ).all():
        raise ModelError(f"servo class '{servo}' has a friction law, but not all its actuators turn a hinge or slide")
    if not (model.dof_frictionloss[dofs_of(model, actuators)] > 0.0).all():
        raise ModelError(f"a joint of '{servo}' has no frictionloss: the friction law needs one above zero to replace")
    start = int(model.numeric_adr[index])
    return slice(start, start + NUMBERS)


def _check_values(servo: str, values: npt.NDArray[np.float64]) -> None:
    if not (np.isfinite(values).all() and (values >= 0.0).all() and values[9] > 0.0):
        raise ModelError(
            f"friction law of '{servo}': expected finite numbers, none negative, and a Stribeck speed above zero"
        )

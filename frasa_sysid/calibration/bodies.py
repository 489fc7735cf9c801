"""Zero errors of joints, and the mass of the trunk, in a compiled `MjModel`.

A joint's encoder reads `q_true + zero`, and servo, commands and sensors know that reading only. So a
model's joint angle is the *measured* one, and its geometry is turned back by the zero: that is what
MuJoCo's own reference angle (`<joint ref>`, `qpos0`) does, which turns the body's frame about the
joint's axis by `-ref`. Setting it twice is setting it once, and a model at rest at its reference
stands as the nominal one does. Limits of joints stay where they are in the measured angle.

Whoever changes these calls `mj_setConst` afterwards, as `apply` does.
"""

import mujoco
import numpy as np

from frasa_sysid.calibration.errors import ModelError

LARGEST_ZERO = 1.0  # [rad]; a joint that is further off was mounted wrongly, or has another sign
_AXES = {"com_x": 0, "com_y": 1, "com_z": 2}


def zero_of(model: mujoco.MjModel, joint: str) -> float:
    """Zero error of a joint [rad]: measured angle less true angle.

    Raises:
        ModelError: no such hinge.
    """
    return float(model.qpos0[_address(model, joint)])


def set_zero(model: mujoco.MjModel, joint: str, zero: float) -> None:
    """Make a joint's angle the measured one, `zero` [rad] more than the true one.

    Raises:
        ModelError: no such hinge, or no zero error that a joint can have.
    """
    if not abs(zero) <= LARGEST_ZERO:  # written so that NaN fails too
        raise ModelError(f"{joint}.zero = {zero} rad: expected at most {LARGEST_ZERO:g} rad either way")
    model.qpos0[_address(model, joint)] = zero


def trunk_number(model: mujoco.MjModel, trunk: int, field: str) -> float:
    """A field of `TRUNK_FIELDS` of a body: its mass [kg] or a coordinate of its centre of mass [m]."""
    return float(model.body_mass[trunk] if field == "mass" else model.body_ipos[trunk, _AXES[field]])


def set_trunk(model: mujoco.MjModel, trunk: int, field: str, value: float) -> None:
    """Set a field of `TRUNK_FIELDS` of a body; its inertia is proportional to its mass.

    Raises:
        ModelError: a mass that is not above zero, or a number that is not finite.
    """
    if not np.isfinite(value) or (field == "mass" and not (value > 0.0 and model.body_mass[trunk] > 0.0)):
        raise ModelError(f"trunk.{field} = {value}: expected a finite number, and a mass above zero")
    if field == "mass":
        model.body_inertia[trunk] *= value / model.body_mass[trunk]
        model.body_mass[trunk] = value
        return
    model.body_ipos[trunk, _AXES[field]] = value
    # Compiled with its centre of mass at the frame's origin, a body is taken there whatever `body_ipos` says.
    model.body_sameframe[trunk] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


def _address(model: mujoco.MjModel, joint: str) -> int:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    if index < 0 or model.jnt_type[index] != mujoco.mjtJoint.mjJNT_HINGE:
        hinges = [model.joint(i).name for i in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)]
        raise ModelError(f"the model has no hinge '{joint}'; it has {', '.join(hinges) or 'none'}")
    return int(model.jnt_qposadr[index])

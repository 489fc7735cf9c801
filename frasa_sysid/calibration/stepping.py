r"""How a model steps damping and dry friction of its servos: as MuJoCo does by default, or to second order.

By default MuJoCo's Euler step takes joint damping D at the step's end, which adds h/2 D to what the joint weighs, and
its friction rows are soft: a joint that dry friction holds creeps, one that it stops swings back. Both change what a
fit finds, by several percent at 2 ms. *Trapezoidal* stepping has neither, with MuJoCo's own means:

- `eulerdamp` is off, so that damping is that of the step's beginning, and armature is J + h/2 D, which makes

  .. math:: (M + h D / 2) (v^+ - v) / h = \tau - D v \iff M (v^+ - v) / h = \tau - D (v + v^+) / 2

- the friction rows of the servos' joints are about as hard as the step allows, and since their inertia is that of the
  step itself, they stop a joint within it.

The parameter `armature` is J in either case. It does not depend on the step then, but what stands in the model does.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.errors import ModelError

EULER, TRAPEZOIDAL = "euler", "trapezoidal"
HARD_STEPS = 2.0  # time constant of a hard friction row in steps: the shortest that MuJoCo allows
# Its impedance. MuJoCo's highest, 0.9999, makes no difference that could be seen, and costs a robot on its feet more
# than three times the solver's work where there are noslip iterations too.
HARD = (0.99, 0.99, 0.001, 0.5, 2.0)
_EULERDAMP = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


def lead(model: mujoco.MjModel) -> float:
    """What stands in `dof_armature` beside J, for each unit of damping: h/2 [s], or 0 without trapezoidal stepping."""
    explicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER and model.opt.disableflags & _EULERDAMP
    return 0.5 * float(model.opt.timestep) if explicit else 0.0


def stepping_of(model: mujoco.MjModel) -> str:
    """`trapezoidal` or `euler`, the way a model takes damping."""
    return TRAPEZOIDAL if lead(model) else EULER


def make_trapezoidal(model: mujoco.MjModel, dofs: Sequence[int] | npt.NDArray[np.int64]) -> None:
    """Have a model step its servos' joints to second order, in place; again does nothing.

    Args:
        model: with the integrator Euler.
        dofs: degrees of freedom of all servos' joints, shape (n,).

    Raises:
        ModelError: another integrator.
    """
    check_integrator(model)
    if lead(model):
        return
    model.opt.disableflags |= _EULERDAMP
    model.dof_armature[dofs] += lead(model) * model.dof_damping[dofs]
    model.dof_solref[dofs] = (HARD_STEPS * model.opt.timestep, 1.0)
    model.dof_solimp[dofs] = HARD


def check_integrator(model: mujoco.MjModel) -> None:
    """See that a model can step as the fits do.

    Raises:
        ModelError: its integrator is not Euler.
    """
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        name = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower()
        raise ModelError(f'the fits step with integrator Euler, the model has {name}: set <option integrator="Euler"/>')


def set_damping(model: mujoco.MjModel, dofs: npt.NDArray[np.int64], damping: float | npt.NDArray[np.float64]) -> None:
    """Change damping [N m s/rad] of joints, shape (n,) or one for all, and leave their inertia as it is."""
    model.dof_armature[dofs] += lead(model) * (damping - model.dof_damping[dofs])
    model.dof_damping[dofs] = damping


def set_armature(model: mujoco.MjModel, dofs: npt.NDArray[np.int64], armature: float) -> None:
    """Change armature J [kg m^2] of joints."""
    model.dof_armature[dofs] = armature + lead(model) * model.dof_damping[dofs]


def armature_of(model: mujoco.MjModel, dof: int) -> float:
    """Armature J of a joint [kg m^2]."""
    return float(model.dof_armature[dof] - lead(model) * model.dof_damping[dof])


def restep(model: mujoco.MjModel, timestep: float | None = None, integrator: int | None = None) -> None:
    """Give a model another time step [s] or integrator, in place, and leave its joints' inertia as it is.

    What stands in the model for damping and hard friction rows follows the step; every joint that an actuator
    turns counts as a servo's.

    Raises:
        ModelError: a time step that is none.
    """
    wanted = float(model.opt.timestep) if timestep is None else timestep
    if not (np.isfinite(wanted) and wanted > 0.0):
        raise ModelError(f"a time step of {wanted} s: expected a positive number")
    turns = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    dofs = np.unique(model.jnt_dofadr[model.actuator_trnid[turns, 0]])
    inertia = model.dof_armature[dofs] - lead(model) * model.dof_damping[dofs]
    hard = dofs[np.isclose(model.dof_solref[dofs, 0], HARD_STEPS * model.opt.timestep, rtol=1e-9, atol=0.0)]
    model.opt.timestep = wanted
    if integrator is not None:
        model.opt.integrator = integrator
    model.dof_armature[dofs] = inertia + lead(model) * model.dof_damping[dofs]
    model.dof_solref[hard, 0] = HARD_STEPS * wanted

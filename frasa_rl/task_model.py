"""The model as the task simulates it: the user's file, less what no one looks at, stepped as the task says.

Textures and sensors that the task does not read are left out (a history of 80 ms for every sensor makes a
state of 4,400 numbers, and each physics step writes one); no number of the robot changes.
"""

from collections.abc import Callable
from math import ceil, isfinite
from pathlib import Path

import mujoco
import numpy as np

from frasa_rl.config import Physics, Task
from frasa_rl.friction_stand_in import put_aside, stand_in
from frasa_rl.robot import ADDED_SELF_CONTACT, sensor_names
from frasa_rl.support import add_support
from frasa_sysid.calibration import ModelError, compile_model, load_spec, stepping

_INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
_CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}
_CONTACTS = 8  # largest forces that an added self-contact sensor keeps
_OTHERS_BIT = 1 << 20  # of contype and conaffinity: of all that is not the robot, when it shall not touch itself


def build_model(
    path: Path, task: Task, *, textures: bool = False, add: Callable[[mujoco.MjSpec], None] | None = None
) -> mujoco.MjModel:
    """Compile the model of a task.

    Args:
        path: a MuJoCo XML file.
        task: its sensors and physics settings.
        textures: keep what only pictures need.
        add: puts something else into the scene before it is compiled.

    Raises:
        ModelError: the file is missing or broken, or the task's physics do not suit it.
    """
    spec = load_spec(path)
    written = float(spec.option.timestep)
    wanted = written if task.physics.timestep is None else task.physics.timestep
    if not (isfinite(wanted) and wanted > 0.0):
        raise ModelError(f"a time step of {wanted} s: expected a positive number")
    _prune(spec, set(sensor_names(task)), written / wanted)
    if not textures:
        _drop_textures(spec)
    if task.names.self_contact is None:
        _add_self_contact(spec, task.names.trunk)
    if add is not None:
        add(spec)
    if task.physics.friction_law != "model":
        put_aside(spec)
    model = compile_model(spec, path)
    if task.reward.gathering:
        add_support(spec, model, task)
        model = compile_model(spec, path)
    if task.physics.friction_law != "model":
        stand_in(model, task.rate_limit)
    _set_physics(model, task.physics, task.names.trunk)
    substeps(model, task.control_period_s)  # says early when they do not go together
    return model


def substeps(model: mujoco.MjModel, period_s: float) -> int:
    """Physics steps in a period [s].

    Raises:
        ModelError: the time step does not divide it.
    """
    count = round(period_s / float(model.opt.timestep))
    if count < 1 or abs(count * model.opt.timestep - period_s) > 1e-9:
        raise ModelError(
            f"the model's time step of {model.opt.timestep * 1e3:g} ms does not divide the control period "
            f"of {period_s * 1e3:g} ms"
        )
    return count


def _prune(spec: mujoco.MjSpec, kept: set[str], shorter: float) -> None:
    """Leave out unread sensors; a longer step needs fewer samples for the same delay."""
    for sensor in list(spec.sensors):
        if sensor.name not in kept:
            spec.delete(sensor)
    for one in [*spec.sensors, *spec.actuators]:
        if one.nsample and shorter != 1.0:
            one.nsample = ceil(one.nsample * shorter) + 1


def _drop_textures(spec: mujoco.MjSpec) -> None:
    for geom in spec.geoms:
        geom.material = ""
    for one in [*spec.materials, *spec.textures]:
        spec.delete(one)


def _add_self_contact(spec: mujoco.MjSpec, trunk: str) -> None:
    if spec.body(trunk) is None:
        return  # said with all that is missing by `find_robot`
    spec.add_sensor(
        name=ADDED_SELF_CONTACT,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=trunk,
        reftype=mujoco.mjtObj.mjOBJ_XBODY,
        refname=trunk,
        intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 2, _CONTACTS],
    )


def _set_physics(model: mujoco.MjModel, physics: Physics, trunk: str) -> None:
    integrator = None if physics.integrator is None else int(_INTEGRATORS[physics.integrator])
    stepping.restep(model, physics.timestep, integrator)
    if physics.cone is not None:
        model.opt.cone = _CONES[physics.cone]
    if physics.islands is not None:
        off = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        model.opt.disableflags = model.opt.disableflags & ~off | (0 if physics.islands else off)
    for name in ("iterations", "tolerance", "noslip_iterations"):
        value = getattr(physics, name)
        if value is not None:
            setattr(model.opt, name, value)
    if physics.self_collision is False:
        _touch_no_part_of_itself(model, trunk)


def _touch_no_part_of_itself(model: mujoco.MjModel, trunk: str) -> None:
    """Parts of the robot no longer collide with each other; what they collided with beside, they still do."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, trunk)
    if index < 0:
        return  # said with all that is missing by `find_robot`
    own = model.body_rootid[model.geom_bodyid] == model.body_rootid[index]
    kind, meets = model.geom_contype, model.geom_conaffinity
    touched = (kind[own, None] & meets[~own]) | (kind[~own] & meets[own, None])
    meets[own] = np.where(touched.any(axis=1), _OTHERS_BIT, 0)
    kind[own] = 0
    kind[~own] |= np.where((kind[~own] | meets[~own]) != 0, _OTHERS_BIT, 0)

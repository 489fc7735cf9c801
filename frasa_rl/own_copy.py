"""A copy of a foreign model that the whole chain can work on: servo classes, room for delays, sensors, standing pose.

The user's file stays as it is. Of the copy, the bodies, joints and geoms are the user's own elements. The compiled
copy is held against the compiled original number by number.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from frasa_rl.config import Names
from frasa_rl.own_look import Looked
from frasa_rl.own_sensors import write_sensors
from frasa_rl.own_servos import HISTORY_S, write_custom, write_servos
from frasa_rl.own_stance import Stance
from frasa_rl.own_xml import every, inlined, section, take_assets, taken
from frasa_rl.robot import Floats
from frasa_sysid.calibration import ModelError

TIMESTEP = 0.002  # [s] longest step of the copy: what a fit finds is off by about half of it
_SAME = (
    "body_mass", "body_inertia", "body_pos", "body_quat", "body_ipos", "jnt_type", "jnt_axis", "jnt_pos", "jnt_range",
    "jnt_limited", "jnt_stiffness", "qpos0", "qpos_spring", "geom_type", "geom_size", "geom_pos", "geom_quat",
    "geom_contype", "geom_conaffinity", "geom_friction", "geom_solref", "actuator_gainprm", "actuator_biasprm",
    "actuator_forcerange", "actuator_trnid", "dof_solref", "dof_solimp",
)  # fmt: skip


@dataclass(frozen=True)
class Copy:
    """The copy as text.

    Attributes:
        xml: of the model.
        names: of what the task reads in it.
        added: what was put in, in words.
        assets: meshes and textures to copy, by their name in the folder `ASSETS` beside it.
    """

    xml: str
    names: Names
    added: tuple[str, ...]
    assets: dict[str, Path]


def copy_model(looked: Looked, stance: Stance, supply: float, gain: float) -> Copy:
    """Make the copy.

    Args:
        looked: the robot.
        stance: its pose; becomes the keyframe `neutral`.
        supply: at which kp and torque limit of the model hold [V].
        gain: firmware gain P at which they do.

    Raises:
        ModelError: a joint or actuator that is not found in the file as MuJoCo has it.
    """
    root = inlined(looked.path)
    assets = take_assets(root, looked.path)
    root.set("model", re.sub(r"\W+", "_", root.get("model") or looked.path.stem) + "_nominal")
    added = []
    if not looked.told:
        write_servos(root, looked, step_of(looked))
        write_custom(root, looked, supply, gain)
        added.append(f"servo classes {', '.join(looked.servos)} with room for {HISTORY_S * 1e3:g} ms of command delay")
    if looked.model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        for option in every(root, "option"):
            taken(option, "integrator")
        section(root, "option").set("integrator", "Euler")
        added.append("integrator Euler, which fits are made with")
    if looked.model.opt.timestep > TIMESTEP:
        for option in every(root, "option"):
            taken(option, "timestep")
        section(root, "option").set("timestep", repr(TIMESTEP))
        added.append(f"a time step of {TIMESTEP * 1e3:g} ms in place of {looked.model.opt.timestep * 1e3:g}, for fits")
    if _write_inertia(root, looked):
        added.append("masses and inertias as MuJoCo takes them from the geoms, so that a fit can change the trunk's")
    names, sensors = write_sensors(root, looked, step_of(looked))
    _write_stance(root, looked, stance)
    etree.indent(root)
    xml = etree.tostring(root, encoding="unicode").rstrip() + "\n"
    return Copy(xml, names, (*added, *sensors, f"keyframe 'neutral': {stance.origin}"), assets)


def step_of(looked: Looked) -> float:
    """Time step of the copy [s]."""
    return min(float(looked.model.opt.timestep), TIMESTEP)


def check_copy(looked: Looked, copy: mujoco.MjModel) -> None:
    """See that the copy is the same robot.

    Args:
        looked: the original.
        copy: compiled.

    Raises:
        ModelError: a number of bodies, joints, geoms or servos that is another one.
    """
    for name in _SAME:
        before, after = getattr(looked.model, name), getattr(copy, name)
        if before.shape != after.shape or not np.allclose(before, after, rtol=1e-9, atol=1e-12):
            raise ModelError(
                f"{looked.path}: its copy is not the same robot, {name} differs; write out what its defaults or frames "
                "give to joints and actuators, or report this model"
            )


def _write_inertia(root: etree._Element, looked: Looked) -> bool:
    """Write out inertias that come from geoms: of all bodies where the compiler says so, else of a bare trunk."""
    model, always = looked.model, False
    for compiler in every(root, "compiler"):
        always = taken(compiler, "inertiafromgeom") == "true" or always
    bodies = {one.get("name"): one for place in every(root, "worldbody") for one in place.iter("body")}
    trunk = model.body(looked.trunk).name
    unnamed = [one for one in bodies if one is None]
    wanted = [name for name in bodies if name and (always or (name == trunk and bodies[name].find("inertial") is None))]
    if always and unnamed:
        raise ModelError(f"{looked.path}: a body has no name, and its inertia comes from its geoms: give it one")
    for name in wanted:
        index = model.body(name).id
        if model.body_mass[index] <= 0.0:
            continue
        old = bodies[name].find("inertial")
        if old is not None:
            bodies[name].remove(old)
        new = etree.Element("inertial")
        bodies[name].insert(0, new)
        new.set("pos", _exactly(model.body_ipos[index]))
        new.set("quat", _exactly(model.body_iquat[index]))
        new.set("mass", repr(float(model.body_mass[index])))
        new.set("diaginertia", _exactly(model.body_inertia[index]))
    return bool(wanted)


def _exactly(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write_stance(root: etree._Element, looked: Looked, stance: Stance) -> None:
    place = section(root, "keyframe")
    for group in every(root, "keyframe"):
        for key in list(group):
            if key.get("name") == "neutral":
                group.remove(key)
    etree.SubElement(place, "key", name="neutral", qpos=_numbers(stance.qpos), ctrl=_numbers(stance.commands))


def _numbers(values: Floats) -> str:
    return " ".join(repr(round(float(value), 9)) for value in values)

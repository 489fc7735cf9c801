"""A copy of a foreign model that the whole chain can work on: servo classes, room for delays, sensors, standing pose.

The user's file stays as it is. Of the copy, the bodies, joints and geoms are the user's own elements; what a joint or
an actuator had from default classes is written out, since the servo's class takes their place. The compiled copy is
held against the compiled original number by number.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from frasa_rl.config import Names
from frasa_rl.own_look import Looked, OwnServo
from frasa_rl.own_stance import Stance
from frasa_rl.own_xml import Chains, every, inlined, section, take_assets, taken, write_all
from frasa_rl.robot import Floats
from frasa_sysid.calibration import ModelError

HISTORY_S = 0.04  # [s] longest command delay that has room
TIMESTEP = 0.002  # [s] longest step of the copy: what a fit finds is off by about half of it
SENSOR_S = 0.08  # [s] longest age of a reading
SITE = "frasa_imu"
_SERVO = ("damping", "armature", "frictionloss")
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
        _write_servos(root, looked)
        _write_custom(root, looked, supply, gain)
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
    names, sensors = _sensors(root, looked)
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


def _write_servos(root: etree._Element, looked: Looked) -> None:
    for name in looked.servos:
        _make_way(root, name)
    chains = Chains(root)
    joints = {one.get("name"): one for place in every(root, "worldbody") for one in place.iter("joint")}
    actuators = _actuators(root)
    for one in looked.hinges:
        element = joints.get(one.name)
        if element is None:
            raise ModelError(f"{looked.path}: joint {one.name} does not stand in the file by that name (replicate?)")
        whole = chains.of(element)
        for key in (*_SERVO, "class", "actuatorfrcrange", "actuatorfrclimited"):
            whole.pop(key, None)
        element.attrib.clear()
        write_all(element, {**whole, "class": looked.servo_of[one.name]})
        _write_actuator(actuators, looked, one.name)
    defaults = section(root, "default")
    for servo in looked.servos.values():
        defaults.append(_class(servo, looked))


def _make_way(root: etree._Element, name: str) -> None:
    """A default class that has the name of a servo already gets another one."""
    if not any(one.get("class") == name for one in root.iter("default")):
        return
    for element in root.iter():
        for key in ("class", "childclass"):
            if element.get(key) == name:
                element.set(key, f"{name}_before")


def _actuators(root: etree._Element) -> dict[str, etree._Element]:
    """By the joint they turn."""
    places = every(root, "actuator")
    return {one.get("joint") or "": one for place in places for one in place if one.get("joint")}


def _write_actuator(actuators: dict[str, etree._Element], looked: Looked, joint: str) -> None:
    """A position actuator with what differs from joint to joint; the rest is its class's."""
    element = actuators.get(joint)
    if element is None:
        raise ModelError(f"{looked.path}: the actuator of joint {joint} does not stand in the file by its name")
    one = looked.hinge(joint)
    model, (low, high) = looked.model, looked.limits[joint]
    speed_gain = -float(model.actuator_biasprm[one.actuator, 2])
    name = element.get("name") or f"servo_{joint}"
    element.tag = "position"
    element.attrib.clear()
    write_all(element, {"name": name, "joint": joint, "class": looked.servo_of[joint]})
    element.set("ctrlrange", f"{low!r} {high!r}")
    element.set("ctrllimited", "true")
    if speed_gain:
        element.set("kv", repr(speed_gain))


def _class(servo: OwnServo, looked: Looked) -> etree._Element:
    """The default class of a servo, with the delay that its first actuator has and room for a longer one."""
    model = looked.model
    first = next(one.actuator for one in looked.hinges if looked.servo_of[one.name] == servo.name)
    delay = float(model.actuator_delay[first])
    step = step_of(looked)
    steps = str(int(np.ceil(max(HISTORY_S, model.actuator_history[first, 0] * model.opt.timestep) / step)))
    place = etree.Element("default", {"class": servo.name})
    etree.SubElement(
        place, "joint", damping=repr(servo.damping), armature=repr(servo.armature), frictionloss=repr(servo.friction)
    )
    etree.SubElement(
        place, "position", kp=repr(servo.kp), forcelimited="true", forcerange=f"-{servo.force!r} {servo.force!r}",
        delay=repr(delay), nsample=steps, interp="linear",
    )  # fmt: skip
    return place


def _write_custom(root: etree._Element, looked: Looked, supply: float, gain: float) -> None:
    custom = section(root, "custom")
    wanted = {"servo_supply_voltage": supply, "servo_firmware_gain": gain}
    for place in every(root, "custom"):
        for old in list(place):
            if old.get("name") in {*wanted, *looked.servos}:
                place.remove(old)
    for name, value in wanted.items():
        etree.SubElement(custom, "numeric", name=name, data=repr(value))
    actuators = _actuators(root)
    for servo in looked.servos:
        group = etree.SubElement(custom, "tuple", name=servo)
        for one in looked.hinges:
            if looked.servo_of[one.name] == servo:
                etree.SubElement(group, "element", objtype="actuator", objname=actuators[one.name].get("name") or "")


def _sensors(root: etree._Element, looked: Looked) -> tuple[Names, list[str]]:
    """Readings of joints and trunk with room for their ages: the model's own where it has them, else added."""
    model, added = looked.model, []
    trunk = model.body(looked.trunk).name
    place, step = section(root, "sensor"), step_of(looked)
    patterns: dict[str, str] = {}
    for tag, kind in (("jointpos", mujoco.mjtSensor.mjSENS_JOINTPOS), ("jointvel", mujoco.mjtSensor.mjSENS_JOINTVEL)):
        pattern = _pattern(looked, kind)
        if pattern is None:
            pattern = "{}." + {"jointpos": "position", "jointvel": "velocity"}[tag]
            for one in looked.hinges:
                etree.SubElement(place, tag, name=pattern.format(one.name), joint=one.name)
            added.append(f"{tag} sensors of all {len(looked.hinges)} joints")
        patterns[tag] = pattern
    found = {}
    for tag, kind in (("framequat", mujoco.mjtSensor.mjSENS_FRAMEQUAT), ("gyro", mujoco.mjtSensor.mjSENS_GYRO)):
        found[tag] = _trunk_sensor(looked, kind)
        if found[tag] is None:
            _add_site(root, trunk)
            found[tag] = f"frasa_{tag}"
            where = {"site": SITE} if tag == "gyro" else {"objtype": "site", "objname": SITE}
            write_all(etree.SubElement(place, tag), {"name": f"frasa_{tag}", **where})
            added.append(f"{tag} of the trunk, at its origin: move site {SITE} to where the IMU is")
    read = {*(one for one in found.values() if one)}
    read |= {pattern.format(one.name) for pattern in patterns.values() for one in looked.hinges}
    for group in every(root, "sensor"):
        for sensor in group:
            if sensor.get("name") in read:
                before = int(sensor.get("nsample") or 0)
                seconds = before * model.opt.timestep if before else SENSOR_S
                sensor.set("nsample", str(int(np.ceil(seconds / step))))
                sensor.set("interp", sensor.get("interp") or "linear")
                sensor.set("delay", sensor.get("delay") or "0")
    names = Names(
        trunk=trunk,
        floor=model.geom(looked.floor).name,
        position=patterns["jointpos"],
        velocity=patterns["jointvel"],
        orientation=found["framequat"],
        gyro=found["gyro"],
        self_contact=None,
    )
    return names, added


def _pattern(looked: Looked, kind: int) -> str | None:
    """How the model's own sensors of moved joints are called, braces for the joint; None unless all are alike."""
    model, patterns = looked.model, set()
    read = {*looked.moved, *(looked.hinge(name).partner for name in looked.moved)}
    for one in looked.hinges:
        if one.name not in read:
            continue
        mine = np.flatnonzero((model.sensor_type == kind) & (model.sensor_objid == one.joint))
        named = [model.sensor(int(i)).name for i in mine]
        if not named or one.name not in named[0]:
            return None
        patterns.add(named[0].replace(one.name, "{}", 1))
    return patterns.pop() if len(patterns) == 1 else None


def _trunk_sensor(looked: Looked, kind: int) -> str | None:
    """The model's own sensor of the trunk, if its axes are the trunk's."""
    model = looked.model
    for i in np.flatnonzero(model.sensor_type == kind):
        of_site = model.sensor_objtype[i] == mujoco.mjtObj.mjOBJ_SITE
        index = int(model.sensor_objid[i])
        body = int(model.site_bodyid[index]) if of_site else index
        if not (of_site or model.sensor_objtype[i] == mujoco.mjtObj.mjOBJ_XBODY):
            continue
        straight = not of_site or abs(float(model.site_quat[index, 0])) > 1.0 - 1e-9
        if body == looked.trunk and straight and model.sensor_refid[i] < 0 and model.sensor(int(i)).name:
            return str(model.sensor(int(i)).name)
    return None


def _add_site(root: etree._Element, trunk: str) -> None:
    body = next(one for one in root.iter("body") if one.get("name") == trunk)
    if not any(one.get("name") == SITE for one in body.iter("site")):
        etree.SubElement(body, "site", name=SITE, pos="0 0 0", quat="1 0 0 0")


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

"""Servo classes in the copy of a foreign model.

What a joint or an actuator had from default classes is written out, since the servo's class takes their place.
"""

import numpy as np
from lxml import etree

from frasa_rl.own_look import Looked, OwnServo
from frasa_rl.own_xml import Chains, every, section, write_all
from frasa_sysid.calibration import ModelError

HISTORY_S = 0.04  # [s] longest command delay that has room
_SERVO = ("damping", "armature", "frictionloss")


def write_servos(root: etree._Element, looked: Looked, step: float) -> None:
    """Put joints and actuators into classes of their servos.

    Args:
        root: of the copy; changed.
        looked: the robot.
        step: time step of the copy [s].

    Raises:
        ModelError: a joint or actuator that does not stand in the file by its name.
    """
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
        defaults.append(_class(servo, looked, step))


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


def _class(servo: OwnServo, looked: Looked, step: float) -> etree._Element:
    """The default class of a servo, with the delay that its first actuator has and room for a longer one."""
    model = looked.model
    first = next(one.actuator for one in looked.hinges if looked.servo_of[one.name] == servo.name)
    delay = float(model.actuator_delay[first])
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


def write_custom(root: etree._Element, looked: Looked, supply: float, gain: float) -> None:
    """Say which actuators each servo turns, and at which supply voltage [V] and firmware gain its numbers hold."""
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

"""What a fit of the whole robot changes in the model's XML: delays of sensors, zeros of joints, the trunk.

A delay is MuJoCo's own (`delay`, `nsample`, `interp`), a zero the joint's reference angle (`ref`), the
trunk an `<inertial>` of its own; every program that reads MJCF understands all of them.
"""

from collections.abc import Collection, Mapping
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from frasa_sysid.calibration import JOINT_FIELDS, parameter, trunk_of
from frasa_sysid.calibration.bodies import set_trunk
from frasa_sysid.errors import ModelError
from frasa_sysid.history_room import SENSOR_TAGS, HistoryRoom
from frasa_sysid.model_xml import Wanted, class_of, holds_defaults, inlined


def wanted_parts(values: Collection[str]) -> Wanted:
    """Which included files have to be written out to change these parameters, and default classes."""
    kinds = {name: parameter(name) for name in values}
    joints = {one.owner for one in kinds.values() if one.field in JOINT_FIELDS}
    tags = {SENSOR_TAGS[one.field] for one in kinds.values() if one.owner == "sensor"}
    bodies = any(one.owner == "trunk" for one in kinds.values())

    def wanted(part: etree._Element) -> bool:
        if holds_defaults(part):
            return True
        if any(one.get("nsample") for tag in tags for one in part.iter(tag)):
            return True
        return any(
            (bodies and next(place.iter("body"), None) is not None)
            or any(one.get("name") in joints for one in place.iter("joint"))
            for place in part.iter("worldbody", "body")
        )

    return wanted


def write_robot(root: etree._Element, values: Mapping[str, float], nominal: Path, model: mujoco.MjModel) -> None:
    """Write delays of sensors, zeros of joints and the trunk.

    Args:
        root: the model, with the parts written out that `wanted_parts` names.
        values: by parameter name; no servo's.
        nominal: its file.
        model: the nominal model, compiled.

    Raises:
        ModelError: a sensor, joint or trunk that the model does not have or that cannot be changed.
    """
    kinds = {name: parameter(name) for name in values}
    for name, one in kinds.items():
        if one.owner == "sensor":
            for sensor in _sensors(root, one.field, nominal):
                sensor.set("delay", repr(values[name]))
        elif one.field in JOINT_FIELDS:
            _write_zero(root, one.owner, values[name], nominal, model)
    trunk = {one.field: values[name] for name, one in kinds.items() if one.owner == "trunk"}
    if trunk:
        _write_trunk(root, trunk, nominal, model)


def write_room(root: etree._Element, room: HistoryRoom, nominal: Path) -> None:
    """Write how many samples delayed sensors and servos keep."""
    for field, count in room.sensors.items():
        for sensor in _sensors(root, field, nominal):
            _keep(sensor, count)
    for servo, count in room.servos.items():
        position = class_of(root, servo, nominal).find("position")
        if position is not None:
            _keep(position, count)


def _keep(element: etree._Element, count: int) -> None:
    element.set("nsample", str(count))
    element.set("interp", "linear")  # without it the age of a reading jumps by a step


def _sensors(root: etree._Element, field: str, nominal: Path) -> list[etree._Element]:
    """The sensors that `calibration.delayed_sensors` means."""
    places = root.iter("sensor")
    found = [one for place in places for one in place.iter(SENSOR_TAGS[field]) if int(one.get("nsample") or 0) > 0]
    if not found:
        raise ModelError(
            f"{nominal}: no {SENSOR_TAGS[field]} sensor has a history for sensor.{field}; give those that the robot's "
            'computer reads nsample="1" interp="linear"'
        )
    return found


def _write_zero(root: etree._Element, joint: str, zero: float, nominal: Path, model: mujoco.MjModel) -> None:
    found = [one for place in root.iter("worldbody") for one in place.iter("joint") if one.get("name") == joint]
    if len(found) != 1 or model.qpos0[model.joint(joint).qposadr[0]] != 0.0:
        raise ModelError(f"{nominal}: expected one <joint name='{joint}'> without ref, to write its zero error there")
    found[0].set("ref", repr(float(zero if _in_radians(nominal) else np.degrees(zero))))


def _in_radians(nominal: Path) -> bool:
    """The unit of angles is that of the last compiler element that names one."""
    everything = inlined(nominal, lambda part: True)
    units = [one.get("angle") for one in everything.iter("compiler") if one.get("angle")]
    return bool(units) and units[-1] == "radian"


def _write_trunk(root: etree._Element, fields: Mapping[str, float], nominal: Path, model: mujoco.MjModel) -> None:
    trunk = trunk_of(model)
    name = model.body(trunk).name
    found = [one for one in root.iter("body") if one.get("name") == name]
    if not name or len(found) != 1:
        raise ModelError(f"{nominal}: expected one <body name='{name}'> that carries the servos, found {len(found)}")
    before = model.body_mass[trunk], model.body_inertia[trunk].copy(), model.body_ipos[trunk].copy()
    try:
        for field, value in fields.items():
            set_trunk(model, trunk, field, value)
        place = found[0].find("inertial")
        if place is None:
            place = etree.Element("inertial")
            found[0].insert(0, place)
        place.attrib.clear()
        place.set("pos", _numbers(model.body_ipos[trunk]))
        place.set("quat", _numbers(model.body_iquat[trunk]))
        place.set("mass", _numbers([model.body_mass[trunk]]))
        place.set("diaginertia", _numbers(model.body_inertia[trunk]))
    finally:
        model.body_mass[trunk], model.body_inertia[trunk], model.body_ipos[trunk] = before


def _numbers(values: Collection[float]) -> str:
    return " ".join(repr(float(value)) for value in values)

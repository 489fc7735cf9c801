"""Readings of joints and trunk in the copy of a foreign model, with room for their ages."""

import mujoco
import numpy as np
from lxml import etree

from frasa_rl.config import Names
from frasa_rl.own_look import Looked
from frasa_rl.own_xml import every, section, write_all

SENSOR_S = 0.08  # [s] longest age of a reading
SITE = "frasa_imu"


def write_sensors(root: etree._Element, looked: Looked, step: float) -> tuple[Names, list[str]]:
    """Readings of joints and trunk with room for their ages: the model's own where it has them, else added.

    Args:
        root: of the copy; changed.
        looked: the robot.
        step: time step of the copy [s].

    Returns:
        Names of what the task reads, and what was put in, in words.
    """
    model, added = looked.model, []
    trunk = model.body(looked.trunk).name
    place = section(root, "sensor")
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

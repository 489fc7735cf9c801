"""The calibrated model as XML: the nominal file with what is changed written out, and the rest included."""

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import mujoco
from lxml import etree

from frasa_sysid.calibration import SERVO_FIELDS, read, servo_classes, stepping
from frasa_sysid.calibration.apply import LEAST_FRICTION
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.calibration.model_file import FOLDERS, PICTURES
from frasa_sysid.calibration.servo_law import SUFFIX
from frasa_sysid.errors import ModelError

_ACTUATOR_FIELDS = {"kp", "forcerange", "delay"}
_ID = "calibration_id"
Wanted = Callable[[etree._Element], bool]


def _parse(path: Path) -> etree._Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        return etree.parse(str(path), parser).getroot()
    except (etree.XMLSyntaxError, OSError) as error:
        raise ModelError(f"{path} is not XML: {error}") from error


def holds_defaults(part: etree._Element) -> bool:
    """Whether a file has default classes, where the numbers of servos stand."""
    return part.find("default") is not None


def inlined(nominal: Path, wanted: Wanted = holds_defaults) -> etree._Element:
    """The nominal model with the includes that hold what is to be changed written out.

    Comments are left out: those of the nominal files speak of nominal numbers.

    Args:
        nominal: the model file.
        wanted: whether an included file, its own includes written out, is written out.

    Raises:
        ModelError: a file is not XML.
    """
    root = _parse(nominal)
    _write_out(root, nominal.parent, wanted)
    for comment in list(root.iter(etree.Comment)):
        parent = comment.getparent()
        if parent is not None:
            _remove(parent, comment)
    return root


def _write_out(root: etree._Element, folder: Path, wanted: Wanted) -> None:
    for include in list(root.iter("include")):
        parent = include.getparent()
        part = _parse(folder / (include.get("file") or ""))
        _write_out(part, folder, wanted)
        if parent is None or not wanted(part):
            continue
        place = parent.index(include)
        for child in reversed([child for child in part if not isinstance(child, etree._Comment)]):
            parent.insert(place, child)
        parent.remove(include)


def parts_of(nominal: Path) -> list[Path]:
    """The model file and every file it includes."""
    found = [nominal]
    for path in found:  # it grows while it is read
        found.extend(nominal.parent / (one.get("file") or "") for one in _parse(path).iter("include"))
    return found


def relocate(root: etree._Element, before: Path, after: Path) -> None:
    """Make the model stand in another folder: no file is included from there, and assets are found where they are.

    Args:
        root: the model.
        before: folder of the file it was read from.
        after: folder that it will stand in.
    """
    before, after = before.resolve(), after.resolve()
    if before == after:
        return
    _write_out(root, before, lambda _: True)
    if not any(one.get(name) for asset in root.iter("asset") for one in asset for name in PICTURES):
        return
    compilers = list(root.iter("compiler")) or [etree.SubElement(root, "compiler")]
    if all(one.get("assetdir") is None for one in compilers):
        compilers[0].set("assetdir", "")
    for one in compilers:
        for name in ("assetdir", *set(FOLDERS.values())):
            place = one.get(name)
            if place is not None:
                one.set(name, Path(os.path.relpath(before / place, after)).as_posix())


def _remove(parent: etree._Element, child: etree._Element) -> None:
    """Remove a node but keep the white space behind it from gluing neighbours together."""
    previous = child.getprevious()
    if previous is None and parent.text is not None and child.tail is not None:
        parent.text = child.tail
    parent.remove(child)


def write_class(
    root: etree._Element, servo: str, fields: Mapping[str, float], law: Friction | None, nominal: Path
) -> None:
    """Write the numbers of a servo into its default class, and its law beside it, all digits kept.

    Args:
        root: the model.
        servo: name of the class.
        fields: numbers by field; those of a law are taken from `law`.
        law: beyond Coulomb-viscous.
        nominal: named in errors.

    Raises:
        ModelError: the model does not have exactly one default class of that name.
    """
    joint, actuator = (_child(class_of(root, servo, nominal), tag) for tag in ("joint", "position"))
    written = dict(fields)
    if law is not None:
        # Other programs see the Coulomb part alone; above zero, for the row that the law fills.
        written["frictionloss"] = max(law.coulomb, LEAST_FRICTION)
        write_number(root, f"{servo}{SUFFIX}", [law.viscous, *law.coefficients()])
    for field, value in written.items():
        if field in SERVO_FIELDS:
            target = actuator if field in _ACTUATOR_FIELDS else joint
            target.set(field, f"-{value!r} {value!r}" if field == "forcerange" else repr(value))


def write_stepping(
    root: etree._Element, model: mujoco.MjModel, fields: Mapping[str, Mapping[str, float]], nominal: Path
) -> None:
    """Have the model step damping and friction of its servos to second order (`calibration.stepping`).

    Args:
        root: the model.
        model: the nominal one, compiled.
        fields: fitted numbers by servo class and field.
        nominal: named in errors.

    Raises:
        ModelError: its integrator is not Euler, or a servo has no default class of its own.
    """
    stepping.check_integrator(model)
    h = float(model.opt.timestep)
    flag = _child(_child(root, "option"), "flag")
    flag.set("eulerdamp", "disable")
    for servo in servo_classes(model):
        known = {field: read(model, f"{servo}.{field}") for field in ("armature", "damping")} | dict(
            fields.get(servo, {})
        )
        joint = _child(class_of(root, servo, nominal), "joint")
        joint.set("armature", repr(known["armature"] + 0.5 * h * known["damping"]))
        joint.set("damping", repr(known["damping"]))
        joint.set("solreffriction", f"{stepping.HARD_STEPS * h!r} 1")
        joint.set("solimpfriction", " ".join(repr(one) for one in stepping.HARD))


def class_of(root: etree._Element, servo: str, nominal: Path) -> etree._Element:
    """The default class of a servo.

    Raises:
        ModelError: the model does not have exactly one of that name.
    """
    places = [one for one in root.iter("default") if one.get("class") == servo]
    if len(places) != 1:
        raise ModelError(f"{nominal}: expected one default class '{servo}', found {len(places)}")
    return places[0]


def _child(parent: etree._Element, tag: str) -> etree._Element:
    found = parent.find(tag)
    return etree.SubElement(parent, tag) if found is None else found


def write_id(root: etree._Element, key: str) -> None:
    """Write the calibration id as the custom text `calibration_id`."""
    etree.SubElement(_child(root, "custom"), "text", name=_ID, data=key)


def id_of(path: Path) -> str | None:
    """The calibration id that a file carries itself, as `write_id` wrote it; None where it has none.

    Raises:
        ModelError: it is not XML.
    """
    places = [one for one in _parse(path).iter("text") if one.get("name") == _ID]
    return places[0].get("data") if places else None


def write_number(root: etree._Element, name: str, values: Iterable[float]) -> None:
    """Write a custom number, all digits kept."""
    data = " ".join(repr(float(value)) for value in values)
    etree.SubElement(_child(root, "custom"), "numeric", name=name, data=data)

"""The calibrated model as XML: the nominal file with its default classes written out and changed."""

import os
from collections.abc import Iterable
from pathlib import Path

from lxml import etree

from frasa_sysid.calibration import SERVO_FIELDS
from frasa_sysid.calibration.apply import LEAST_FRICTION
from frasa_sysid.calibration.servo_law import SUFFIX
from frasa_sysid.errors import ModelError
from frasa_sysid.stored_fit import StoredFit, model_parameters

_ACTUATOR_FIELDS = {"kp", "forcerange", "delay"}


def _parse(path: Path) -> etree._Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        return etree.parse(str(path), parser).getroot()
    except (etree.XMLSyntaxError, OSError) as error:
        raise ModelError(f"{path} is not XML: {error}") from error


def inlined(nominal: Path) -> etree._Element:
    """The nominal model with the includes that hold default classes written out.

    Comments are left out: those of the nominal files speak of nominal numbers.

    Raises:
        ModelError: a file is not XML.
    """
    root = _parse(nominal)
    for include in root.findall("include"):
        source = nominal.parent / (include.get("file") or "")
        part = _parse(source)
        if part.find("default") is None:
            continue
        place = root.index(include)
        children = [child for child in part if not isinstance(child, etree._Comment)]
        for child in reversed(children):
            root.insert(place, child)
        root.remove(include)
    for comment in list(root.iter(etree.Comment)):
        parent = comment.getparent()
        if parent is not None:
            _remove(parent, comment)
    return root


def parts_of(nominal: Path) -> list[Path]:
    """The model file and every file it includes."""
    return [nominal, *(nominal.parent / (one.get("file") or "") for one in _parse(nominal).iter("include"))]


def relocate_includes(root: etree._Element, before: Path, after: Path) -> None:
    """Write the remaining includes relative to the folder the model will stand in."""
    for include in root.findall("include"):
        source = (before / (include.get("file") or "")).resolve()
        include.set("file", Path(os.path.relpath(source, after.resolve())).as_posix())


def _remove(parent: etree._Element, child: etree._Element) -> None:
    """Remove a node but keep the white space behind it from gluing neighbours together."""
    previous = child.getprevious()
    if previous is None and parent.text is not None and child.tail is not None:
        parent.text = child.tail
    parent.remove(child)


def write_class(root: etree._Element, stored: StoredFit, nominal: Path) -> None:
    """Write the fitted numbers of a servo into its default class, and its law beside it, all digits kept.

    Raises:
        ModelError: the model does not have exactly one default class of that name.
    """
    places = [one for one in root.iter("default") if one.get("class") == stored.servo]
    if len(places) != 1:
        raise ModelError(f"{nominal}: expected one default class '{stored.servo}', found {len(places)}")
    joint, actuator = (_child(places[0], tag) for tag in ("joint", "position"))
    fitted = {name.rpartition(".")[2]: float(one["value"]) for name, one in model_parameters(stored).items()}
    law = stored.model_law
    if law is not None:
        # Other programs see the Coulomb part alone; above zero, for the row that the law fills.
        fitted["frictionloss"] = max(law.coulomb, LEAST_FRICTION)
        write_number(root, f"{stored.servo}{SUFFIX}", [law.viscous, *law.coefficients()])
    for field, value in fitted.items():
        if field in SERVO_FIELDS:
            target = actuator if field in _ACTUATOR_FIELDS else joint
            target.set(field, f"-{value!r} {value!r}" if field == "forcerange" else repr(value))


def _child(parent: etree._Element, tag: str) -> etree._Element:
    found = parent.find(tag)
    return etree.SubElement(parent, tag) if found is None else found


def write_id(root: etree._Element, key: str) -> None:
    """Write the calibration id as the custom text `calibration_id`."""
    etree.SubElement(_child(root, "custom"), "text", name="calibration_id", data=key)


def write_number(root: etree._Element, name: str, values: Iterable[float]) -> None:
    """Write a custom number, all digits kept."""
    data = " ".join(repr(float(value)) for value in values)
    etree.SubElement(_child(root, "custom"), "numeric", name=name, data=data)

"""MJCF as XML: includes written out, meshes found, what default classes give to elements."""

from pathlib import Path

from lxml import etree

from frasa_sysid.calibration import ModelError

ASSETS = "assets"


def inlined(path: Path) -> etree._Element:
    """The file with all it includes written out, without comments."""
    root = _parse(path)
    if root.tag != "mujoco":
        raise ModelError(f"{path} is <{root.tag}>: expected MJCF; MuJoCo saves a URDF as MJCF, then add its actuators")
    for _ in range(100):
        include = next(iter(root.iter("include")), None)
        if include is None:
            break
        part, parent = _parse(path.parent / (include.get("file") or "")), include.getparent()
        if parent is not None:
            place = parent.index(include)
            for child in reversed(list(part)):
                parent.insert(place, child)
            parent.remove(include)
    for comment in list(root.iter(etree.Comment)):
        parent = comment.getparent()
        if parent is not None:
            parent.remove(comment)
    return root


def _parse(path: Path) -> etree._Element:
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_blank_text=True
    )
    try:
        return etree.parse(str(path), parser).getroot()
    except (etree.XMLSyntaxError, OSError) as error:
        raise ModelError(f"{path} is not XML: {error}") from error


def take_assets(root: etree._Element, path: Path) -> dict[str, Path]:
    """Meshes and textures go along into a folder of the copy's own; by their name there.

    Raises:
        ModelError: a file that is not there.
    """
    asset, mesh, texture = "", "", ""
    for compiler in every(root, "compiler"):
        asset = taken(compiler, "assetdir") or asset
        mesh, texture = taken(compiler, "meshdir") or mesh, taken(compiler, "texturedir") or texture
    found: dict[str, Path] = {}
    for element in [one for group in every(root, "asset") for one in group]:
        folder = path.parent / ((texture if element.tag == "texture" else mesh) or asset)
        for key in [str(one) for one in element.attrib if str(one).startswith("file")]:
            source = folder / str(element.get(key))
            if not source.is_file():
                raise ModelError(f"{path}: <{element.tag}> names {element.get(key)}, which is not at {source}")
            if element.get("name") is None:
                element.set("name", source.stem)  # what MuJoCo calls it
            name = source.name
            while name in found and found[name] != source:
                name = f"_{name}"
            found[name] = source
            element.set(key, name)
    if found:
        compiler = section(root, "compiler")
        compiler.set("meshdir", ASSETS)
        compiler.set("texturedir", ASSETS)
    return found


class Chains:
    """Which attributes elements have from default classes.

    Args:
        root: of a whole model.
    """

    def __init__(self, root: etree._Element) -> None:
        self._parts: dict[str, dict[str, dict[str, str]]] = {}
        for top in every(root, "default"):
            self._read(top, {}, top.get("class") or "main")

    def of(self, element: etree._Element) -> dict[str, str]:
        """All attributes of an element, those of its class included."""
        name, parent = element.get("class"), element.getparent()
        while name is None and parent is not None:
            name, parent = parent.get("childclass"), parent.getparent()
        given = self._parts.get(name or "main", {}).get(str(element.tag), {})
        return {**given, **{str(key): str(value) for key, value in element.attrib.items()}}

    def _read(self, place: etree._Element, above: dict[str, dict[str, str]], name: str) -> None:
        here = {**above, **{tag: dict(value) for tag, value in self._parts.get(name, {}).items()}}
        for child in place:
            if child.tag != "default":
                own = {str(key): str(value) for key, value in child.attrib.items()}
                here[str(child.tag)] = {**here.get(str(child.tag), {}), **own}
        self._parts[name] = here
        for child in place:
            if child.tag == "default":
                self._read(child, here, child.get("class") or "")


def taken(element: etree._Element, key: str) -> str:
    """An attribute, which the element has no more; empty without one."""
    value = str(element.get(key) or "")
    if value:
        del element.attrib[key]
    return value


def write_all(element: etree._Element, attributes: dict[str, str]) -> None:
    """Set several attributes."""
    for key, value in attributes.items():
        element.set(key, value)


def every(root: etree._Element, tag: str) -> list[etree._Element]:
    """Sections of the model of that name; there may be several."""
    return [one for one in root if one.tag == tag]


def section(root: etree._Element, tag: str) -> etree._Element:
    """The last section of that name, made where there is none."""
    found = every(root, tag)
    return found[-1] if found else etree.SubElement(root, tag)

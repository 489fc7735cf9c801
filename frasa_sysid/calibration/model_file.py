"""A look at a MuJoCo model's XML before MuJoCo sees it, for the file may be a stranger's.

MuJoCo opens whatever path an attribute names, makes what sizes ask for, and recurses as deep as bodies nest. Here a
model may be of so many files, elements and numbers as robots have, and name only files of its own: those below its
folder, or below the working directory where the model lies in that.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from frasa_sysid.calibration.bounded_read import read_limited
from frasa_sysid.calibration.errors import ModelError
from frasa_sysid.calibration.model_limits import check_sizes, copies_of

LARGEST = 2**24  # [bytes] of one XML file
LARGEST_ASSET = 2**28  # [bytes] of a mesh or picture
MOST_FILES = 100
MOST_ELEMENTS = 100_000  # copies counted; MuJoCo checks names pair by pair in places
DEEPEST = 200  # elements in each other
ROOTS = ("mujoco", "mujocoinclude")
PICTURES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
FOLDERS = {"mesh": "meshdir", "texture": "texturedir", "hfield": "texturedir"}  # of the compiler, else its assetdir


@dataclass
class _Found:
    """What the files of a model hold, as they are read."""

    path: Path
    folder: Path
    root: Path
    elements: int = 0
    files: set[Path] = field(default_factory=set)
    compiler: dict[str, str] = field(default_factory=dict)
    assets: list[tuple[str, str]] = field(default_factory=list)  # tag and path
    models: list[str] = field(default_factory=list)

    def wrong(self, text: str) -> ModelError:
        return ModelError(f"{self.path}: {text}")


def check_model_file(path: Path) -> None:
    """See that a model can be given to MuJoCo.

    Args:
        path: its XML file.

    Raises:
        ModelError: not such a file, one that reaches outside its folder, or one that asks for more than a robot needs.
    """
    _check(path, _root_of(path), 0)


def _check(path: Path, root: Path, depth: int) -> None:
    path = Path(os.path.abspath(path))  # noqa: PTH100 - as it is written
    found = _Found(path, path.parent, root)
    if depth > 8:
        raise found.wrong("models within models, more than eight deep")
    _read(found, path)
    for tag, name in found.assets:
        place = found.compiler.get(FOLDERS.get(tag, ""), found.compiler.get("assetdir", ""))
        _check_asset(found, tag, Path(place) / name)
    for name in found.models:
        _check(_inside(found, "model", Path(found.compiler.get("assetdir", "")) / name), root, depth + 1)


def _root_of(path: Path) -> Path:
    """The folder that a model's files may lie in."""
    folder, here = Path(os.path.abspath(path.parent)), Path(os.path.abspath("."))  # noqa: PTH100 - as it is written
    return here if folder.is_relative_to(here) else folder


def _read(found: _Found, path: Path) -> None:
    if path in found.files or len(found.files) == MOST_FILES:
        raise found.wrong(f"it includes {path.name} twice, or more than {MOST_FILES} files")
    found.files.add(path)
    try:
        content = read_limited(path, LARGEST, ModelError)
    except FileNotFoundError:
        raise found.wrong(f"it includes {path.name}, which is not there") from None
    for tag, attributes in _elements(found, path, content):
        if tag == "compiler":
            found.compiler |= {key: one for key, one in attributes.items() if key.endswith("dir")}
        elif tag == "include":
            _read(found, _inside(found, "include", Path(attributes.get("file", ""))))
        elif tag == "model" and "file" in attributes:
            found.models.append(attributes["file"])
        else:
            found.assets += [(tag, attributes[key]) for key in PICTURES if attributes.get(key)]


def _elements(found: _Found, path: Path, content: bytes) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Tags with attributes, each within its bounds; copies that an element asks for count as often as they are made."""
    elements: list[tuple[str, dict[str, str]]] = []
    copies = [1]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(copies) == 1 and tag not in ROOTS:
            raise found.wrong(f"{path.name} is not MuJoCo XML: its root is <{tag[:40]}>, expected <mujoco>")
        if len(copies) > DEEPEST:
            raise found.wrong(f"more than {DEEPEST} elements within each other")
        try:
            check_sizes(tag, attributes)
            copies.append(copies[-1] * copies_of(tag, attributes))
        except ValueError as error:
            raise found.wrong(f"<{tag[:40]}> {error}") from None
        found.elements += copies[-1]
        if found.elements > MOST_ELEMENTS:
            raise found.wrong(f"it makes more than {MOST_ELEMENTS} elements")
        elements.append((tag, attributes))

    def document_type(*_: object) -> None:
        raise found.wrong("it declares a document type, in which entities can hide; MuJoCo XML needs none")

    # Always UTF-8, as MuJoCo has it: a declared encoding must not make of a file two different ones.
    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, document_type
    parser.EndElementHandler = lambda _: copies.pop()
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise found.wrong(f"{path.name} is not XML: {error}") from error
    yield from elements


def _inside(found: _Found, tag: str, name: Path) -> Path:
    """The file that an attribute names, below the folder that it may lie in."""
    path = Path(os.path.abspath(found.folder / name))  # noqa: PTH100 - links are followed by nobody here
    if not path.is_relative_to(found.root):
        raise found.wrong(f"<{tag}> names {str(name)[:80]}, outside {found.root}; a model's files lie below its folder")
    return path


def _check_asset(found: _Found, tag: str, name: Path) -> None:
    path = _inside(found, tag, name)
    if path.exists() and not path.is_file():  # a device or a pipe never ends
        raise found.wrong(f"<{tag[:40]}> names {str(name)[:80]}, which is no plain file")
    if path.is_file() and path.stat().st_size > LARGEST_ASSET:
        raise found.wrong(f"<{tag[:40]}> names {str(name)[:80]}, larger than {LARGEST_ASSET >> 20} MiB")

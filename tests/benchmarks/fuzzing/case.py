"""One input: the files that a reader is given, and which of them it is pointed at."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """Files by name (None stands for a folder in place of a file), the one that is handed over, and what is expected.

    Attributes:
        files: content by path below the case's folder.
        entry: what the reader is pointed at; empty for the folder itself.
        note: where it is from.
        refuse: it must be refused: to read it would be wrong.
    """

    files: Mapping[str, bytes | None]
    entry: str
    note: str = ""
    refuse: bool = False


def single(content: bytes, name: str, note: str = "", refuse: bool = False) -> Case:
    """A case of one file."""
    return Case({name: content}, name, note, refuse)


def put(case: Case, folder: Path) -> Path:
    """Write a case into a folder, which is emptied before; what the reader is pointed at."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in case.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            path.mkdir(exist_ok=True)
        else:
            path.write_bytes(content)
    return folder / case.entry if case.entry else folder


def case_in(folder: Path, entry: str, note: str = "") -> Case:
    """The case that a folder is."""
    files = {one.relative_to(folder).as_posix(): one.read_bytes() for one in sorted(folder.rglob("*")) if one.is_file()}
    return Case(files, entry, note)

"""Writing files so that neither a kill nor a full disk ever leaves half of one, and hashing them.

What is written goes to temporary files beside its place, named `.NAME.RANDOM.tmp`, and takes its place by a rename. A
writer holds a lock on its temporary file; one that nobody holds was left by a writer that was killed, and the next
one for the same place removes it.
"""

import errno
import hashlib
import os
import secrets
import shutil
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from frasa_sysid.calibration.errors import OutputError
from frasa_sysid.calibration.system_lock import NoLocksError, try_lock

SUFFIX = ".tmp"
_LONGEST = 60  # characters of a name that its temporary one repeats: file systems allow 255 bytes
_FULL = (errno.ENOSPC, errno.EDQUOT)


def write_atomic(path: Path, content: bytes | str) -> None:
    """Write `content` to `path`, which is complete or as it was before, whatever happens.

    Args:
        path: the file to make or replace; its folder is made when missing. A device or pipe is written as it is.
        content: bytes, or text that is encoded as UTF-8.

    Raises:
        OutputError: it cannot be written (what, where, why, what to do); `path` is then as it was before.
    """
    write_together({path: content})


def write_together(contents: Mapping[Path, bytes | str]) -> None:
    """Write files that belong together: all of them are on the disk before the first one takes its place.

    A full disk changes none of them. A kill between two renames, which take microseconds, leaves a part of them new:
    whoever reads them has to see that by what is in them.

    Args:
        contents: by path; they take their places in this order.

    Raises:
        OutputError: one cannot be written; all are then as they were before.
    """
    written: list[_Temporary] = []
    path = Path()
    try:
        for path, content in contents.items():
            written.append(_Temporary(path, content.encode() if isinstance(content, str) else content))
        for one in written:
            path = one.path
            one.take_place()
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        for one in written:
            one.close()


def cannot_write(path: Path, error: OSError) -> OutputError:
    """What to tell about an output that the system refuses.

    Args:
        path: the file or folder that cannot be written.
        error: the system's own.
    """
    folder = next((one for one in (path, *path.parents) if one.is_dir()), Path())
    if error.errno in _FULL:
        free = ""
        with suppress(OSError):
            free = f" ({shutil.disk_usage(folder).free / 1e6:.1f} MB free)"
        why = f"the disk of {folder.absolute()} is full{free}: free some space, or write elsewhere, and start again"
    elif error.errno == errno.EFBIG:
        why = "the file would be larger than this system allows (ulimit -f): raise the limit, or write elsewhere"
    else:
        why = f"{error.strerror or error}: write elsewhere, or change that"
    return OutputError(f"cannot write {path}: {why}; what was there before is unchanged")


class _Temporary:
    """A whole file beside its place.

    Args:
        path: its place.
        data: its content.

    Raises:
        OSError: it cannot be written; nothing is left then.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self._file = -1
        self._name: Path | None = None
        if path.exists() and not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
            path.write_bytes(data)  # a device; a rename would put a file in its place
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        try:
            self._file, self._name = _opened(path)
            with os.fdopen(os.dup(self._file), "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            self.close()
            raise

    def take_place(self) -> None:
        """Become the file."""
        if self._name is not None:
            self._name.replace(self.path)
            self._name = None

    def close(self) -> None:
        """Leave nothing beside the place."""
        if self._name is not None:
            with suppress(FileNotFoundError):
                self._name.unlink()
            self._name = None
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _opened(path: Path) -> tuple[int, Path]:
    """A new temporary file for a place, locked where the system has locks: its number and name."""
    while True:
        name = path.with_name(f"{_prefix(path)}{secrets.token_hex(4)}{SUFFIX}")
        # Not private, as mkstemp's would be: a result is as readable as any other new file.
        file = os.open(name, os.O_CREAT | os.O_EXCL | os.O_RDWR | getattr(os, "O_BINARY", 0), 0o666)
        with suppress(NoLocksError):
            if not try_lock(file) or os.fstat(file).st_nlink == 0:  # another writer cleans up at this moment
                os.close(file)
                with suppress(FileNotFoundError):
                    name.unlink()
                continue
        return file, name


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files for a place whose writers are gone."""
    prefix = _prefix(path)
    with os.scandir(path.parent) as there:
        names = [one.name for one in there if one.name.startswith(prefix) and one.name.endswith(SUFFIX)]
    for name in names:
        with suppress(OSError):  # somebody else's, or gone already
            file = os.open(path.with_name(name), os.O_RDWR)
            try:
                with suppress(NoLocksError):
                    if try_lock(file):
                        path.with_name(name).unlink()
            finally:
                os.close(file)


def _prefix(path: Path) -> str:
    return f".{path.name[:_LONGEST]}."


def sha256_of(data: bytes) -> str:
    """Hexadecimal SHA-256 of some bytes."""
    return hashlib.sha256(data).hexdigest()


def sha256_of_file(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's content, read in blocks."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

"""One process at a time writes an output: others are told who does, or wait for it.

The lock is a file in the folder of the output, held by the system while its process lives: kill -9 frees it at once.
Its content only says who that is. It is removed when the output is done.
"""

import json
import os
import platform
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from frasa_sysid.calibration.command_line import say
from frasa_sysid.calibration.errors import BusyError
from frasa_sysid.calibration.files import cannot_write
from frasa_sysid.calibration.system_lock import NoLocksError, try_lock

LOCK_FILE = ".lock"  # in a folder that is an output
_LOOK_S = 0.1
_SILENT_S = 2.0  # a shorter wait is not worth a word
_SAID_BYTES = 1000

_mine: set[tuple[int, Path]] = set()  # thread and lock file


@contextmanager
def alone(output: Path, *, folder: bool = False, patience_s: float = 0.0) -> Iterator[None]:
    """Nobody else who asks writes an output meanwhile; a thread that has it already may ask again.

    On file systems without locks nothing is promised.

    Args:
        output: a file, or a folder; made when missing (its parents, where it is a file).
        folder: whether it is one.
        patience_s: how long to wait for another process [s].

    Raises:
        BusyError: another process has it.
        OutputError: the folder cannot be written.
    """
    path = (output / LOCK_FILE if folder else output.with_name(f".{output.name}.lock")).absolute()
    mine = (threading.get_ident(), path)
    if mine in _mine:
        yield
        return
    made = [one for one in path.parents if not one.exists()]  # innermost first
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _taken(output, path, patience_s)
    except OSError as error:
        raise cannot_write(output, error) from error
    _mine.add(mine)
    try:
        yield
    finally:
        _mine.discard(mine)
        with suppress(OSError):  # while it is held: whoever waits for this very file sees that it is gone
            path.unlink()
        os.close(file)
        with suppress(OSError):  # folders stay where something came of it
            for one in made:
                one.rmdir()


def _taken(output: Path, path: Path, patience_s: float) -> int:
    """The open lock file, locked."""
    began, told = time.monotonic(), False
    while True:
        file = _opened(path)
        try:
            if try_lock(file):
                if _is(file, path):
                    _sign(file)
                    return file
                os.close(file)  # the one before has removed it
                continue
        except NoLocksError:
            return file
        who = _who(file)
        os.close(file)
        waited = time.monotonic() - began
        if waited >= patience_s:
            raise BusyError(f"{output} is being written by {who}: wait until that has ended, or choose another place")
        if waited > _SILENT_S and not told:
            say(f"waiting for {who}, which writes {output}")
            told = True
        time.sleep(_LOOK_S)


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except PermissionError:  # left by another user
        return os.open(path, os.O_RDONLY)


def _is(file: int, path: Path) -> bool:
    """Whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _sign(file: int) -> None:
    said = {"pid": os.getpid(), "host": platform.node(), "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}
    with suppress(OSError):  # a full disk: the lock holds without
        os.ftruncate(file, 0)
        os.lseek(file, 0, os.SEEK_SET)
        os.write(file, json.dumps(said).encode())


def _who(file: int) -> str:
    """Who holds a lock, in words."""
    try:
        os.lseek(file, 0, os.SEEK_SET)
        said = json.loads(os.read(file, _SAID_BYTES))
        return f"process {int(said['pid'])} on {str(said['host'])[:64]} (since {str(said['since'])[:32]})"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return "another process"

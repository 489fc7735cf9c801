"""The system's own lock on an open file: it ends with its process, however that ends, so that none is ever stale."""

import errno
import sys

if sys.platform == "win32":
    import msvcrt
    import os
else:
    import fcntl

_HELD = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_BEYOND = 1 << 30  # Windows lets nobody read what is locked: lock a byte that no file has


class NoLocksError(Exception):
    """This file system knows no locks."""


def try_lock(file: int) -> bool:
    """Lock an open file for this process: False where another one, or another opening in this one, has it.

    Args:
        file: its number; the lock ends when it is closed, and with the process.

    Raises:
        NoLocksError: there are none on this file system.
    """
    try:
        if sys.platform == "win32":
            os.lseek(file, _BEYOND, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _HELD:
            return False
        raise NoLocksError from error
    return True

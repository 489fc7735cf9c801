"""Reading a file that a stranger may have made: a plain one, and no more of it than such a file can have."""

from pathlib import Path

from frasa_sysid.calibration.errors import InputError


def read_limited(path: Path, largest: int, error: type[InputError]) -> bytes:
    """The content of a file.

    Args:
        path: the file.
        largest: number of bytes that it may have.
        error: what is raised where it cannot be used.

    Raises:
        FileNotFoundError: there is none; who asks knows what to do about that.
        InputError: of the kind asked for: no plain file, or too large.
    """
    if path.exists() and not path.is_file():  # nor a device or a pipe, which never end
        raise error(f"{path} is {'a folder' if path.is_dir() else 'no plain file'}, expected a file")
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        size = f"{largest >> 20} MiB" if largest >= 2**20 else f"{largest >> 10} KiB"
        raise error(f"{path} is larger than {size}, which no such file is")
    return content

"""What input may make a process do: an audit hook that notes everything else.

Allowed are files of the input's folder, reading files of Python and its packages, and code of modules that are imported
lazily. `rosbags` makes a class of every message definition by executing text that it wrote from a parsed definition;
that is allowed, and `executed` by a definition would still be seen as what its code does (files, processes, imports).
"""

import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

events: set[str] = set()
_allowed: tuple[str, ...] = ()
_on = False
FORBIDDEN = (
    "os.system",
    "os.exec",
    "os.fork",
    "os.posix_spawn",
    "os.spawn",
    "subprocess.Popen",
    "socket.",
    "pty.spawn",
)
FORBIDDEN += ("pickle.find_class", "os.kill", "webbrowser.open", "ftplib.", "urllib.Request", "ctypes.dlopen")
WRITING = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.symlink", "os.link", "os.truncate", "shutil.")
PARSERS = ("ast.py", "rosbags/typesys/store.py", "rosbags/serde/utils.py", "dataclasses.py", "collections/__init__.py")
PARSERS += ("importlib", "numba/", "enum.py", "typing.py", "re/_", "functools.py", "inspect.py", "torch/", "_pytest")


def begin(folder: Path) -> None:
    """Note from here on what is not of a folder.

    Args:
        folder: of the inputs.
    """
    global _allowed, _on
    paths = sysconfig.get_paths()
    # The interpreter's own files: a venv's libraries and those of the Python it was made from.
    places = {folder, paths["stdlib"], paths["purelib"], paths["platlib"], sys.base_prefix + "/lib", "/dev/null"}
    places |= {"/proc/self", "/proc/meminfo", "/proc/cpuinfo", "/sys/", "/usr/share/zoneinfo", "/etc/mime.types"}
    places |= {Path(__file__).resolve().parents[3] / one for one in ("frasa_sysid", "frasa_rl", "tests")}
    _allowed = tuple(os.path.realpath(str(one)) for one in places)
    _on = True


def _hook(event: str, args: tuple[Any, ...]) -> None:
    if not _on:
        return
    if event.startswith(FORBIDDEN):
        events.add(f"{event} {str(args)[:120]}")
    elif event in ("exec", "compile"):
        if not _by_parser():
            events.add(f"{event} {str(args)[:120]}")
    elif event == "open":
        path, _, flags = args
        if isinstance(path, str | bytes | Path):
            _check(event, path, bool(isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR)))
    elif event.startswith(WRITING) and args and isinstance(args[0], str | bytes | Path):
        _check(event, args[0], True)


def _check(event: str, path: "str | bytes | Path", writes: bool) -> None:
    real = os.path.realpath(os.fsdecode(path))
    inside = real.startswith((*_allowed, _run())) and not (
        writes and not real.startswith((_input(), _run(), "/dev/null", "/proc/self"))
    )
    temporary = real.startswith("/tmp/") and "tmp" in Path(real).parts[2]
    if not inside and not temporary:
        events.add(f"{event} {real[:200]}{' to write' if writes else ''}")


def _input() -> str:
    return os.path.realpath(Path.cwd())


def _run() -> str:
    """The folder of the run that checkpoints are put into: taking one up writes its tables anew."""
    return os.path.realpath(os.environ.get("FRASA_FUZZ_RUN", Path.cwd()))


def _by_parser() -> bool:
    """Whether code is made by a module that only parses, or by an import."""
    frame = sys._getframe(2)
    for _ in range(6):
        if frame is None:
            return False
        name = frame.f_code.co_filename
        if any(one in name for one in PARSERS):
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


sys.addaudithook(_hook)

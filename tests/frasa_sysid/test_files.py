"""Outputs are whole or as they were before: after kill -9, on a full disk, and with two writers at once."""

import hashlib
import os
import random
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from frasa_sysid.calibration import OutputError, write_atomic, write_together

REPO = Path(__file__).parents[2]
# Writes contents that carry their own hash, for ever; says that it has begun.
WRITER = """
import hashlib, os, sys
from pathlib import Path
from frasa_sysid.calibration.files import write_atomic
path = Path(sys.argv[1])
print("ready", flush=True)
while True:
    data = os.urandom(300_000)
    write_atomic(path, hashlib.sha256(data).digest() + data)
"""
# Opens a temporary file as a writer does, and waits.
HALFWAY = """
import sys, time
from pathlib import Path
from frasa_sysid.calibration.files import _opened
file, name = _opened(Path(sys.argv[1]))
print(name, flush=True)
time.sleep(60)
"""


def python(code, *words):
    environment = {**os.environ, "PYTHONPATH": str(REPO)}
    return subprocess.Popen([sys.executable, "-c", code, *map(str, words)], env=environment, stdout=subprocess.PIPE)


def names(folder):
    return sorted(one.name for one in folder.iterdir())


def temporaries(folder):
    return [one for one in folder.iterdir() if one.name.endswith(".tmp")]


def test_killed_while_writing(tmp_path):
    """Two writers of one file, killed again and again: it is always of one of them, and leftovers go."""
    path, chance = tmp_path / "out.bin", random.Random(3)
    left = 0
    for _ in range(4):
        writers = [python(WRITER, path) for _ in range(2)]
        for one in writers:
            assert one.stdout.readline() == b"ready\n"
        while not path.exists() or not temporaries(tmp_path):
            assert all(one.poll() is None for one in writers)
        time.sleep(chance.uniform(0.0, 0.01))
        for one in writers:
            one.send_signal(signal.SIGKILL)
            one.wait()
            one.stdout.close()
        left = max(left, len(temporaries(tmp_path)))
        if path.exists():
            data = path.read_bytes()
            assert hashlib.sha256(data[32:]).digest() == data[:32]
    assert path.exists()
    write_atomic(path, "the last")
    assert names(tmp_path) == ["out.bin"]
    assert left <= 2  # they did not pile up


def test_what_another_one_writes_is_not_taken_for_a_leftover(tmp_path):
    """A temporary file goes when its writer is dead, and not before."""
    path = tmp_path / "out.json"
    other = python(HALFWAY, path)
    name = Path(other.stdout.readline().decode().strip())
    write_atomic(path, "one")
    assert name.exists()
    other.kill()
    other.wait()
    other.stdout.close()
    write_atomic(path, "two")
    assert names(tmp_path) == ["out.json"]


def test_a_full_disk_changes_nothing(tmp_path):
    """Of files that belong together none is replaced when one of them does not fit; the line says what to do."""
    code = """
import resource, sys
from pathlib import Path
from frasa_sysid.calibration import OutputError, write_together
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
folder = Path(sys.argv[1])
try:
    write_together({folder / "small": b"new", folder / "large": b"new" * 10_000})
except OutputError as error:
    print(error.exit_code, error)
"""
    write_together({tmp_path / "small": "old", tmp_path / "large": "old"})
    said = python(code, tmp_path).communicate()[0].decode()
    assert said.startswith(f"1 cannot write {tmp_path / 'large'}: the file would be larger than this system allows")
    assert "write elsewhere" in said
    assert said.endswith("is unchanged\n")
    assert [(tmp_path / name).read_text() for name in ("small", "large")] == ["old", "old"]
    assert names(tmp_path) == ["large", "small"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_stays_one():
    """/dev/full is written, which fails as a full disk does, and is not replaced by a file."""
    with pytest.raises(OutputError, match=r"cannot write /dev/full: the disk of .* is full.*: free some space"):
        write_atomic(Path("/dev/full"), "text")
    write_atomic(Path("/dev/null"), "text")
    for name in ("full", "null"):
        assert stat.S_ISCHR(Path("/dev", name).stat().st_mode)


@pytest.mark.parametrize(
    ("place", "words"),
    [("file/out.json", "cannot write .*out.json: .*"), ("folder", "cannot write .*folder: Is a dir")],
)
def test_a_place_that_cannot_be(tmp_path, place, words):
    """Below a file, or where a folder is: one line, and nothing is left."""
    (tmp_path / "file").write_text("old")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=words):
        write_atomic(tmp_path / place, "new")
    assert names(tmp_path) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "old"


def test_as_readable_as_any_new_file(tmp_path):
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "out", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o640

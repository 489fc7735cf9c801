"""Whether every file that a program left, killed at any moment, is whole; for `bench_kills.py`."""

import csv
import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np
import onnx
import yaml
from lxml import etree
from PIL import Image

from frasa_rl.policy import Policy, PolicyError
from frasa_rl.runtime import read_weights
from frasa_sysid.calibration import CalibrationError, load_calibration

LEFTOVER = re.compile(r"^\..*\.tmp$|^\.lock$|^\..*\.lock$|^\..*\.candidate\.xml$")
APPENDED = re.compile(r"^events\.out\.tfevents|\.log$")  # read up to their last whole record


def check(folder: Path) -> tuple[int, int, int]:
    """Read every file below a folder as its readers do.

    Returns:
        Files that are whole, leftovers (hidden, nobody's output), and pairs caught between two renames, which
        their reader refuses.

    Raises:
        AssertionError: a file that is not whole, or a pair that is taken although it does not belong together.
    """
    whole = left = 0
    for path in sorted(one for one in folder.rglob("*") if one.is_file()):
        inside = path.relative_to(folder).parts
        if LEFTOVER.match(path.name):
            left += 1
        elif "partial" in inside[:-1] or _superseded(path, inside):
            left += 1  # a checkpoint that has no name yet, or that a newer one has replaced
        elif not APPENDED.search(path.name):
            try:
                _read(path)
            except Exception as error:
                raise AssertionError(f"{path} is not whole: {error!r}") from error
            whole += 1
    return whole, left, _torn(folder)


def _superseded(path: Path, inside: tuple[str, ...]) -> bool:
    if "checkpoints" not in inside:
        return False
    every = sorted(one.name for one in path.parent.parent.iterdir() if one.name[:1].isdigit())
    return path.parent.name != every[-1]


def _read(path: Path) -> None:
    kind, data = path.suffix, path.read_bytes()
    if kind == ".json":
        assert isinstance(json.loads(data), dict)
    elif kind == ".yaml":
        assert isinstance(yaml.safe_load(data), dict)
    elif kind == ".xml":
        etree.fromstring(data)
    elif kind == ".safetensors":
        read_weights(path)
    elif kind == ".onnx":
        onnx.checker.check_model(onnx.load_from_string(data))
    elif kind == ".csv":
        rows = list(csv.reader(io.StringIO(data.decode())))
        assert data.endswith(b"\n")
        assert len({len(row) for row in rows}) == 1
        assert all(one == "" or np.isfinite(float(one)) for row in rows[1:] for one in row)
    elif kind == ".html":
        assert data.rstrip().endswith(b"</html>")
    elif kind == ".png":
        Image.open(io.BytesIO(data)).load()
    elif kind == ".zip":
        assert zipfile.ZipFile(path).testzip() is None
    elif kind == ".npz":
        with np.load(path, allow_pickle=False) as file:
            assert all(file[name].size >= 0 for name in file.files)
    elif kind == ".txt":
        assert data.decode().endswith("\n")
    elif kind == ".mcap":
        assert data.endswith(b"\x89MCAP0\r\n")
    else:
        raise ValueError("nobody knows this kind of file")


def _torn(folder: Path) -> int:
    """Pairs that are of two writings; whoever reads them must say so."""
    torn = 0
    for path in folder.rglob("calibrated.xml"):
        try:
            load_calibration(path)
        except CalibrationError as error:
            _expected(error, "carries calibration id", "no ranges file")
            torn += 1
    for path in folder.rglob("weights.safetensors"):
        try:
            Policy.load(path.parent)
        except PolicyError as error:
            _expected(error, "are of different policies", "expected the folder of a run")
            torn += 1
    return torn


def _expected(error: Exception, *words: str) -> None:
    if not any(one in str(error) for one in words):
        raise AssertionError(f"{error!r}") from error

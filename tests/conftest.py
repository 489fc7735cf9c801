"""Paths, and a hand-made fit of a whole robot, that several test folders need."""

import json
import os
import resource
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import frasa_rl  # noqa: F401 (before MuJoCo, which draws without a display then)
import frasa_sysid  # noqa: F401 (before numpy, whose threads it keeps to one)

# isort: split
import numpy as np
from mcap.reader import make_reader

from frasa_sysid.calibration import load_model, servo_law
from frasa_sysid.model_mark import mark_of
from frasa_sysid.robot_fit_record import RobotEstimate, RobotFitRecord, base_numbers, with_products
from frasa_sysid.stored_fit import StoredFit

REPO_ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Pools of starts are kept where no other run of the tests sees them."""
    os.environ["FRASA_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def law_as_before() -> Iterator[None]:
    """Loading a model installs its friction law for the process; what follows in it shall not notice."""
    before = servo_law.installed()
    yield
    if not before:
        servo_law.uninstall()


@contextmanager
def _no_file_above(size: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def no_file_above() -> Callable[[int], AbstractContextManager[None]]:
    """A full disk that any machine has: within it, files of this process may have so many bytes."""
    return _no_file_above


def _contents(folder: Path) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


@pytest.fixture
def contents() -> Callable[[Path], dict[str, bytes]]:
    """All files of a folder, by path below it."""
    return _contents


@pytest.fixture(scope="session")
def made_of() -> Callable[[Path], dict[str, Any]]:
    """What an MCAP says that it was made of: its `frasa.made` record."""

    def read(path: Path) -> dict[str, Any]:
        with path.open("rb") as file:
            (record,) = (one for one in make_reader(file).iter_metadata() if one.name == "frasa.made")
        return {name: json.loads(value) for name, value in record.metadata.items()}

    return read


@pytest.fixture(scope="session")
def robot_model_dir() -> Path:
    """The folder of the robot's XML files."""
    return REPO_ROOT / "robot_model"


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Reference material beside the repository; tests that need it are skipped elsewhere."""
    path = REPO_ROOT.parent / "shared"
    if not path.is_dir():
        pytest.skip("no reference tables: expected a folder 'shared' beside the repository")
    return path


class _Page(HTMLParser):
    """Elements opened and closed in order, and everything a page would load or lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str | None] = []
        self.names: list[str | None] = []
        self.texts: list[str] = []
        self.scripts = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self.sources += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]
        self.names += [value for name, value in attrs if name == "id"]
        if tag not in ("meta", "img", "br", "line", "rect", "circle", "path"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag in ("td", "th", "p", "div", "h1", "h2", "h3", "li", "small", "figcaption"):
            self.texts.append(" ")

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="session")
def page_text() -> Callable[[Path], str]:
    """Gives the text of a page, after the page was found to be whole, small, and in need of nothing else."""

    def checked(path: Path) -> str:
        page = path.read_text(encoding="utf-8")
        found = _Page()
        found.feed(page)
        assert found.open == []
        assert found.scripts == 1
        for source in found.sources:
            assert source is not None
            assert source.startswith(("data:image/png;base64,", "data:image/webp;base64,")) or source[1:] in found.names
        assert len(found.names) == len(set(found.names))
        assert "Content-Security-Policy" in page
        assert "default-src 'none'" in page
        for word in ("http:", "https:", "url(", "@import", "file:"):
            assert word not in page
        assert path.stat().st_size < 5_000_000
        return " ".join("".join(found.texts).split())

    return checked


# What the virtual robot's fit finds: no delay is a multiple of the step of 2 ms, and one needs a longer history.
ROBOT_DELAYS = {
    "sensor.position_delay": 0.0043,
    "sensor.velocity_delay": 0.0317,
    "sensor.gyro_delay": 0.0529,
    "sensor.orientation_delay": 0.0911,
    "mx64.delay": 0.0057,
    "mx106.delay": 0.0371,
}
ROBOT_ZEROS = {
    "left_knee.zero": -0.0213,
    "right_knee.zero": 0.0171,
    "left_hip_yaw.zero": 0.0087,
    "head_pitch.zero": 0.0,
}
ROBOT_TRUNK = {"trunk.mass": 3.41, "trunk.com_x": -0.0021, "trunk.com_z": 0.0733}
ROBOT_SCALES = {"mx106.gain_scale": 0.93, "mx106.damping_scale": 1.08, "mx106.friction_scale": 1.25}


@pytest.fixture(scope="session")
def robot_record(robot_model_dir: Path) -> Callable[..., RobotFitRecord]:
    """A maker of fits of the whole robot, as the fitter writes them, on the bench fits it is given."""
    nominal = load_model(robot_model_dir / "nominal.xml")

    def estimate(name: str, value: float, base: float, half: float) -> RobotEstimate:
        spread, verdict = (value - 2 * half, value + half), "identified"
        if name == "head_pitch.zero":
            spread, verdict = (value, value), "not excited"
        return RobotEstimate(name, value, value - half, value + half, verdict, base, spread, (value - half, value))

    def make(fits: Sequence[StoredFit] = (), **changes: object) -> RobotFitRecord:
        base = base_numbers(nominal, fits)
        plain = {**ROBOT_DELAYS, **ROBOT_ZEROS, **ROBOT_TRUNK}
        half = {"zero": 0.001, "mass": 0.03}
        found = [
            estimate(name, value, base.get(name, 0.0), half.get(name.rpartition(".")[2], 0.0004))
            for name, value in plain.items()
        ]
        scales = [estimate(name, value, 1.0, 0.03) for name, value in ROBOT_SCALES.items()]
        free = [one.name for one in (*found, *scales)]
        matrix = np.eye(len(free))
        matrix[2, 3] = matrix[3, 2] = 0.8  # gyro and orientation come over one bus
        matrix[-3, -2] = matrix[-2, -3] = -0.6  # gain and damping
        facts = {
            "estimates": with_products((*found, *scales), base),
            "correlated": tuple(free),
            "correlation": matrix,
            "base": "fixed",
            "model": mark_of(nominal),
            "stated": {"supply_voltage": 15.0, "firmware_gain": 12.0},
            "frozen": tuple(one.sha256 for one in fits),
            "inputs": {"robot.mcap": "0" * 64},
            "origin": "simulated",
            "supply_voltage": (13.9, 16.1),
            "delay_jitter": (-0.0003, 0.0005),
            "not_in_model": ("position delay: known as a sum with the command delay only",),
        }
        return RobotFitRecord(**{**facts, **changes})

    return make


@pytest.fixture
def model_dir(robot_model_dir: Path, tmp_path: Path) -> Path:
    """A copy of the nominal robot model in a folder of its own."""
    folder = tmp_path / "robot_model"
    folder.mkdir()
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, folder)
    return folder

"""The compiled models and the source's tables."""

import csv
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

Rows = list[dict[str, str]]


@pytest.fixture(scope="session")
def table(shared_dir: Path) -> Callable[[str], Rows]:
    """A reader of one table of the robot's facts."""
    folder = shared_dir / "robot_facts"
    if not folder.is_dir():
        pytest.skip("no reference tables: expected a folder 'shared/robot_facts' beside the repository")

    def read(name: str) -> Rows:
        with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    return read


@pytest.fixture
def nominal(robot_model_dir: Path) -> mujoco.MjModel:
    """The nominal robot, fresh for each test."""
    return mujoco.MjModel.from_xml_path(str(robot_model_dir / "nominal.xml"))


@pytest.fixture
def calibrated(robot_model_dir: Path) -> mujoco.MjModel:
    """The published robot, fresh for each test."""
    return mujoco.MjModel.from_xml_path(str(robot_model_dir / "calibrated.xml"))


@pytest.fixture
def bench(robot_model_dir: Path) -> mujoco.MjModel:
    """The bench pendulum, fresh for each test."""
    return mujoco.MjModel.from_xml_path(str(robot_model_dir / "bench_pendulum.xml"))

"""Paths that several test folders need."""

from pathlib import Path

import pytest

import frasa_sysid  # noqa: F401 (before numpy, whose threads it keeps to one)

REPO_ROOT = Path(__file__).resolve().parent.parent


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

import subprocess
import sys
from pathlib import Path

import pytest

REPO_ROOT = Path(__file__).resolve().parent.parent


def test_contracts_between_packages_and_files():
    """The import contracts of pyproject.toml hold: one way inside frasa_sysid, a narrow gate to frasa_rl."""
    script = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", script], cwd=REPO_ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("frasa_sysid", {"torch", "matplotlib", "frasa_rl"}),
        ("frasa_sysid.cli", {"torch", "matplotlib", "frasa_rl", "gymnasium"}),
        ("frasa_sysid.calibration", {"torch", "matplotlib", "cmaes", "mcap", "scipy", "lxml", "pandas"}),
        ("frasa_rl", {"torch", "matplotlib", "cmaes", "mcap"}),
    ],
)
def test_imports_are_light(module, unwanted):
    """Importing a package brings in nothing heavy that the imported part does not use."""
    script = f"import sys, {module}; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], cwd=REPO_ROOT, capture_output=True, text=True, check=True)
    assert not unwanted & set(done.stdout.split())

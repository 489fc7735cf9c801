"""A fit with known numbers: twice in a row the same bytes, elsewhere the same numbers; and what its files carry."""

import json
import platform
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from frasa_sysid.calibration import model_sha256, run_command, sha256_of_file
from frasa_sysid.cli import build_parser

GOLDEN = Path(__file__).parent / "golden_fit.json"
LOG = Path(__file__).parents[2] / "bench_logs" / "mx106.mcap"
SEED = 7
# Other processors round sums in another order: a search may end elsewhere on the flat bottom of its valley.
OF_INTERVAL = 0.05  # share of a 95 % interval's half-width that a value may be away from the golden one
OF_MISFIT = 1e-3
PACKAGES = {"frasa", "mujoco", "numpy", "scipy", "numba", "cmaes", "python"}
HASH = re.compile("[0-9a-f]{64}")


def fitted(folder, capsys):
    words = ["fit", LOG, "--model", folder / "nominal.xml", "--seed", SEED, "--no-report", "--publish", "--json"]
    assert run_command(build_parser(), [str(one) for one in words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def two(model_dir, tmp_path, capsys):
    """Two fits in a row, each in a folder of its own; what the second one prints."""
    folders = [tmp_path / name / "robot_model" for name in ("one", "two")]
    for folder in folders:
        folder.mkdir(parents=True)
        for path in model_dir.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
    return folders, [fitted(folder, capsys) for folder in folders][1]


def test_golden_fit(two, capsys):
    """The same bytes in three files, the golden numbers, and hashes, seed and versions in all of them."""
    (one, other), said = two
    for name in ("fits/mx106.json", "calibrated.xml", "randomization.yaml"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    fit = json.loads((other / "fits" / "mx106.json").read_text())
    golden = json.loads(GOLDEN.read_text())
    assert set(fit["parameters"]) == set(golden["parameters"])
    for name, (value, low, high) in golden["parameters"].items():
        allowed = OF_INTERVAL * (high - low) / 2.0
        assert fit["parameters"][name]["value"] == pytest.approx(value, abs=allowed), name
    assert fit["misfit"]["fitted"]["mae_rad"] == pytest.approx(golden["mae_rad"], rel=OF_MISFIT)

    assert fit["seed"] == SEED
    assert fit["inputs"] == {LOG.name: sha256_of_file(LOG)}
    assert set(fit["models"]) == {"nominal.xml", "bench_pendulum.xml"}
    assert fit["models"]["nominal.xml"] == model_sha256(mujoco.MjModel.from_xml_path(str(other / "nominal.xml")))
    assert set(fit["versions"]) == PACKAGES
    assert (fit["versions"]["numpy"], fit["versions"]["python"]) == (np.__version__, platform.python_version())

    made_from = yaml.safe_load((other / "randomization.yaml").read_text())["made_from"]
    assert made_from["fits"] == {"mx106": sha256_of_file(other / "fits" / "mx106.json")}
    assert made_from["logs"] == fit["inputs"]
    assert HASH.fullmatch(made_from["nominal"]["nominal.xml"])
    assert made_from["versions"] == {"frasa": fit["versions"]["frasa"]}
    head = (other / "calibrated.xml").read_text()
    assert f"fit {made_from['fits']['mx106'][:12]}" in head
    assert f"frasa {fit['versions']['frasa']}" in head
    assert said["versions"] == fit["versions"]

    kept = other / "fits" / "mx106.json"
    words = {
        "inspect": [LOG],
        "compare": [LOG, "--model", other / "nominal.xml", "--fit", kept, "--no-report"],
        "publish": [kept, "--model", other / "nominal.xml", "--out", other / "again.xml"],
        "export-bam": [kept, "--out", other / "m1.json"],
    }
    for command, more in words.items():
        assert run_command(build_parser(), [command, *(str(one) for one in more), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert {"frasa", "mujoco", "numpy", "python"} <= set(told["versions"]), command
        hashes = told["inputs"]
        assert all(HASH.fullmatch(one) for one in hashes.values()), command
        wanted = {LOG.name: sha256_of_file(LOG)} if command in ("inspect", "compare") else {}
        wanted |= {kept.name: sha256_of_file(kept)} if command != "inspect" else {}
        assert wanted.items() <= hashes.items(), command

"""Run folders, sweeps, exports and evaluations that another process writes are left to it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytest.importorskip("sb3_contrib")

from frasa_rl.cli import main
from frasa_rl.policy import Policy, PolicyError

POLICY = Path(__file__).parents[2] / "robot_model" / "policies" / "standup"
HOLDER = """
import sys, time
from pathlib import Path
from frasa_sysid.calibration.locks import alone
with alone(Path(sys.argv[1]), folder=True):
    print("held", flush=True)
    time.sleep(60.0)
"""


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A folder that another process writes, and its pid."""
    folder = tmp_path_factory.mktemp("busy") / "out"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(folder)], env=environment, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"held\n"
    yield folder, process.pid
    process.kill()
    process.communicate()


@pytest.mark.parametrize(
    "words",
    [
        ["train", "--steps", "8"],
        ["sweep", "--seeds", "2", "--steps", "8"],
        ["evaluate", str(POLICY), "--trials", "1"],
        ["export", str(POLICY), "--allow-other-model"],
    ],
    ids=lambda words: words[0],
)
def test_busy(held, robot_model_dir, capsys, words):
    """One line says who has it; exit 1; nothing is written."""
    folder, pid = held
    assert main([*words, "--model", str(robot_model_dir / "nominal.xml"), "--out", str(folder)]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"{folder} is being written by process {pid} on" in err
    assert [one.name for one in folder.iterdir()] == [".lock"]


def test_weights_and_their_description_belong_together(tmp_path):
    """As they are after a kill between two renames, they are refused."""
    policy = Policy.load(POLICY)
    policy.save(tmp_path)
    assert Policy.load(tmp_path).run == policy.run
    said = yaml.safe_load((tmp_path / "run.yaml").read_text())
    (tmp_path / "run.yaml").write_text(yaml.safe_dump({**said, "weights_sha256": "0" * 64}))
    with pytest.raises(PolicyError, match="are of different policies"):
        Policy.load(tmp_path)

"""A disk that fills (here: files that may not grow): one line, exit 1, what was there stays, and later it goes on.

On a real full disk: tests/benchmarks/bench_full_disk.py.
"""

from pathlib import Path

import pytest

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser

LOG = Path(__file__).parents[2] / "bench_logs" / "mx64.mcap"


@pytest.fixture(scope="module")
def fitted(robot_model_dir, tmp_path_factory):
    """A folder with a robot, a fit and its publication."""
    folder = tmp_path_factory.mktemp("full")
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            (folder / path.name).write_bytes(path.read_bytes())
    words = ["fit", str(LOG), "--model", str(folder / "nominal.xml"), "--publish", "--no-report"]
    assert run_command(build_parser(), words) == 0
    return folder


@pytest.mark.parametrize(
    ("command", "size", "lacking"),
    [
        ("fit LOG --model nominal.xml --publish --no-report --seed 5", 500, "fits/mx64.partial.json"),
        ("publish fits/mx64.json --model nominal.xml --as m1", 500, "write calibrated.xml"),
        ("publish fits/mx64.json --model nominal.xml", 2_200, "write calibrated.xml"),
        ("excite --base floating --model nominal.xml --out goals.mcap --csv --seconds 12", 50_000, "goals.mcap"),
        ("export-bam fits/mx64.json --out m1.json", 50, "m1.json"),
    ],
)
def test_full(fitted, monkeypatch, capsys, no_file_above, contents, command, size, lacking):
    """Each command that writes says what it could not write and what to do; the files it did not get to are the old."""
    monkeypatch.chdir(fitted)
    words = [str(LOG) if one == "LOG" else one for one in command.split()]
    before = contents(fitted)
    with no_file_above(size):
        assert run_command(build_parser(), words) == 1
    last = capsys.readouterr().err.rstrip("\n").rpartition("\n")[2]
    assert last.startswith("frasa-sysid: cannot write ")
    assert last.endswith("(ulimit -f): raise the limit, or write elsewhere; what was there before is unchanged")
    assert lacking in last
    after = contents(fitted)
    changed = {name for name in {*before, *after} if before.get(name) != after.get(name)}
    allowed = {"fits/mx64.json", "fits/mx64.partial.json"} if command.startswith("fit") else set()
    assert changed <= allowed, "what belongs to no finished step was changed"
    assert not [name for name in after if Path(name).name.startswith(".")]
    assert run_command(build_parser(), words) == 0
    assert not [name for name in contents(fitted) if "partial" in name or Path(name).name.startswith(".")]

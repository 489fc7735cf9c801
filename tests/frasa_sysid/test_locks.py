"""One process at a time writes an output, whoever dies meanwhile."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from frasa_sysid.calibration import BusyError, alone, load_calibration, load_model, run_command
from frasa_sysid.cli import build_parser

REPO = Path(__file__).parents[2]
HOLDER = """
import sys, time
from pathlib import Path
from frasa_sysid.calibration.locks import alone
with alone(Path(sys.argv[1]), folder=sys.argv[2] == "folder"):
    print("held", flush=True)
    time.sleep(float(sys.argv[3]))
"""


class Holder:
    """Another process that writes an output."""

    def __init__(self, output, kind="file", seconds=60.0):
        environment = {**os.environ, "PYTHONPATH": str(REPO)}
        words = [sys.executable, "-c", HOLDER, str(output), kind, str(seconds)]
        self.process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE)
        assert self.process.stdout.readline() == b"held\n"

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_the_second_process_is_told_who_has_it(tmp_path, kind):
    """Pid and host in one line; kill -9 of the first frees it at once, although its lock file is still there."""
    output, folder = tmp_path / "out", kind == "folder"
    first = Holder(output, kind)
    try:
        told = rf"{output} is being written by process {first.process.pid} on \S+ \(since .*\): wait"
        with pytest.raises(BusyError, match=told) as raised, alone(output, folder=folder):
            pass
        assert raised.value.exit_code == 1
    finally:
        first.kill()
    locks = list(tmp_path.rglob(".*lock"))
    assert len(locks) == 1
    with alone(output, folder=folder):
        assert locks[0].read_text().startswith(f'{{"pid": {os.getpid()},')
    assert list(tmp_path.rglob(".*lock")) == []


def test_who_is_patient_waits(tmp_path, capsys):
    """And is told for whom, when it takes longer."""
    first = Holder(tmp_path / "out", seconds=2.4)
    with alone(tmp_path / "out", patience_s=30.0):
        assert first.process.wait(10.0) == 0
    assert f"waiting for process {first.process.pid} on" in capsys.readouterr().err
    first.process.stdout.close()


def test_one_at_a_time(tmp_path):
    """Eight threads: nobody is inside with another one, however often the lock file comes and goes."""
    inside, most, entered = [], [], []

    def work():
        for _ in range(25):
            with alone(tmp_path / "out", patience_s=60.0):
                inside.append(1)
                most.append(len(inside))
                inside.pop()
            entered.append(1)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert max(most) == 1
    assert len(entered) == 200
    assert list(tmp_path.iterdir()) == []


def test_a_thread_may_ask_again(tmp_path):
    """A command holds what the function that it calls holds, too."""
    with alone(tmp_path / "run", folder=True):
        with alone(tmp_path / "run", folder=True):
            pass
        assert (tmp_path / "run" / ".lock").exists()


def test_folders_stay_where_something_came_of_them(tmp_path):
    """Those that were made for the lock go with it; not those that were there, nor those that hold something now."""
    (tmp_path / "there").mkdir()
    with alone(tmp_path / "there" / "runs" / "one", folder=True):
        pass
    assert [one.name for one in tmp_path.rglob("*")] == ["there"]
    with alone(tmp_path / "there" / "runs" / "one", folder=True):
        (tmp_path / "there" / "runs" / "other").touch()
    assert [one.name for one in (tmp_path / "there" / "runs").rglob("*")] == ["other"]


def frasa(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "frasa_sysid.cli", *map(str, words)],
        env={**os.environ, "PYTHONPATH": str(REPO)},
        stderr=subprocess.PIPE,
        text=True,
    )


def test_a_fit_that_another_process_makes_is_refused(model_dir, capsys):
    """One line, exit 1, before any work; nothing is written."""
    out = model_dir / "fits" / "mx106.json"
    first = Holder(out)
    try:
        words = ["fit", REPO / "bench_logs" / "mx106.mcap", "--model", model_dir / "nominal.xml"]
        assert run_command(build_parser(), [str(one) for one in words]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert f"is being written by process {first.process.pid} on" in err
    finally:
        first.kill()
    assert [one.name for one in (model_dir / "fits").iterdir()] == [".mx106.json.lock"]


def test_two_publications_do_not_mix(model_dir, robot_model_dir):
    """Each writes model and ranges of its own calibration: whoever is last, both files are of one of them."""
    fits = sorted(one for one in (robot_model_dir / "fits").glob("mx*.json"))
    words = ["publish", *fits, "--model", model_dir / "nominal.xml"]
    both = [frasa(*words), frasa(*words, "--as", "m1")]
    out = model_dir / "calibrated.xml"
    for one in both:
        said = one.communicate(timeout=300)[1]
        assert one.returncode == 0, said
    load_calibration(out)
    assert load_model(out).nu > 0
    assert not [one.name for one in model_dir.iterdir() if one.name.startswith(".")]

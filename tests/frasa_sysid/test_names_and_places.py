"""Odd names, odd locales, many files, folders that nobody may write: the command line works, or says why in a line."""

import json
import os
import resource
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.readers import read_log
from frasa_sysid.writer import write_mcap

ROOT = Path(__file__).parents[2]
ODD = "日本 é 'q\" <b>&amp; 🤖 [red]x $_{"
COMMAND = [sys.executable, "-m", "frasa_sysid.cli"]


@pytest.fixture(scope="module")
def runs():
    return read_log(ROOT / "bench_logs/mx106.mcap")[:2]


@pytest.fixture(scope="module")
def place(tmp_path_factory, runs):
    """A folder of an odd name with a model and two logs, one of whose names begins with a dash."""
    folder = tmp_path_factory.mktemp("names") / ODD
    shutil.copytree(ROOT / "robot_model", folder / "mödel", ignore=shutil.ignore_patterns("policies", "fits"))
    write_mcap(folder / f"lög {ODD}.mcap", runs[:1])
    write_mcap(folder / "-dash.mcap", runs[1:])
    return folder


def run(*words):
    return run_command(build_parser(), [str(word) for word in words])


def child(words, **options):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **options.pop("environment", {})}
    return subprocess.run(words, capture_output=True, env=environment, cwd=ROOT, timeout=300, check=False, **options)


@pytest.fixture(scope="module")
def fitted(place):
    logs = (place / f"lög {ODD}.mcap", place / "-dash.mcap")
    out = place / "mödel/fits/mx106.json"
    words = ("--model", place / "mödel/nominal.xml", "--evaluations", 40, "--restarts", 1, "--out", out)
    assert run("fit", *logs, *words) == 0
    return out


def test_a_fit_with_odd_names(fitted):
    """File and page hold the names as they are, in their own way of writing them."""
    data = json.loads(fitted.read_text(encoding="utf-8"))
    assert f"lög {ODD}.mcap" in data["inputs"]
    page = fitted.with_suffix(".html").read_text(encoding="utf-8")
    assert "<b>&amp; 🤖" not in page
    assert "&lt;b&gt;&amp;amp; 🤖" in page


def test_what_follows_a_fit(place, fitted, monkeypatch, recwarn):
    """Publishing, comparing, importing, exporting with odd names on both sides; pictures warn of no letters."""
    model, log = place / "mödel/nominal.xml", place / f"lög {ODD}.mcap"
    published = place / "öther/cäl <&> \"'.xml"
    assert run("publish", fitted, "--model", model, "--out", published) == 0
    ElementTree.parse(published)
    assert yaml.safe_load((published.parent / "randomization.yaml").read_text(encoding="utf-8"))
    both, page = place / "böth.mcap", place / "-rép <i>.html"
    assert run("compare", log, "--model", model, "--fit", fitted, "--report", page, "--mcap", both) == 0
    assert read_log(both)
    assert run("import", log, "--format", "mcap", "--out", place / "-impört") == 0
    assert read_log(place / f"-impört/lög {ODD}.mcap")[0].rig.servo == "mx106"
    assert run("export-bam", fitted, "--out", place / "bäm.json") == 0
    monkeypatch.chdir(place)
    assert run("inspect", "--", "-dash.mcap") == 0
    assert not [one for one in recwarn if "Glyph" in str(one.message)]


def test_a_locale_without_letters(place, tmp_path):
    """With LC_ALL=C and without UTF-8 mode Python reads names as ASCII: the command starts over in UTF-8."""
    fit = ROOT / "robot_model/fits/mx106.json"
    out = tmp_path / f"{ODD}.xml"
    words = ["publish", str(fit), "--model", str(place / "mödel/nominal.xml"), "--out", str(out)]
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = child([*COMMAND, *words], environment=locale)
    assert done.returncode == 0, done.stderr
    ElementTree.parse(out)


def test_a_name_that_is_not_utf_8(tmp_path, capsys):
    """No model, page or log can hold such a name: one line says so."""
    name = os.fsdecode(bytes(tmp_path) + b"/l\xffg.mcap")
    assert run("inspect", name) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not UTF-8" in line


def test_names_as_long_as_they_may_be(tmp_path, runs, capsys):
    """255 bytes: a log of such a name is read, and its import has the same name."""
    log = tmp_path / f"{'é' * 125}.mcap"
    write_mcap(log, runs[:1])
    assert run("import", log, "--format", "mcap", "--out", tmp_path / "out") == 0
    assert read_log(tmp_path / "out" / log.name)
    assert run("inspect", tmp_path / f"{'é' * 200}.mcap") in (1, 3)
    assert "Traceback" not in capsys.readouterr().err


def test_many_logs_with_few_open_files(tmp_path, runs):
    """A hundred logs with 48 open files allowed: one table, a line a rig, within a screen or two."""
    write_mcap(tmp_path / "a.mcap", runs[:1])
    data = (tmp_path / "a.mcap").read_bytes()
    for i in range(100):
        (tmp_path / f"log{i:03d}.mcap").write_bytes(data)
    logs = [str(path) for path in sorted(tmp_path.glob("log*.mcap"))]
    done = child([*COMMAND, "inspect", *logs], preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (48, 48)))
    assert done.returncode == 0, done.stderr
    assert b"100 recordings" in done.stderr
    assert len(done.stderr.splitlines()) < 100


def mounted(script):
    """A child that sees some folders read-only, and no network; skips where that is not allowed."""
    if shutil.which("unshare") is None or child(["unshare", "-m", "-n", "true"]).returncode:
        pytest.skip("read-only mounts need unshare and the right to use it")
    return child(["unshare", "-m", "-n", "sh", "-c", f"set -e\n{script}"])


def test_an_installation_that_nobody_may_write(tmp_path, runs):
    """No folder for compiled code, no home, no network, read-only logs: said in a line, and it works."""
    write_mcap(tmp_path / "logs/a.mcap", runs[:1])
    script = f"""
    for folder in {ROOT} {tmp_path}/logs; do mount --bind $folder $folder; mount -o remount,ro,bind $folder; done
    cd {ROOT}
    export HOME=/proc/nowhere; unset XDG_CACHE_HOME NUMBA_CACHE_DIR DISPLAY MUJOCO_GL
    {sys.executable} -m frasa_sysid.cli inspect {tmp_path}/logs/a.mcap
    {sys.executable} -m frasa_sysid.cli import {tmp_path}/logs/a.mcap --format mcap --out {tmp_path}/logs/out || echo $?
    """
    done = mounted(script)
    text = done.stderr.decode()
    assert done.returncode == 0, text
    assert "compiled code cannot be kept" in text
    assert "NUMBA_CACHE_DIR=FOLDER" in text
    assert done.stdout.decode().split() == ["1"]
    assert "cannot write" in text
    assert "Traceback" not in text

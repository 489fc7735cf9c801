"""Every command, Python block and map in the guide and the README runs, in order, and prints what its page shows."""

import argparse
import contextlib
import importlib.util
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import frasa_rl.cli
import frasa_sysid.cli
from frasa_sysid.calibration import servo_law
from frasa_sysid.readers.signal_map import parse_map

pytest.importorskip("sb3_contrib")
pytest.importorskip("onnx")

ROOT = Path(__file__).resolve().parents[3]
GUIDE = ROOT / "notebooks" / "guide"
PAGES = [ROOT / "README.md", *sorted(one for one in GUIDE.rglob("*.md") if one.parent.name != "generated")]
PROGRAMS = {"frasa-sysid": frasa_sysid.cli.build_parser, "frasa-rl": frasa_rl.cli.build_parser}


def _loaded(path):
    spec = importlib.util.spec_from_file_location(f"guide_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


BLOCKS = _loaded(GUIDE / "extensions" / "blocks.py")
SHOWN = _loaded(GUIDE / "extensions" / "shown.py")


@pytest.fixture(scope="module")
def law_once():
    """Loading models installs a friction law for the process; what follows in it shall not notice."""
    before = servo_law.installed()
    yield
    if not before:
        servo_law.uninstall()


@pytest.fixture
def copy(tmp_path, monkeypatch, law_once):
    """A scratch copy of the repository's data, the working folder of a page's reader."""
    for name in ("robot_model", "bench_logs", "tests/frasa_rl/heron"):
        shutil.copytree(ROOT / name, tmp_path / name)
    shutil.copytree(GUIDE, tmp_path / "notebooks" / "guide", ignore=shutil.ignore_patterns("generated", "__pycache__"))
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_runs(page, copy):
    """What a page asks its reader to run runs from its first block to its last."""
    names = {"__name__": "guide"}
    for block in BLOCKS.blocks(page):
        where = f"{page.relative_to(ROOT)}:{block.line}"
        if block.language == "python":
            exec(compile(block.text, where, "exec"), names)  # the page's own text
        elif block.language == "toml":
            tomllib.loads(block.text)
            if name := re.match(r"# (\S+\.toml)\n", block.text):
                Path(name[1]).write_text(block.text)
            if "[[signal]]" in block.text:
                parse_map(where, block.text.encode(), builtin=False)
        for command in block.commands:
            _check(command, where)


def _check(command, where):
    for one in command.before:
        _, status = _run(one)
        assert status == 0, f"{where}: {one}"
    if command.unrun:
        _parse(shlex.split(command.text), where)
        return
    printed, status = _run(command.text, shlex.split(command.options))
    assert status == command.status, f"{where}: {command.text}\nended with {status}\n{printed[-3000:]}"
    missing = SHOWN.missing(command.shown, printed)
    assert missing is None, f"{where}: {command.text}\ndoes not print: {missing}\nbut:\n{printed[-6000:]}"


def _run(line, options=()):
    """What a command prints and its exit status; our own programs run in this process, which is imported already."""
    words = shlex.split(line)
    if words[0] not in PROGRAMS or {"|", ">", "&&", ";"} & set(words):
        assert not options, line
        done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
        return done.stdout + done.stderr, done.returncode
    words, text = SHOWN.changed(words, options), io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", words)
        try:
            status = {"frasa-sysid": frasa_sysid.cli.main, "frasa-rl": frasa_rl.cli.main}[words[0]]()
        except SystemExit as end:
            status = end.code or 0
    return text.getvalue(), status


def _parse(words, where):
    """Arguments that a program takes, a target that make has, extras and requirements that there are."""
    if words[0] in PROGRAMS:
        parsed = PROGRAMS[words[0]]().parse_args(words[1:])
        assert isinstance(parsed, argparse.Namespace)
    elif words[0] == "make":
        done = subprocess.run(["make", "-n", *words[1:]], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{where}: {done.stderr}"
    elif "frasa[" in (line := " ".join(words)):
        extras = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]
        asked = {one.strip() for found in re.findall(r"frasa\[(.*?)\]", line) for one in found.split(",")}
        assert asked <= set(extras), where
    else:
        assert shutil.which(words[0]) or words[0] in ("git", "dask", "."), where


def test_no_command_is_left_out():
    """Every line of the README and the guide that begins with one of our programs is in a block that is run."""
    for page in PAGES:
        found = {one.text for block in BLOCKS.blocks(page) for one in block.commands}
        text = re.sub(r"<!-- run\n.*?-->", "", page.read_text(), flags=re.DOTALL)
        for line in text.splitlines():
            text = line.strip().removeprefix("$ ")
            if re.match(r"(frasa-sysid|frasa-rl|make) [a-z]", text) and line.startswith((" ", "$", "frasa", "make")):
                start = re.sub(r"\s+#\s.*$", "", text).rstrip("\\ ")
                assert any(one.startswith(start) for one in found), f"{page.name}: {line}"


@pytest.mark.parametrize(
    ("shown", "printed", "fits"),
    [
        (["kp = 26.6 N m/rad"], "kp = 26.7 N m/rad", True),
        (["kp = 26.6 N m/rad"], "kp = 31.7 N m/rad", False),
        (["kp = 26.6 N m/rad"], "ki = 26.6 N m/rad", False),
        (["first", "second"], "second\nfirst", False),
        (["36 runs ..."], "36 runs of 6 s", True),
        (["| kp | 26.6 |"], "┃ kp  │ 26.6 │", True),
        (["identified"], "", False),
        (["...", "done in 1.2 s"], "a\nb\ndone in 9.9 s", False),
    ],
)
def test_what_is_shown_is_held_against_what_is_printed(shown, printed, fits):
    """Words must be the same and in order, numbers about the same."""
    assert (SHOWN.missing(shown, printed) is None) is fits


def test_options_replace_those_of_the_page():
    """A test's own options take the place of the page's, with their values, and are added where there are none."""
    words = ["frasa-rl", "train", "--minutes", "4", "--out", "a", "--json"]
    assert SHOWN.changed(words, ["--minutes", "0.1", "--seed", "3"]) == [
        *["frasa-rl", "train", "--minutes", "0.1", "--out", "a", "--json", "--seed", "3"]
    ]

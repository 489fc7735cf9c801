"""The compiled updates are made once by a child process, and made anew when anything they come from has changed."""

from types import SimpleNamespace

import pytest

from frasa_rl import crossq_disk
from frasa_rl.crossq_disk import fill, mark

NAME = f"crossq_cpu._entry-1.{crossq_disk._PYTHON}.nbi"


@pytest.fixture
def updates(tmp_path):
    return SimpleNamespace(signatures=[], stats=SimpleNamespace(cache_path=str(tmp_path / "cache")))


@pytest.fixture
def script(tmp_path):
    """A child that writes what Numba would, and how often it ran."""
    (tmp_path / "cache").mkdir()
    folder = str(tmp_path / "cache")
    return (
        f"import os, pathlib; folder = pathlib.Path({folder!r}); (folder / {NAME!r}).touch(); "
        "assert os.environ['FRASA_COMPILES']; (folder / 'ran').open('a').write('x')"
    )


def ran(tmp_path) -> int:
    file = tmp_path / "cache" / "ran"
    return len(file.read_text()) if file.exists() else 0


def test_it_runs_once(updates, script, tmp_path):
    for _ in range(3):
        fill(updates, script)
    assert ran(tmp_path) == 1


def test_what_was_compiled_from_other_sources_is_made_anew(updates, script, tmp_path, monkeypatch):
    fill(updates, script)
    stale = tmp_path / "cache" / f"crossq_cpu._entry-0.{crossq_disk._PYTHON}.1.nbc"
    stale.touch()
    (tmp_path / "cache" / "other.py311.nbi").touch()
    monkeypatch.setattr(crossq_disk, "mark", lambda: "another")
    fill(updates, script)
    assert ran(tmp_path) == 2
    assert not stale.exists()
    assert (tmp_path / "cache" / "other.py311.nbi").exists()  # nobody else's files


def test_files_that_are_gone_are_made_anew(updates, script, tmp_path):
    fill(updates, script)
    (tmp_path / "cache" / NAME).unlink()
    fill(updates, script)
    assert ran(tmp_path) == 2


def test_a_child_that_fails_leaves_no_mark(updates, script, tmp_path):
    fill(updates, "raise SystemExit(3)")
    assert not list((tmp_path / "cache").glob("*.mark"))
    fill(updates, script)
    assert ran(tmp_path) == 1


def test_a_process_that_has_compiled_or_compiles_for_others_does_nothing(updates, script, tmp_path, monkeypatch):
    fill(SimpleNamespace(signatures=["done"], stats=updates.stats), script)
    monkeypatch.setenv("FRASA_COMPILES", "1")
    fill(updates, script)
    assert ran(tmp_path) == 0


def test_a_folder_that_cannot_be_written_is_no_error(updates, script, tmp_path):
    (tmp_path / "cache").rmdir()
    (tmp_path / "cache").write_text("a file where a folder should be")
    fill(updates, script)


def test_the_mark_knows_the_sources(tmp_path, monkeypatch):
    before = mark()
    assert mark() == before
    (tmp_path / "crossq_cpu.py").write_text("changed")
    monkeypatch.setattr(crossq_disk, "__file__", str(tmp_path / "crossq_disk.py"))
    assert mark() != before

"""Pools of starts: the same from the same seed however they are made, kept on disk under all they depend on."""

import os
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from frasa_rl import starts
from frasa_rl.config import Task
from frasa_rl.pool import Pool, cache_folder, pool_key
from frasa_rl.simulation import Simulation
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import Range, UsageError, load_calibration

TASK = replace(Task(), near_target_share=0.5, falling_share=0.3)  # quick to make, some of every kind


def maker_of(path, task=TASK, threads=1):
    return StartMaker(build_model(path, task), task, load_calibration(path), threads=threads)


def pool_of(path, folder=None, count=6, seed=4, **changed):
    told = []
    maker = maker_of(path, **changed)
    return Pool(maker, load_calibration(path), count, seed, folder, told.append), bool(told)


def model_bytes(model):
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def assert_same(one, other):
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "model":
            assert model_bytes(a) == model_bytes(b)
        elif field.name == "drawn":
            assert a == b
        else:
            np.testing.assert_array_equal(a, b)


def test_a_start_does_not_depend_on_the_others(calibrated, monkeypatch):
    """One alone is one of many, whatever the number of threads and of robots that settle at once."""
    kinds = ["any", "prone", "any", "falling", "any"]

    def rngs():
        return [np.random.default_rng(seed) for seed in range(5)]

    many = maker_of(calibrated, threads=2).make(rngs(), kinds)
    monkeypatch.setattr(starts, "_ATONCE", 2)
    few = maker_of(calibrated, threads=1).make(rngs(), kinds)
    used = maker_of(calibrated)
    for index, (rng, kind) in enumerate(zip(rngs(), kinds, strict=True)):
        alone = used.make([rng], [kind])[0]
        assert_same(alone, many[index])
        assert_same(alone, few[index])
    assert len({one.state.tobytes() for one in many}) == 5
    assert used.make([], []) == []


@pytest.fixture
def folder(tmp_path):
    """Where a pool is kept; it is not there yet."""
    return tmp_path / "new" / "cache"


def test_a_pool_read_again_is_the_pool_that_was_made(calibrated, folder):
    """States to the last bit, models in every byte, what was drawn: from disk as when it was made."""
    (made, made_told), (kept, kept_told) = (pool_of(calibrated, folder) for _ in range(2))
    assert (made_told, kept_told) == (True, False)
    assert len(made) == len(kept) == 6
    for one, other in zip(made.starts, kept.starts, strict=True):
        assert_same(one, other)
    assert len({id(one.model) for one in kept.starts}) == 6
    assert len({one.drawn["floor_friction"] for one in kept.starts}) == 6
    elsewhere, _ = pool_of(calibrated, None)
    for one, other in zip(made.starts, elsewhere.starts, strict=True):
        assert_same(one, other)


def test_a_pool_knows_the_kinds_of_its_starts(calibrated, folder):
    """Near the pose, falling or lying, as released; also where it was read; others can be asked for."""
    (made, _), (kept, _) = (pool_of(calibrated, folder) for _ in range(2))
    for pool in (made, kept):
        found = np.concatenate([pool.of_kind(kind) for kind in ("target", "falling", "random")])
        assert sorted(found) == list(range(6))
        assert [one.kind for one in pool.starts] == [one.kind for one in made.starts]
    assert made.of_kind("target").size
    sides = Pool(
        maker_of(calibrated), load_calibration(calibrated), 2, 0, folder, kinds=["prone", "supine"], branch=(2,)
    )
    assert [one.kind for one in sides.starts] == ["prone", "supine"]
    assert sides.starts[0].drawn["floor_friction"] != made.starts[0].drawn["floor_friction"]


def test_a_maker_that_has_drawn_before_makes_the_same_pool(calibrated, folder):
    """Neither the key nor the starts depend on what was drawn before."""
    maker, ranges = maker_of(calibrated), load_calibration(calibrated)
    first = Pool(maker, ranges, 3, 4, folder)
    assert len(list(folder.iterdir())) == 1
    told = []
    again = Pool(maker, ranges, 3, 4, folder, told.append)
    assert not told
    for one, other in zip(first.starts, again.starts, strict=True):
        assert_same(one, other)


def cut(path, _):
    path.write_bytes(path.read_bytes()[:-200])


def empty(path, _):
    path.write_bytes(b"")


def text(path, _):
    path.write_text("a pool")


def flip(path, _):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def stranger(path, other):
    other.replace(path)


def changed(path, _):
    with np.load(path) as file:
        kept = {name: file[name] for name in file.files}
    kept["state"][0, 3] += 0.1
    np.savez(path, **kept)


def narrow(path, _):
    with np.load(path) as file:
        kept = {name: file[name] for name in file.files}
    np.savez(path, **{**kept, "state": kept["state"].astype(np.float32)})


def objects(path, _):
    np.savez(path, state=np.array([{}], dtype=object))


def bare_array(path, _):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


@pytest.mark.parametrize("damage", [cut, empty, text, flip, stranger, changed, narrow, objects, bare_array])
def test_a_damaged_file_is_not_trusted(calibrated, folder, damage):
    """A cut, foreign, changed or stale file is made anew, and is whole afterwards."""
    made, _ = pool_of(calibrated, folder, count=2)
    (path,) = folder.iterdir()
    pool_of(calibrated, folder.with_name("other"), count=2, seed=5)
    (other,) = folder.with_name("other").iterdir()
    damage(path, other)
    again, told = pool_of(calibrated, folder, count=2)
    assert told
    for one, same in zip(made.starts, again.starts, strict=True):
        assert_same(one, same)
    assert not pool_of(calibrated, folder, count=2)[1]


def test_all_that_a_pool_depends_on_is_in_its_key(calibrated, nominal, monkeypatch):
    """Model, task, ranges, size, seed, and the version of MuJoCo change the key; the same again does not."""
    model, ranges = build_model(calibrated, TASK), load_calibration(calibrated)
    assert ranges is not None
    wider = replace(ranges, ranges={**ranges.ranges, "mx106.kp": Range(19.0, 21.0, 22.0, "N m/rad", "a test")})
    heavier = build_model(calibrated, TASK)
    heavier.body_mass[3] *= 1.0 + 1e-12
    keys = [
        pool_key(model, TASK, ranges, ["any"] * 8, 0),
        pool_key(build_model(nominal, TASK), TASK, ranges, ["any"] * 8, 0),
        pool_key(heavier, TASK, ranges, ["any"] * 8, 0),
        pool_key(model, replace(TASK, still_speed=0.06), ranges, ["any"] * 8, 0),
        pool_key(model, TASK, wider, ["any"] * 8, 0),
        pool_key(model, TASK, None, ["any"] * 8, 0),
        pool_key(model, TASK, ranges, ["any"] * 9, 0),
        pool_key(model, TASK, ranges, ["any"] * 8, 1),
        pool_key(model, TASK, ranges, ["prone"] * 8, 0),
        pool_key(model, TASK, ranges, ["any"] * 8, 0, (2,)),
    ]
    assert pool_key(build_model(calibrated, TASK), TASK, load_calibration(calibrated), ["any"] * 8, 0) == keys[0]
    monkeypatch.setattr(mujoco, "__version__", "9.9.9")
    keys.append(pool_key(model, TASK, ranges, ["any"] * 8, 0))
    assert len(set(keys)) == len(keys)


def test_a_kill_while_writing_leaves_no_half_file(calibrated, folder, monkeypatch):
    """Whatever stops the writing, nothing is left, not even the folder that was made for it."""
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        pool_of(calibrated, folder, count=2)
    assert not folder.exists()


def test_progress_is_told(calibrated):
    """The share done grows from start to start to 1."""
    told = []
    Pool(maker_of(calibrated), load_calibration(calibrated), 5, 0, None, told.append)
    np.testing.assert_allclose(told, [0.2, 0.4, 0.6, 0.8, 1.0])


def test_nothing_to_make_is_refused(calibrated):
    """A pool without starts, robots without threads, no robots: said, not divided by."""
    with pytest.raises(UsageError, match="pool of 0 starts"):
        Pool(maker_of(calibrated), None, 0, 0)
    model = build_model(calibrated, TASK)
    for count, threads in ((0, None), (1, 0), (2, -1)):
        with pytest.raises(UsageError, match="expected at least 1"):
            Simulation(model, count, threads)


def test_the_cache_folder_can_be_chosen(monkeypatch, tmp_path):
    """`$FRASA_CACHE` before the user's cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    monkeypatch.delenv("FRASA_CACHE", raising=False)
    assert cache_folder() == tmp_path / "users" / "frasa"
    monkeypatch.setenv("FRASA_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"


def test_a_cache_that_cannot_be_written_is_none(nominal, tmp_path):
    """A file stands where the folder should be: the pool is made, and nothing is kept."""
    blocked = tmp_path / "cache"
    blocked.write_text("not a folder")
    pool, _ = pool_of(nominal, blocked, count=1)
    assert len(pool) == 1
    assert blocked.read_text() == "not a folder"

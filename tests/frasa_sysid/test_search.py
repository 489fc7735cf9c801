import json

import numpy as np
import pytest

from frasa_sysid import search as searching
from frasa_sysid.search import Stop, search

CENTRE = np.array([0.31, 0.72, 0.05, 0.5])
START = np.full(4, 0.5)


class KilledError(Exception):
    """Stands for a process that dies."""


def quadratic(points):
    return [float(np.sum((point - CENTRE) ** 2)) for point in points]


def dying_after(generations, error):
    """Costs that fail in the given generation, counted from zero."""
    calls = []

    def costs(points):
        if len(calls) == generations:
            raise error
        calls.append(len(points))
        return quadratic(points)

    return costs


@pytest.fixture
def every_generation(monkeypatch):
    """Checkpoints after every generation, not only twice a second."""
    monkeypatch.setattr(searching, "_SAVE_EVERY", -1.0)


def assert_same(one, two):
    np.testing.assert_array_equal(one.x, two.x)
    assert (one.cost, one.evaluations, one.stop) == (two.cost, two.evaluations, two.stop)
    assert one.trace == two.trace


def test_finds_the_minimum_of_a_quadratic():
    """The centre of a quadratic in the cube is found, also near a face and from a start on one."""
    found = search(quadratic, np.array([0.0, 1.0, 1.0, 0.0]), seed=3, evaluations=1500)
    np.testing.assert_allclose(found.x, CENTRE, atol=2e-2)
    assert found.cost == pytest.approx(quadratic([found.x])[0])
    assert found.trace.best == sorted(found.trace.best, reverse=True)


def test_every_point_lies_in_the_cube():
    """No candidate leaves the unit cube, whatever the start."""
    seen = []

    def costs(points):
        seen.extend(points)
        return quadratic(points)

    search(costs, np.array([-1.0, 2.0, 0.0, 1.0]), seed=0, evaluations=200)
    assert np.min(seen) >= 0
    assert np.max(seen) <= 1


def test_never_worse_than_the_start():
    """The start itself competes: where it is the best point, it is the answer, exactly."""
    start = np.array([0.0, 0.2, 1.0, 0.5])
    found = search(lambda points: [float(np.abs(one - start).sum()) for one in points], start, seed=1, evaluations=30)
    np.testing.assert_array_equal(found.x, start)
    assert found.cost == 0.0


def test_same_seed_same_result():
    """A seed determines everything; another one does not give the same points."""
    one, two, other = (search(quadratic, START, seed, 120) for seed in (7, 7, 8))
    assert_same(one, two)
    assert not np.array_equal(one.x, other.x)


def test_stops_for_the_right_reason():
    """A budget ends it after the generation that uses it up; a flat cost ends it as converged."""
    short = search(quadratic, START, 0, 50)
    assert short.stop is Stop.BUDGET
    assert 50 <= short.evaluations < 50 + 12
    assert search(lambda points: [1.0] * len(points), START, 0, 100_000).stop is Stop.CONVERGED


@pytest.mark.usefixtures("every_generation")
@pytest.mark.parametrize("generations", [1, 4])
def test_resumes_exactly(tmp_path, generations):
    """A search that was killed and started again ends where the unbroken one does, without repeating its costs."""
    path = tmp_path / "search.json"
    unbroken = search(quadratic, START, 5, 100)
    with pytest.raises(KilledError):
        search(dying_after(generations, KilledError()), START, 5, 100, path, "me")
    computed = []

    def costs(points):
        computed.extend(points)
        return quadratic(points)

    assert_same(search(costs, START, 5, 100, path, "me"), unbroken)
    assert len(computed) < unbroken.evaluations - 8 * (generations - 1)


def test_writes_are_rationed(tmp_path, monkeypatch):
    """A fast search does not write its checkpoint after every generation; its end is written whatever the time."""
    written = []
    monkeypatch.setattr(searching, "write_atomic", lambda path, text: written.append(text))
    found = search(quadratic, START, 5, 200, tmp_path / "a.json", "me")
    assert 1 <= len(written) < len(found.trace.costs) / 2
    assert json.loads(written[-1])["searches"]["me"] == found.trace.costs


@pytest.mark.usefixtures("every_generation")
def test_several_searches_share_a_file(tmp_path):
    """Each search finds its own costs again, those of another that was killed later included."""
    path = tmp_path / "search.json"
    first = search(quadratic, START, 5, 60, path, "me")
    with pytest.raises(KilledError):
        search(dying_after(3, KilledError()), START, 6, 60, path, "you")

    assert_same(search(dying_after(0, KilledError()), START, 5, 60, path, "me"), first)
    # Neither does a shorter search throw away what a longer one computed.
    search(quadratic, START, 5, 20, path, "me")
    assert_same(search(dying_after(0, KilledError()), START, 5, 60, path, "me"), first)
    assert_same(search(dying_after(60, KilledError()), START, 6, 60, path, "you"), search(quadratic, START, 6, 60))
    assert set(json.loads(path.read_text())["searches"]) == {"me", "you"}


def test_a_larger_budget_goes_on(tmp_path):
    """A finished search asked for more evaluations is the one that had them from the start."""
    search(quadratic, START, 5, 40, tmp_path / "a.json", "me")
    longer = search(dying_after(20, KilledError()), START, 5, 90, tmp_path / "a.json", "me")
    assert_same(longer, search(quadratic, START, 5, 90))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"7",
        b'{"identity": "me", "costs": [[0.0, 0.0, 0.0]]}',
        b'{"searches": 3}',
        b'{"searches": []}',
        b'{"searches": {"me": 3}}',
        b'{"searches": {"me": [3]}}',
        b'{"searches": {"me": [["a"]]}}',
        b'{"searches": {"me": [[NaN]]}}',
        b'{"searches": {"me": [[1, 2], [1e999]]}}',
        b'{"searches": {"me": [[1%s]]}}' % (b"0" * 400),
        b'{"searches": {"me": [[0.0], [0.0]]}}',
        b'{"searches": {"me": [%s[0.0]]}}' % (b"[0.0], " * 1000),
        b'{"searches": {"me": %s' % (b"[" * 100_000),
        json.dumps({"searches": {"another": [[0.0] * 11] * 4}}).encode(),
    ],
)
def test_a_bad_checkpoint_costs_time_only(tmp_path, content):
    """A checkpoint that is damaged or of another search changes nothing, and is replaced."""
    path = tmp_path / "search.json"
    path.write_bytes(content)
    found = search(quadratic, START, 5, 60, path, "me")
    assert_same(found, search(quadratic, START, 5, 60))
    assert json.loads(path.read_text())["searches"]["me"] == found.trace.costs


def test_ctrl_c_keeps_the_best():
    """An interrupt ends the search with the best so far; before the first generation there is none."""
    found = search(dying_after(3, KeyboardInterrupt()), START, 5, 1000)
    assert found.stop is Stop.INTERRUPTED
    assert found.cost == min(cost for row in found.trace.costs for cost in row) < quadratic([START])[0]
    with pytest.raises(KeyboardInterrupt):
        search(dying_after(0, KeyboardInterrupt()), START, 5, 1000)

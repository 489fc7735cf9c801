"""Agents that run together share no core and no GPU, as far as there are enough."""

import os

import pytest

from frasa_rl import places
from frasa_rl.places import Share, place, shares, taken_place, usual_jobs

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system does not give cores away")


@pytest.fixture
def cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 3, 5, 7, 8})


def test_cores_are_divided(cores):
    """Equal parts of those there are; where there are more agents than cores they take turns."""
    assert [place(i, 2, []).cores for i in range(2)] == [(2, 3), (5, 7, 8)]
    assert [place(i, 1, []).cores for i in range(2)] == [(2, 3, 5, 7, 8)] * 2
    assert {one for i in range(7) for one in place(i, 7, []).cores} == {2, 3, 5, 7, 8}
    assert all(place(i, 7, []).count == 1 for i in range(7))


def test_gpus_are_dealt(cores):
    """One each by turns; with one or none nothing is said about them."""
    assert [place(i, 3, ["4", "6"]).gpu for i in range(3)] == ["4", "6", "4"]
    assert place(0, 3, ["4"]).gpu is None
    assert place(1, 3, ["4", "6"]).environment["CUDA_VISIBLE_DEVICES"] == "6"
    assert "CUDA_VISIBLE_DEVICES" not in place(1, 3, []).environment
    assert place(1, 3, []).environment["OPENBLAS_NUM_THREADS"] == "1"


def test_workers_of_one_machine_share_it():
    """Places are numbered through all workers of a machine."""
    found = shares({"tcp://a:1": 2, "tcp://b:1": 1, "tcp://a:2": 1})
    assert found == {"tcp://a:1": Share(0, 3), "tcp://b:1": Share(0, 1), "tcp://a:2": Share(2, 3)}


def test_nobody_else_has_ones_place(cores):
    """A place is free again when it was left."""
    with taken_place(Share(0, 2), gpu=False) as first:
        with taken_place(Share(0, 2), gpu=False) as second:
            assert not set(first.cores) & set(second.cores)
        with taken_place(Share(0, 2), gpu=False) as third:
            assert third == second


def test_agents_at_a_time(monkeypatch):
    """One for each GPU, else for two cores, and at least one."""
    monkeypatch.setattr(places, "gpus", lambda: ["0", "1", "2"])
    assert [usual_jobs(8, gpu=True), usual_jobs(8, gpu=False), usual_jobs(1, gpu=False)] == [3, 4, 1]

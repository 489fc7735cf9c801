"""Candidates are ordered by stated numbers; who never stands up comes last, however gentle."""

import numpy as np
import pytest

from frasa_rl.evaluate import Evaluation
from frasa_rl.protocol_push import PushTrial
from frasa_rl.protocol_standup import StandUpTrial
from frasa_rl.rank import numbers_of, rank, rank_table

ZERO = np.zeros(5)
GENTLE = {"peak_torque": 1.0, "peak_speed": 1.0, "peak_floor_force": 1.0, "self_contact": 0.0, "shaking": 0.1}
ROUGH = {"peak_torque": 5.0, "peak_speed": 9.0, "peak_floor_force": 900.0, "self_contact": 2.0, "shaking": 0.2}
GOOD = {"speed": 2.0, "robustness": 0.9, "versatility": 1.0, "stood_up": 1.0, **ROUGH}
SLOW = {"speed": 4.0, "robustness": 0.8, "versatility": 0.5, "stood_up": 1.0, **GENTLE}
STILL = {"speed": 10.0, "robustness": 0.0, "versatility": 0.0, "stood_up": 0.0, **GENTLE}


def stand(side, time_s, strain=ZERO):
    return StandUpTrial(side, time_s, time_s, False, strain)


def push(time_s, hit=True, energy=4.0, strain=ZERO):
    return PushTrial("front", energy, hit, hit, 1.0, time_s, False, False, strain)


def test_the_numbers_behind_a_rank():
    """Failures count as 10 s; random trials make robustness; a cell passes at 8 of 10."""
    nominal = Evaluation(
        [stand("prone", 2.0, np.full(5, 2.0)), stand("supine", None)],
        [push(1.0)] * 4
        + [push(None)]
        + [push(1.0, energy=7.3), push(None, energy=7.3), push(None, hit=False, energy=7.3)],
    )
    randomized = Evaluation([stand("prone", 2.0), stand("supine", 1.0)], [push(None), push(0.0)])
    numbers = numbers_of(nominal, randomized)
    assert numbers["speed"] == 6.0
    assert numbers["robustness"] == 0.75
    assert numbers["versatility"] == 0.5  # prone and 4.0 J; neither supine nor 7.3 J
    assert numbers["stood_up"] == 0.5
    assert numbers["peak_torque"] == pytest.approx(2.0 / 9)  # the trial that was not hit does not count


def test_the_order_follows_the_mean_of_ranks():
    """Three firsts and a last beat the rest; the numbers come along."""
    places = rank({"slow": SLOW, "good": GOOD})
    assert [(one.name, one.place, one.mean_rank) for one in places] == [("good", 1, 1.25), ("slow", 2, 1.75)]
    assert places[0].ranks == {"speed": 1.0, "robustness": 1.0, "safety": 2.0, "versatility": 1.0}
    assert places[1].numbers == SLOW


def test_who_never_stands_up_is_last():
    """Lying still is safest, and no stand-up."""
    best = {**STILL, "speed": 1.0, "robustness": 1.0, "versatility": 1.0}
    places = rank({"still": best, "good": GOOD})
    assert [(one.name, one.place, one.stands_up) for one in places] == [("good", 1, True), ("still", 2, False)]


def test_equals_share_their_place_and_ranks():
    """Two equal candidates are both first, each with the mean rank 1.5, and the third is third."""
    places = rank({"a": GOOD, "b": GOOD, "c": {**SLOW, **ROUGH}})
    assert [one.place for one in places] == [1, 1, 3]
    assert places[0].ranks["speed"] == places[1].ranks["speed"] == 1.5
    assert places[2].ranks["speed"] == 3.0


def test_the_table_shows_every_number():
    """A line a candidate, with units, ranks in brackets and a word about who lies."""
    lines = rank_table(rank({"good": GOOD, "still": STILL})).splitlines()
    assert "speed [s]" in lines[0]
    assert "peak_floor_force [N]" in lines[0]
    assert lines[1].split()[:5] == ["good", "1", "1.25", "2.00", "(1)"]
    assert lines[2].endswith("never stood up")

"""The policy that is published: the mean of the actor's weights over its last updates."""

import numpy as np
import pytest

from frasa_rl.actor import ActorLayers, Average


def actor(value: float) -> ActorLayers:
    """All weights and biases of one value."""

    def layer(rows: int, columns: int):
        return np.full((rows, columns), value, dtype=np.float32), np.full(rows, value, dtype=np.float32)

    return ActorLayers((layer(4, 22), layer(3, 4)), layer(5, 3), layer(5, 3))


def values(average: Average) -> set[float]:
    return {float(one) for layer in average.policy({}).layers for part in layer for one in part.flat}


def test_the_newest_counts_most_and_all_weights_follow():
    """After u updates of a horizon n the old mean has exp(-u / n) left."""
    average = Average(100)
    average.follow(actor(1.0), 0)
    assert values(average) == {1.0}
    average.follow(actor(3.0), 50)
    (found,) = values(average)
    assert found == pytest.approx(3.0 - 2.0 * np.exp(-0.5))
    for _ in range(40):
        average.follow(actor(3.0), 50)
    assert values(average) == {3.0}


def test_it_does_not_matter_how_updates_are_counted():
    one, other = Average(100), Average(100)
    for each in (one, other):
        each.follow(actor(1.0), 0)
    one.follow(actor(3.0), 60)
    for _ in range(6):
        other.follow(actor(3.0), 10)
    assert values(one).pop() == pytest.approx(values(other).pop())


def test_without_a_horizon_it_is_the_actor():
    average = Average(0)
    for value in (1.0, 3.0):
        average.follow(actor(value), 1)
    assert values(average) == {3.0}


def test_it_is_kept_to_the_last_bit():
    average, again = Average(30), Average(30)
    for value in (1.0, 0.3):
        average.follow(actor(value), 7)
    again.restore(average.snapshot())
    for each in (average, again):
        each.follow(actor(0.7), 7)
    assert values(average) == values(again)

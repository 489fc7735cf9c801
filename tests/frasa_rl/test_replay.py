"""The ring gives back what was put in: against an obvious loop, and against SB3's n-step buffer."""

import time

import numpy as np
import pytest

from frasa_rl.replay import Replay, Transitions
from frasa_sysid.calibration import UsageError

ROBOTS, OBSERVED, ACTIONS, DISCOUNT = 3, 4, 2, 0.9


def steps(count, seed=0, robots=ROBOTS):
    """Transitions whose first observed number tells robot and step; ends of both sorts."""
    rng = np.random.default_rng(seed)
    seen = rng.normal(size=(count, robots, OBSERVED)).astype(np.float32)
    seen[..., 0] = np.arange(count)[:, None] + np.arange(robots) / 100
    after = rng.normal(size=seen.shape).astype(np.float32)
    done = rng.random((count, robots)) < 0.1
    late = (rng.random((count, robots)) < 0.1) & ~done
    return Transitions(
        observations=seen,
        next_observations=after,
        actions=rng.uniform(-1, 1, (count, robots, ACTIONS)).astype(np.float32),
        rewards=rng.normal(size=(count, robots)).astype(np.float32),
        dones=done.astype(np.float32),
        lasts=(done | late).astype(np.float32),
    )


def part(all_steps, first, end):
    return Transitions(**{name: value[first:end] for name, value in vars(all_steps).items()})


def ring(capacity, n_step, robots=ROBOTS):
    return Replay(capacity, robots, OBSERVED, ACTIONS, n_step=n_step, discount=DISCOUNT, seed=1)


def expected(data, row, robot, n_step):
    """The obvious loop: rewards, index of the last step, steps summed."""
    total, factor = 0.0, 1.0
    for summed in range(1, n_step + 1):
        at = row + summed - 1
        total, factor = total + factor * float(data.rewards[at, robot]), factor * DISCOUNT
        if data.lasts[at, robot] or at == len(data.rewards) - 1:
            break
    return total, at, factor


@pytest.mark.parametrize("n_step", [1, 3, 5])
@pytest.mark.parametrize("count", [5, 17, 20, 21, 33, 50])
def test_batches_are_what_an_obvious_loop_gives(n_step, count):
    """Partly filled, just full, and gone around; ends, time limits and the seam among them; everything is drawn."""
    data, replay, rows = steps(count), ring(20 * ROBOTS, n_step), 20
    for first in range(0, count, 4):
        replay.add(part(data, first, first + 4))
    assert len(replay) == min(count, rows) * ROBOTS
    batches = replay.draw(40, 50)
    drawn = set()
    for k in range(40):
        for b in range(50):
            told = float(batches.observations[k, b, 0])
            row, robot = int(told + 0.001), round(100 * (told - int(told + 0.001)))
            drawn.add((row, robot))
            total, at, factor = expected(data, row, robot, n_step)
            np.testing.assert_array_equal(batches.observations[k, b], data.observations[row, robot])
            np.testing.assert_array_equal(batches.actions[k, b], data.actions[row, robot])
            np.testing.assert_array_equal(batches.next_observations[k, b], data.next_observations[at, robot])
            assert batches.rewards[k, b] == pytest.approx(total, abs=1e-5)
            assert batches.dones[k, b] == data.dones[at, robot]
            assert batches.discounts[k, b] == pytest.approx(factor, rel=1e-6)
    first = max(0, count - rows)
    assert drawn == {(row, robot) for row in range(first, count) for robot in range(ROBOTS)}
    assert all(one.dtype == np.float32 and one.flags.c_contiguous for one in vars(batches).values())
    assert batches.noise.shape == batches.next_noise.shape == (40, 50, ACTIONS)


@pytest.mark.parametrize("n_step", [1, 3])
def test_batches_are_those_of_sb3(n_step):
    """Every transition gives the numbers that SB3's n-step buffer gives for it, also at the seam and at time limits."""
    buffers = pytest.importorskip("stable_baselines3.common.buffers")
    from gymnasium import spaces

    one = np.ones(OBSERVED, dtype=np.float32)
    theirs = buffers.NStepReplayBuffer(
        20 * ROBOTS, spaces.Box(-100 * one, 100 * one), spaces.Box(-1, 1, (ACTIONS,)), "cpu", n_envs=ROBOTS,
        n_steps=n_step, gamma=DISCOUNT,
    )  # fmt: skip
    data, mine = steps(33), ring(20 * ROBOTS, n_step)
    mine.add(data)
    for row in range(33):
        late = (data.lasts[row] > 0) & (data.dones[row] == 0)
        theirs.add(
            data.observations[row], data.next_observations[row], data.actions[row], data.rewards[row], data.lasts[row],
            [{"TimeLimit.truncated": bool(x)} for x in late],
        )  # fmt: skip
    by_observation = {}
    rng_state = np.random.RandomState(0)
    np.random.seed(0)  # noqa: NPY002 - SB3 draws robots from it
    for _ in range(30):
        sample = theirs._get_samples(rng_state.randint(0, 20, 50))
        for i in range(50):
            by_observation[sample.observations[i].numpy().tobytes()] = (
                sample.next_observations[i].numpy(), float(sample.rewards[i]), float(sample.dones[i]),
                float(sample.discounts[i]),
            )  # fmt: skip
    assert len(by_observation) == 20 * ROBOTS
    batches = mine.draw(10, 50)
    for k in range(10):
        for b in range(50):
            following, reward, done, discount = by_observation[batches.observations[k, b].tobytes()]
            np.testing.assert_array_equal(batches.next_observations[k, b], following)
            assert (batches.rewards[k, b], batches.dones[k, b], batches.discounts[k, b]) == pytest.approx(
                (reward, done, discount), abs=1e-5
            )


@pytest.mark.parametrize("count", [9, 33])
def test_a_restored_ring_goes_on_alike(count):
    """The same batches and noise, then the same again after more steps; foreign numbers are refused."""
    one, other = ring(20 * ROBOTS, 3), ring(20 * ROBOTS, 3)
    one.add(steps(count))
    one.draw(2, 5)
    other.restore(one.snapshot())
    for _ in range(2):
        for mine, theirs in zip(vars(one.draw(3, 7)).values(), vars(other.draw(3, 7)).values(), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        for each in (one, other):
            each.add(steps(8, seed=5))
    with pytest.raises(ValueError, match="steps in a ring"):
        ring(5 * ROBOTS, 3, robots=2).restore(one.snapshot())
    with pytest.raises(ValueError, match="steps in a ring"):
        ring(5 * ROBOTS, 3).restore(one.snapshot())


def test_a_ring_that_is_too_small_is_refused():
    with pytest.raises(UsageError, match="does not hold 3 steps of 3 robots"):
        ring(6, 3)


def test_thirty_two_batches_take_a_few_milliseconds():
    """32 x 256 of a full ring of 300,000: 3 ms on one core; 50 ms leave room for a busy machine."""
    replay = Replay(300_000, 64, 22, 5, n_step=3, discount=0.99, seed=0)
    replay.filled = replay._rows
    replay.draw(32, 256)
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        replay.draw(32, 256)
        times.append(time.perf_counter() - begun)
    print(f"32 x 256 in {1e3 * min(times):.1f} ms")
    assert min(times) < 0.05

"""The keyframe controller turns poses into the same actions a policy gives."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.config import Joint, Task
from frasa_rl.keyframe import KeyframeController
from frasa_rl.routine import Detector, Key, KeyframeError, Keyframes, Routine, Standing

TASK = Task()
N = len(TASK.joints)
STANDING = (-50.0, 20.0, -50.0, 73.0, -36.0)
FILE = Keyframes(
    joints=tuple(one.name for one in TASK.joints),
    prone=Routine((Key(0.4, (-90.0, 45.0, -45.0, 90.0, -30.0)), Key(0.13, (-80.0, 40.0, -60.0, 100.0, -40.0))), 0.5),
    supine=Routine((Key(0.3, (-20.0, 60.0, 0.0, 10.0, 20.0)),), 0.6),
    standing=Standing(STANDING, gain=0.5, correction_max_deg=6.0),
    detector=Detector(hold_s=0.1),
)
PRONE, SUPINE, UPRIGHT = np.radians([80.0, -80.0, 8.0])


class Body:
    """Robots whose commands follow the actions exactly; they lie or stand as they are told."""

    def __init__(self, pitch, command_deg=(0.0,) * N):
        self.pitch = np.atleast_1d(pitch)
        self.command = np.tile(np.radians(command_deg), (len(self.pitch), 1))
        self.position = self.command.copy()

    def seen(self):
        count = len(self.pitch)
        still = np.zeros((count, N))
        return np.column_stack(
            [self.position, still, self.command, self.pitch, np.zeros(count), still]
        ).astype(np.float32)  # fmt: skip

    def run(self, controller, seconds, period):
        """Commands after every decision [deg], shape (decisions, count, n)."""
        passed = []
        for _ in range(round(seconds / period)):
            action = controller.act(self.seen())
            assert action.shape == self.command.shape
            assert np.abs(action).max() <= 1.0
            self.command = self.command + action * TASK.rate_limit * period
            passed.append(np.degrees(self.command))
        return np.array(passed)


def started(count=1, period=0.05, file=FILE):
    controller = KeyframeController(file, TASK)
    controller.start(count, period)
    return controller


@pytest.mark.parametrize("pitch", [PRONE, SUPINE])
def test_decisions_at_20_and_at_100_hz_give_the_same_commands(pitch):
    """At every shared instant of one round (1.13 s and 1.0 s), also where a key lies between two decisions."""
    slow = Body(pitch).run(started(period=0.05), 1.1, 0.05)
    fast = Body(pitch).run(started(period=0.01), 1.1, 0.01)
    np.testing.assert_allclose(fast[4::5], slow, atol=1e-3)
    assert np.ptp(slow, axis=0).max() > 60.0  # it did move


def test_keys_are_passed_in_time_and_in_a_straight_line():
    """0.1 s to see that it lies, 0.4 s to the first key; half-way there half of the way is done."""
    commands = Body(PRONE).run(started(period=0.01), 0.5, 0.01)[:, 0]
    np.testing.assert_allclose(commands[9], 0.0, atol=1e-3)
    np.testing.assert_allclose(commands[29], np.array(FILE.prone.keys[0].angles_deg) / 2, atol=1e-3)
    np.testing.assert_allclose(commands[49], FILE.prone.keys[0].angles_deg, atol=1e-3)


def test_a_key_that_is_too_near_takes_the_time_it_needs():
    """No action is beyond the rate limit, and the pose is reached nevertheless."""
    hurried = replace(FILE, supine=Routine((Key(0.0, (-150.0, 0.0, 0.0, 0.0, 0.0)),), 0.5))
    commands = Body(SUPINE).run(started(period=0.01, file=hurried), 1.1, 0.01)[:, 0]
    assert np.abs(np.diff(commands, axis=0)).max() <= 360.0 * 0.01 * (1 + 1e-5)
    assert commands[:, 0].min() == pytest.approx(-150.0, abs=2.0)  # passed between two decisions


def test_a_robot_upright_holds_the_standing_command():
    """It goes there at the rate limit and starts no routine."""
    commands = Body(UPRIGHT, (0.0,) * N).run(
        started(file=replace(FILE, standing=Standing(STANDING, 0.0, 0.0))), 1, 0.05
    )
    np.testing.assert_allclose(commands[0, 0], np.clip(STANDING, -18.0, 18.0), atol=1e-4)
    np.testing.assert_allclose(commands[-1, 0], STANDING, atol=1e-4)


def test_a_routine_that_ends_lying_starts_again():
    """The most flexed knee comes once a round: 0.1 s of seeing and 1.03 s of keys, then 1.05 s a round."""
    knee = Body(PRONE).run(started(), 2.5, 0.05)[:, 0, 3]
    assert (np.diff((knee > 92.0).astype(int)) == 1).sum() == 2


def test_a_routine_that_ends_upright_is_over():
    """Standing at its end, the robot stays in the standing command."""
    body, controller = Body(PRONE), started(file=replace(FILE, standing=Standing(STANDING, 0.0, 0.0)))
    body.run(controller, 1.0, 0.05)
    body.pitch = np.array([UPRIGHT])
    commands = body.run(controller, 2.0, 0.05)[:, 0]
    np.testing.assert_allclose(commands[-20:], np.tile(STANDING, (20, 1)), atol=1e-4)


def test_a_fall_waits_until_the_robot_lies():
    """While it falls, the commands stay as they are; lying, the routine of its side begins."""
    body, controller = Body(UPRIGHT, STANDING), started()
    body.position = np.tile(np.radians([one.target_deg for one in TASK.joints]), (1, 1))
    body.pitch = np.array([-1.2])
    falling = body.run(controller, 0.1, 0.05)
    np.testing.assert_allclose(falling[:, 0], [STANDING] * 2, atol=1e-4)
    body.pitch = np.array([SUPINE])
    lying = body.run(controller, 0.5, 0.05)[:, 0]
    assert np.abs(lying - FILE.supine.keys[0].angles_deg).max(axis=1).min() < 10.0


def test_robots_do_not_know_of_each_other():
    """Three together move as each of them alone."""
    pitches = np.array([PRONE, UPRIGHT, SUPINE])
    together = Body(pitches).run(started(3), 2.0, 0.05)
    for index, pitch in enumerate(pitches):
        np.testing.assert_array_equal(together[:, index], Body(pitch).run(started(), 2.0, 0.05)[:, 0])


def test_start_forgets_everything():
    """After `start` the same observations give the same actions again."""
    controller = started()
    first = Body(PRONE).run(controller, 0.7, 0.05)
    controller.start(1, 0.05)
    np.testing.assert_array_equal(Body(PRONE).run(controller, 0.7, 0.05), first)


def test_a_sagging_joint_is_corrected_slowly_and_not_far():
    """3 deg of sag at a gain of 0.5/s: 1.5 deg in the first second, never more than the bound."""
    body = Body(UPRIGHT, STANDING)
    target = np.array([one.target_deg for one in TASK.joints])
    sagging = target + np.array([0.0, 0.0, 0.0, 3.0, 0.0])
    body.position = np.radians(sagging)[None]
    commands = body.run(started(), 6.0, 0.05)[:, 0, 3]
    assert commands[19] - STANDING[3] == pytest.approx(-1.5, abs=0.01)
    assert commands[-1] - STANDING[3] == pytest.approx(-6.0, abs=0.01)


def test_keyframes_of_another_robot_are_refused():
    """The joints must be the task's, in its order."""
    other = replace(TASK, joints=(*TASK.joints[:-1], Joint("toe", 0.0)))
    with pytest.raises(KeyframeError, match="toe"):
        KeyframeController(FILE, other)

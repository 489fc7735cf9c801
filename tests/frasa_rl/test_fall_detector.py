"""The fall detector: two thresholds, a time that stillness must last, one verdict a robot."""

import numpy as np
import pytest

from frasa_rl.fall_detector import FallDetector, Posture
from frasa_rl.routine import Detector

THRESHOLDS = Detector(fallen_deg=45.0, upright_deg=30.0, still_rate=0.3, hold_s=0.1)


def verdicts(pitches_deg, rates=None, period_s=0.05):
    """What one robot's detector says, look after look."""
    detector = FallDetector(THRESHOLDS, 1, period_s)
    rates = [0.0] * len(pitches_deg) if rates is None else rates
    looks = zip(pitches_deg, rates, strict=True)
    return [Posture(detector.look(np.radians([pitch]), np.array([rate]))[0]) for pitch, rate in looks]


def test_upright_and_fallen_have_two_thresholds():
    """Between 30 and 45 deg the verdict stays what it was."""
    said = verdicts([10.0, 40.0, 44.0, 46.0, 40.0, 31.0, 29.0, 40.0], rates=[1.0] * 8)
    expected = ["STANDING", "STANDING", "STANDING", "FALLING", "FALLING", "FALLING", "STANDING", "STANDING"]
    assert [one.name for one in said] == expected


def test_what_is_found_leaning_is_fallen():
    """Without a past, a pitch between the thresholds is not upright."""
    assert verdicts([35.0], rates=[1.0]) == [Posture.FALLING]


@pytest.mark.parametrize(("pitch", "lies"), [(90.0, Posture.PRONE), (-80.0, Posture.SUPINE), (120.0, Posture.PRONE)])
def test_lying_needs_stillness_for_a_time(pitch, lies):
    """Falling until the rate has been small for 0.1 s, then the side by the sign of the pitch."""
    assert verdicts([pitch] * 4) == [Posture.FALLING, Posture.FALLING, lies, lies]
    moved = verdicts([pitch] * 5, rates=[0.0, 0.0, 0.4, 0.0, 0.0])
    assert set(moved) == {Posture.FALLING}


def test_the_time_counts_in_seconds_not_in_looks():
    """At 100 Hz lying is seen after the same 0.1 s: at the 11th look."""
    said = verdicts([90.0] * 12, period_s=0.01)
    assert said.index(Posture.PRONE) == 10


def test_robots_have_a_verdict_each():
    """One stands, one falls, one lies."""
    detector = FallDetector(THRESHOLDS, 3, 0.05)
    pitch, rate = np.radians([0.0, -60.0, 80.0]), np.array([0.0, -2.0, 0.1])
    for _ in range(3):
        said = detector.look(pitch, rate)
    assert list(said) == [Posture.STANDING, Posture.FALLING, Posture.PRONE]

from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid.errors import LogError
from frasa_sysid.lag import lags
from frasa_sysid.lag_bands import agreement
from frasa_sysid.lag_joint import joint_lags
from frasa_sysid.readers.dynaban import read_dynaban
from frasa_sysid.readers.imu_on_axis import read_imu_on_axis
from frasa_sysid.readers.robstride import read_robstride
from frasa_sysid.recording import Recording, RigFacts, Signal

COUNT = 2 * np.pi / 4096


def recording(**signals):
    made = {name: Signal(name, unit, t, y, columns) for name, (unit, t, y, columns) in signals.items()}
    return Recording("log", made, RigFacts(), "simulated", "none", "", "file")


def waves(t, seed=0):
    phase = np.random.default_rng(seed).uniform(0, 6, 5)
    f = np.array([0.4, 0.9, 1.7, 2.3, 3.1])
    return 0.5 * (np.sin(np.multiply.outer(t, 2 * np.pi * f) + phase) / f).sum(axis=-1)


def speed(t, seed=0):
    return (waves(t + 5e-4, seed) - waves(t - 5e-4, seed)) / 1e-3


def clocks(seed=0, duration=20.0):
    """Two uneven clocks of their own, of 10 and 13 ms."""
    rng = np.random.default_rng(seed)
    t, s = np.arange(0, duration, 0.01), np.arange(0, duration, 0.013)
    return t + rng.uniform(0, 0.003, t.size), s + rng.uniform(0, 0.003, s.size)


def pair(delay, of="velocity", seed=0, function=None, ratio=1.0, noise=0.0):
    t, s = clocks(seed)
    unit = {"velocity": "rad/s", "late": "rad"}[of]
    late = (function or (speed if of == "velocity" else waves))(s - delay)
    late = ratio * late + noise * np.random.default_rng(seed).normal(size=s.size) + 0.03
    q = waves(t) if function is None else function(t)
    position = np.round(q / COUNT) * COUNT
    return recording(position=("rad", t, position, ()), **{of: (unit, s, late, ())})


@pytest.mark.parametrize("delay", [-0.0173, 0.0, 0.00037, 0.0123, 0.0251, 0.0999])
@pytest.mark.parametrize("of", ["velocity", "late"])
def test_a_known_delay_is_found(delay, of):
    """To 0.1 ms, on own uneven clocks, with an encoder's steps; and it is inside the interval."""
    one = lags([pair(delay, of)], of, "position")[0]
    assert one.verdict == "identified"
    assert abs(one.delay - delay) < 1e-4
    assert one.low - 2e-5 <= delay <= one.high + 2e-5
    assert one.ratio == pytest.approx(1.0, abs=0.02)


def test_intervals_hold_the_truth():
    """With noise, over 30 seeds, nine times out of ten or more."""
    held = 0
    for seed in range(30):
        one = lags([pair(0.0213, "late", seed, noise=0.02)], "late", "position")[0]
        held += one.low <= 0.0213 <= one.high
    assert held >= 26


def test_roles_may_be_exchanged():
    """A position that is late against its velocity is that much early the other way round."""
    log = pair(0.0123)
    a, b = (lags([log], *names)[0] for names in (("velocity", "position"), ("position", "velocity")))
    assert b.delay == pytest.approx(-a.delay)
    assert (b.low, b.high) == pytest.approx((-a.high, -a.low))
    assert b.bands[0].delay == pytest.approx(-a.bands[0].delay)


def test_outliers_hardly_matter():
    """Samples that are far off cost hardly anything."""
    log = pair(0.0123, "late", noise=0.002)
    y = log.signals["late"].y.copy()
    y[::97] += 3.0
    damaged = replace(log, signals={**log.signals, "late": replace(log.signals["late"], y=y)})
    assert lags([damaged], "late", "position")[0].delay == pytest.approx(0.0123, abs=3e-4)


def test_a_gap_is_not_bridged():
    """Where positions are missing nothing is compared."""
    log = pair(0.0123, "late")
    position = log.signals["position"]
    keep = (position.t < 6) | (position.t > 9)
    holed = replace(position, t=position.t[keep], y=position.y[keep])
    one = lags([replace(log, signals={**log.signals, "position": holed})], "late", "position")[0]
    assert one.delay == pytest.approx(0.0123, abs=1e-4)


def test_joints_are_told_apart():
    """Each column has its own delay; the columns may stand in any order, and one may be asked for."""
    t, s = clocks()
    position = np.stack([waves(t, 1), waves(t, 2)], axis=1)
    late = np.stack([waves(s - 0.02, 2), waves(s - 0.01, 1)], axis=1)
    log = recording(position=("rad", t, position, ("hip", "knee")), late=("rad", s, late, ("knee", "hip")))
    found = {one.joint: one.delay for one in lags([log], "late", "position")}
    assert found == pytest.approx({"knee": 0.02, "hip": 0.01}, abs=1e-4)
    only = lags([log], "late", "position", "hip")
    assert [one.joint for one in only] == ["hip"]
    assert lags([log], "late.hip", "position.hip")[0].delay == pytest.approx(0.01, abs=1e-4)


def test_a_wrong_sign_is_named():
    """A channel that is another's negative is not late, it is wrong."""
    assert lags([pair(0.0123, "late", ratio=-1.0)], "late", "position")[0].verdict == "wrong sign"


def test_a_scale_is_named():
    """Half the amplitude is more than a delay; the delay is found all the same."""
    one = lags([pair(0.0123, "late", ratio=0.5)], "late", "position")[0]
    assert one.verdict == "filter"
    assert "0.50 of the other's" in one.reason
    assert one.delay == pytest.approx(0.0123, abs=1e-4)


def test_a_low_pass_is_a_filter():
    """A first-order lag is a delay that falls with the frequency: bands show it."""
    t = np.arange(0, 60, 0.005)
    x = waves(t)
    y = np.zeros(t.size)
    for i in range(1, t.size):
        y[i] = y[i - 1] + 0.005 / 0.15 * (x[i] - y[i - 1])
    one = lags([recording(position=("rad", t, x, ()), late=("rad", t, y, ()))], "late", "position")[0]
    assert one.verdict == "filter"
    for band in one.bands:
        w = 2 * np.pi * band.frequency
        assert band.delay == pytest.approx(np.arctan(0.15 * w) / w, rel=0.08)


def sine(delay, frequency, seed=0, noise=0.01):
    t = np.arange(0, 12, 0.002)
    x = np.sin(2 * np.pi * frequency * t)
    y = np.sin(2 * np.pi * frequency * (t - delay)) + noise * np.random.default_rng(seed).normal(size=t.size)
    log = recording(position=("rad", t, x, ()), late=("rad", t, y, ()))
    return replace(log, name=f"{frequency:g} Hz")


def test_a_sine_repeats_itself():
    """A fast sine is known but for its period; the shortest delay is given, the others are named."""
    one = lags([sine(0.008, 7.0)], "late", "position")[0]
    assert one.verdict == "periodic"
    assert one.delay == pytest.approx(0.008, abs=1e-4)
    assert np.abs(np.array(one.others)[:, None] - (0.008 + np.array([-1, 1]) / 7)).min(axis=0) == pytest.approx(
        0.0, abs=5e-3
    )


def test_several_frequencies_settle_it():
    """Logs at several frequencies agree on one delay, also one longer than a period of the fastest."""
    found = lags([sine(0.1, f) for f in (1.0, 3.0, 5.0, 7.0)], "late", "position")
    joint = joint_lags(found)[0]
    assert joint.verdict == "identified"
    assert joint.delay == pytest.approx(0.1, abs=2e-4)
    assert [round(row.frequency) for row in joint.by_frequency] == [1, 3, 5, 7]


def test_frequencies_that_disagree_are_a_filter():
    """Delays that grow with the frequency are no one delay; the group delay says how the phase goes."""
    found = lags([sine(0.006 + 0.0004 * f, f) for f in (1.0, 3.0, 5.0, 7.0)], "late", "position")
    joint = joint_lags(found)[0]
    assert joint.verdict == "filter"
    assert joint.agreement.p < 1e-6
    assert joint.low < np.mean([0.0064, 0.0072, 0.008, 0.0088]) < joint.high
    # f d = 0.006 f + 0.0004 f^2, so the slope between 5 and 7 Hz is 0.006 + 0.0004 * 12
    assert joint.by_frequency[-1].group_delay == pytest.approx(0.0108, abs=2e-4)


@pytest.mark.parametrize("function", [np.tanh, lambda t: np.exp(-np.maximum(t - 3, 0))])
def test_a_single_transient_says_nothing(function):
    """What goes one way only looks alike late and filtered."""
    one = lags([pair(0.02, "late", function=function)], "late", "position")[0]
    assert one.verdict in ("filter", "not excited")


def test_too_slow():
    """At 5 Hz the interval is half a sampling period at least, whatever the fit says."""
    t = np.arange(0, 60, 0.2)
    log = recording(
        position=("rad", t, np.sin(2 * np.pi * 0.3 * t), ()), late=("rad", t, np.sin(2 * np.pi * 0.3 * (t - 0.1)), ())
    )
    one = lags([log], "late", "position")[0]
    assert one.verdict == "too slow"
    assert one.high - one.low >= 0.2 - 1e-9
    assert one.delay == pytest.approx(0.1, abs=0.01)
    assert "record at 50 Hz or more" in one.reason


def test_what_says_nothing_has_a_verdict():
    """Constant, unrelated or short channels: a verdict each, and no number that looks like an answer."""
    t, s = clocks()
    rng = np.random.default_rng(1)
    still = recording(position=("rad", t, waves(t), ()), late=("rad", s, np.zeros(s.size), ()))
    frozen = recording(position=("rad", t, np.zeros(t.size), ()), late=("rad", s, waves(s), ()))
    unrelated = recording(position=("rad", t, waves(t), ()), late=("rad", s, rng.normal(size=s.size), ()))
    short = recording(position=("rad", t[:5], waves(t[:5]), ()), late=("rad", s, waves(s), ()))
    apart = recording(position=("rad", t, waves(t), ()), late=("rad", s + 100, waves(s), ()))
    for log in (still, frozen, unrelated, short, apart):
        assert lags([log], "late", "position")[0].verdict in ("not excited", "out of range")
    assert lags([still], "late", "position")[0].delay is None
    assert joint_lags(lags([still], "late", "position"))[0].delay is None


def test_beyond_the_search():
    """A delay that is longer than what was searched is not made one that is not."""
    log = pair(0.4, "late")
    assert lags([log], "late", "position", longest=0.1)[0].verdict in ("out of range", "not excited")
    assert lags([log], "late", "position", longest=0.6)[0].delay == pytest.approx(0.4, abs=1e-4)


def test_a_goal_is_held():
    """A goal's half period is told, for a held goal is that much older."""
    log = pair(0.0123, "late")
    told = replace(log.signals["position"], name="goal")
    made = replace(log, signals={"goal": told, "position": replace(log.signals["late"], name="position")})
    one = lags([made], "position", "goal")[0]
    assert one.held == pytest.approx(0.005, abs=2e-4)
    assert one.delay == pytest.approx(0.0123, abs=3e-4)


@pytest.mark.parametrize(
    ("of", "against", "complaint"),
    [
        ("speed", "position", "no 'speed' signal"),
        ("late.x", "position", "none is called 'x'"),
        ("supply", "position", "expected the same unit"),
    ],
)
def test_wrong_channels_are_refused(of, against, complaint):
    """With what there is instead."""
    t, s = clocks()
    log = recording(
        position=("rad", t, waves(t), ()), late=("rad", s, waves(s), ()), supply=("V", s, 12 + waves(s), ())
    )
    with pytest.raises(LogError, match=complaint):
        lags([log], of, against)


def test_agreement():
    """Chi-square and spread of plain numbers."""
    same = agreement(np.array([1.0, 1.1, 0.9]), np.array([0.1, 0.1, 0.1]))
    assert (same.mean, same.chi2, same.dof) == (pytest.approx(1.0), pytest.approx(2.0), 2)
    assert same.p == pytest.approx(np.exp(-1.0))
    assert same.spread == pytest.approx(0.0, abs=1e-6)
    apart = agreement(np.array([1.0, 2.0]), np.array([0.01, 0.01]))
    assert apart.p < 1e-9
    assert apart.spread == pytest.approx(np.sqrt(0.5), rel=0.01)
    assert agreement(np.array([1.0]), np.array([0.1])).p == 1.0


def test_the_speed_of_dynaban(shared_dir):
    """Its speed is the way of the last 51 samples (1.0009 ms each): 25.52 ms late, where a test turns back."""
    path = shared_dir / "data" / "mx64_dynaban" / "completeTest.gz"
    if not path.exists():
        pytest.skip("no Dynaban log in the shared data")
    found = lags(read_dynaban(path)[30:39], "velocity", "position")
    good = [one for one in found if one.verdict == "identified"]
    assert len(good) >= 7
    assert all(abs(one.delay - 0.02552) < 2e-4 for one in good)
    joint = joint_lags(found)[0]
    assert joint.verdict == "identified"
    assert joint.low < 0.02552 < joint.high
    assert joint.high - joint.low < 6e-4


def test_the_gyro_on_an_axis(shared_dir):
    """Four frequencies do not agree: the gyro's delay grows from 6.5 to 8.2 ms, so it is a filter's."""
    folder = shared_dir / "data" / "imu_on_axis"
    if not folder.exists():
        pytest.skip("no IMU logs in the shared data")
    found = lags([read_imu_on_axis(path)[0] for path in sorted(folder.iterdir())], "gyro", "goal_velocity")
    assert [round(one.frequency) for one in found] == [1, 3, 5, 7]
    assert [one.delay for one in found] == pytest.approx([0.0065, 0.0069, 0.0077, 0.0082], abs=2e-4)
    joint = joint_lags(found)[0]
    assert joint.verdict == "filter"
    assert joint.used == 4
    assert joint.agreement.p < 1e-6


def test_the_tracking_of_robstride(shared_dir):
    """Chirps: 6 to 24 ms by actuator, amplitudes near 1."""
    folder = shared_dir / "data" / "robstride"
    if not folder.exists():
        pytest.skip("no Robstride logs in the shared data")
    logs = [read_robstride(path)[0] for path in sorted(folder.glob("real_*_kp*"))]
    found = {one.joint: one for one in lags(logs, "position", "goal")}
    assert {name: one.delay for name, one in found.items()} == pytest.approx(
        {
            "dof_right_hip_pitch_04": 0.0243,
            "dof_right_hip_roll_03": 0.0208,
            "dof_right_hip_yaw_03": 0.0118,
            "dof_right_knee_04": 0.0136,
            "dof_right_ankle_02": 0.0063,
        },
        abs=5e-4,
    )
    assert all(0.97 < one.ratio < 1.08 for one in found.values())

import numpy as np
import pytest

from frasa_sysid.clocks import compare_clocks, drift_ppm, jitter
from frasa_sysid.readers.jandi import read_jandi


@pytest.mark.parametrize("drift", [-120.0, 0.0, 35.0])
def test_a_drift_is_found_through_waiting(drift):
    """Messages that wait, some for long, do not turn the drift."""
    held = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        sent = np.arange(0, 60, 0.01) + rng.uniform(0, 0.001, 6000)
        received = sent * (1 + 1e-6 * drift) + 0.002 + rng.exponential(0.001, sent.size)
        received[:100] += np.linspace(1.0, 0.0, 100)
        value, low, high = drift_ppm(received, sent)
        assert abs(value - drift) < 1.0
        held += low <= drift <= high
    assert held >= 17


def test_whole_milliseconds_leave_an_interval():
    """Stamps that agree to the millisecond do not know the drift to nothing."""
    t = np.arange(0, 12, 0.2)
    value, low, high = drift_ppm(t, np.round(t * (1 + 1e-6), 3))
    assert low < -1 < high
    assert abs(value) < 50
    assert high - low > 10


def test_comparison_in_plain_values():
    """Offset, how late, and no drift where the log is too short."""
    t = np.arange(10) * 0.1
    found = compare_clocks("log", t + 0.005, "header", t)
    assert found["offset_ms"]["least"] == pytest.approx(5.0)
    assert found["offset_ms"]["most_above"] == pytest.approx(0.0, abs=1e-9)
    assert found["drift_ppm"] is None
    assert compare_clocks("log", t[:1], "header", t[:1]) == {}
    assert compare_clocks("log", np.full(3, np.nan), "header", t[:3]) == {}
    assert drift_ppm(np.ones(50), np.ones(50)) is None


def test_jitter():
    """Deviations from the usual period; a missed slot is a gap and no jitter of the line."""
    t = np.delete(np.arange(100) * 0.01, [40, 41])
    found = jitter(t)
    assert found["period_ms"] == pytest.approx(10.0)
    assert found["rms_us"] == pytest.approx(0.0, abs=1e-6)
    assert found["most_us"] == pytest.approx(20e3)
    assert found["drift_free_rms_us"] == pytest.approx(0.0, abs=1e-6)
    shaken = jitter(t + np.random.default_rng(0).uniform(-1e-4, 1e-4, t.size))
    assert shaken["drift_free_rms_us"] == pytest.approx(58, rel=0.2)
    assert jitter(t[:2]) is None


def test_host_and_servo_of_jandi(shared_dir):
    """The servo's clock runs 118 ppm slower than the host's; its three runs agree within their intervals."""
    folder = shared_dir / "data" / "mx106_jandi"
    if not folder.exists():
        pytest.skip("no Jandi runs in the shared data")
    for run in sorted(folder.iterdir()):
        drift = read_jandi(run)[0].extra["clocks"][0]["drift_ppm"]
        assert drift["low"] < 118.5 < drift["high"]
        assert drift["high"] - drift["low"] < 15

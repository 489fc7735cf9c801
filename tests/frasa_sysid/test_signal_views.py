import numpy as np
import pytest

from frasa_sysid.errors import LogError
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.signal_views import even, spectrum, speed_torque

RNG = np.random.default_rng(0)
T = np.cumsum(0.01 + RNG.uniform(-0.001, 0.001, 1200))


def test_even_interpolates_one_column():
    """The grid has the median period; a column is named, and a wrong name says what there is."""
    one = Signal("position", "rad", T, np.stack([2 * T, -T], axis=1), ("hip", "knee"))
    t, y = even(one, "knee")
    assert np.ptp(np.diff(t)) < 1e-9
    np.testing.assert_allclose(y, -t, atol=1e-9)
    with pytest.raises(LogError, match="it has hip, knee"):
        even(one, "ankle")
    with pytest.raises(LogError, match="3 samples"):
        even(Signal("position", "rad", T[:3], T[:3]))


def test_spectrum_peaks_where_the_motion_is():
    """A sine of amplitude a holds a^2 / 2 of power, around its own frequency."""
    f, density = spectrum(Signal("goal", "rad", T, 0.4 * np.sin(2 * np.pi * 3.0 * T) + 1.0))
    assert f[np.argmax(density)] == pytest.approx(3.0, abs=0.34)
    power = np.sum(density[(f > 2) & (f < 4)] ** 2) * (f[1] - f[0])
    assert power == pytest.approx(0.4**2 / 2, rel=0.05)


def test_speed_torque_of_a_known_motion():
    """Inertia times acceleration plus gravity, from the angles alone, counts of an encoder included."""
    q = 0.8 * np.sin(4 * T)
    counts = np.round(q / (2 * np.pi / 4096)) * (2 * np.pi / 4096)
    enable = Signal("torque_enable", "1", np.array([T[0], T[600]]), np.array([1.0, 0.0]))
    signals = {"position": Signal("position", "rad", T, counts), "torque_enable": enable}
    found = speed_torque(
        Recording("run", signals, RigFacts(mass=1.0, length=0.2, arm_mass=0.0), "real", "none", "", "header")
    )
    exact = 1.0 * 0.2**2 * -12.8 * np.sin(4 * found.t) + 9.81 * 0.2 * np.sin(0.8 * np.sin(4 * found.t))
    inner = slice(10, -10)
    assert np.abs(found.speed - 3.2 * np.cos(4 * found.t))[inner].max() < 0.06
    assert np.abs(found.torque - exact)[inner].max() < 0.08
    assert np.sqrt(np.mean((found.torque - exact)[inner] ** 2)) < 0.02
    assert not (found.powered & found.free).any()
    assert not (found.powered | found.free)[np.abs(found.t - T[600]) < 0.03].any()
    assert found.powered[found.t < T[600] - 0.06].all()
    assert found.free[found.t > T[600] + 0.06].all()


def test_speed_torque_needs_a_load():
    """Without mass and length nothing is known about torques; the message says what to give."""
    signals = {"position": Signal("position", "rad", T, np.sin(T))}
    with pytest.raises(LogError, match="--mass"):
        speed_torque(Recording("run", signals, RigFacts(), "real", "none", "", "header"))

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frasa_sysid.calibration.friction import Friction

M4 = Friction(
    viscous=0.05,
    coulomb=0.06,
    stribeck=0.02,
    load_motor=0.1,
    load_external=0.1,
    load_motor_stribeck=0.23,
    load_external_stribeck=0.23,
    stribeck_speed=1.5,
    stribeck_exponent=1.3,
)
torques = st.floats(-20, 20)
speeds = st.floats(-30, 30)


@given(torques, torques, speeds)
def test_the_law_of_the_paper(motor, external, speed):
    """The bound is the sum of the paper's terms, written out for one number."""
    load = abs(motor - external)
    fade = math.exp(-((abs(speed) / 1.5) ** 1.3))
    expected = 0.05 * abs(speed) + 0.06 + 0.1 * load + fade * (0.02 + 0.23 * load)
    assert float(M4.bound(*map(np.asarray, (motor, external, speed)))) == pytest.approx(expected, rel=1e-12)


@given(torques, torques, speeds)
def test_symmetric_and_never_negative(motor, external, speed):
    """Turning everything round changes nothing, and friction never pushes."""
    one = M4.bound(*map(np.asarray, (motor, external, speed)))
    assert one >= 0.06
    assert one == M4.bound(*map(np.asarray, (-motor, -external, -speed)))


@given(torques, torques, speeds)
def test_m1_knows_no_load(motor, external, speed):
    """With the extra coefficients at zero it is Coulomb and viscous friction alone."""
    bound = Friction(0.05, 0.06).bound(*map(np.asarray, (motor, external, speed)))
    assert float(bound) == pytest.approx(0.05 * abs(speed) + 0.06)


def test_shapes():
    """Many joints at once give one bound each."""
    assert M4.bound(np.zeros(7), np.ones(7), np.arange(7.0)).shape == (7,)

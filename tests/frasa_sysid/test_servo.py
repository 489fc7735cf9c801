from dataclasses import replace

import pytest

from frasa_sysid.errors import UsageError
from frasa_sysid.servo import NOMINAL, PUBLISHED_M4, servo


@pytest.mark.parametrize("name", NOMINAL)
def test_gain_and_limit_scale_with_the_supply(name):
    """Gain and limit are proportional to the supply, gain to P, damping to neither; the limit is below stall torque."""
    one = servo(name)
    double = replace(one, supply_voltage=2 * one.supply_voltage)
    assert double.kp() == pytest.approx(2 * one.kp())
    assert double.force_limit() == pytest.approx(2 * one.force_limit())
    assert double.damping() == one.damping() > one.friction.viscous
    assert replace(one, firmware_gain=3 * one.firmware_gain).kp() == pytest.approx(3 * one.kp())
    assert one.force_limit() <= one.supply_voltage * one.torque_per_volt()


@pytest.mark.parametrize(("name", "kp", "damping"), [("mx64", 11.7, 0.678), ("mx106", 21.0, 1.655)])
def test_published_numbers(name, kp, damping):
    """The voltage law gives the gain and damping that the sources state for 15 V and P = 12."""
    assert servo(name).kp() == pytest.approx(kp, rel=0.01)
    assert servo(name).damping() == pytest.approx(damping, rel=0.01)


def test_sts3250_meets_its_datasheet():
    """4.9 N m of stall torque and 7.85 rad/s without load, at 12 V."""
    one = servo("sts3250")
    assert one.torque_per_volt() * 12 == pytest.approx(4.9, rel=0.01)
    assert 12 / one.kt == pytest.approx(7.85, rel=0.01)


def test_unknown_servo():
    """An unknown name lists the known ones."""
    with pytest.raises(UsageError, match="mx106, mx64, sts3215, sts3250, xl330"):
        servo("mx28")
    with pytest.raises(UsageError, match=r"known are mx106, mx64$"):
        servo("xl330", PUBLISHED_M4)

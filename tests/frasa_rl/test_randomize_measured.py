"""What the published calibration measured reaches the drawn robots: every range to its ends, and together."""

from dataclasses import replace

import numpy as np
import pytest

from frasa_rl.config import Physics, Task
from frasa_rl.friction_stand_in import LOAD_SHARE, dry_friction, laws_aside
from frasa_rl.randomize import Randomizer
from frasa_rl.robot import find_robot
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import load_calibration, read, servo_law
from frasa_sysid.calibration.friction import Friction

COUNT = 1200
M1 = replace(Task(), physics=Physics(friction_law="coulomb_viscous"))


def made(path, task):
    model = build_model(path, task)
    return model, Randomizer(model, find_robot(model, task), task, load_calibration(path))


pytestmark = pytest.mark.usefixtures("law_as_before")


@pytest.fixture(scope="module")
def robots(robot_model_dir):
    """What is read from the models of many drawn robots, by parameter, shape (COUNT,) each."""
    path = robot_model_dir / "calibrated.xml"
    model, randomizer = made(path, Task())
    rng = np.random.default_rng(0)
    names = list(load_calibration(path).ranges)
    told, held = np.zeros((COUNT, len(names))), np.zeros((COUNT, len(names)))
    for index in range(COUNT):
        drawn = randomizer.draw(rng)
        told[index] = [drawn[name] for name in names]
        held[index] = [read(model, name) for name in names]
    np.testing.assert_allclose(held, told, rtol=1e-12)
    return dict(zip(names, held.T, strict=True))


def test_every_measured_range_is_reached(robots, robot_model_dir):
    """From its lowest to its highest percent, and no further."""
    for name, one in load_calibration(robot_model_dir / "calibrated.xml").ranges.items():
        near = 0.01 * (one.high - one.low) + 1e-12
        assert one.low - 1e-12 <= robots[name].min() < one.low + near, name
        assert one.high - near < robots[name].max() <= one.high + 1e-12, name


def test_numbers_that_were_fitted_together_are_drawn_together(robots, robot_model_dir):
    """Drawn models are correlated as the calibration says (6/pi asin(rho/2), what a Gaussian copula leaves of rho)."""
    calibration = load_calibration(robot_model_dir / "calibrated.xml")
    found = np.corrcoef([robots[name] for name in calibration.correlated])
    wanted = 6.0 / np.pi * np.arcsin(calibration.correlation / 2.0)
    np.testing.assert_allclose(found, wanted, atol=0.12)
    assert np.abs(wanted[~np.eye(len(wanted), dtype=bool)]).max() > 0.9  # there is something to see


def test_a_law_that_is_off_is_gone(robot_model_dir):
    """The model has constant friction, and every robot its own, drawn from the law's ranges; nothing else changes."""
    path = robot_model_dir / "calibrated.xml"
    servo_law.uninstall()
    model, randomizer = made(path, M1)
    full = build_model(path, Task())
    assert servo_law.has_law(full)
    assert not servo_law.has_law(model)
    np.testing.assert_array_equal(model.dof_damping, full.dof_damping)
    np.testing.assert_array_equal(model.actuator_gainprm, full.actuator_gainprm)
    nominal = {name: read(model, f"{name}.frictionloss") for name in ("mx64", "mx106")}
    rng, seen = np.random.default_rng(0), {name: [] for name in nominal}
    for _ in range(200):
        drawn = randomizer.draw(rng)
        assert not [name for name in drawn if "stribeck" in name or "load" in name]
        for name, values in seen.items():
            values.append(read(model, f"{name}.frictionloss"))
            assert values[-1] == drawn[f"{name}.frictionloss"]
    for name, values in seen.items():
        assert min(values) < nominal[name] < max(values)
        assert max(values) < 1.3 * min(values)  # the law's ranges are narrow


M6 = Friction(0.05, 0.01, 0.1, 0.014, 0.02, 0.2, 0.25, 0.01, 0.02, 1.5, 1.4)


@pytest.mark.parametrize("law", [Friction(0.05, 0.07), M6])
def test_the_stand_in_turns_as_much_work_into_heat(law):
    """Over uniform speeds and loads, by a quadrature of its own; Coulomb friction is its own stand-in."""
    limit, speed = 13.0, 6.0
    found = dry_friction(law, limit, speed)
    rng = np.random.default_rng(0)
    speeds, loads = rng.uniform(0.0, speed, 200_000), rng.uniform(0.0, LOAD_SHARE * limit, 200_000)
    heat = (law.bound(loads, -loads, speeds) - law.viscous * speeds) * speeds
    assert found * speeds.mean() == pytest.approx(heat.mean(), rel=0.01)
    if not law.stribeck:
        assert found == pytest.approx(law.coulomb)


def test_the_stand_in_is_near_the_one_that_was_fitted(robot_model_dir):
    """`publish --as m1` fitted 0.074 and 0.089 N m on the bench: the same size, not the same number."""
    laws = laws_aside(build_model(robot_model_dir / "calibrated.xml", M1))
    for servo, limit, fitted in (("mx106", 13.5, 0.074), ("mx64", 7.43, 0.089)):
        assert 0.5 < dry_friction(laws[servo], limit, M1.rate_limit) / fitted < 2.0

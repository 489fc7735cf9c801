"""Training on a robot whose servos have a friction law beyond Coulomb-viscous."""

import copy
from contextlib import contextmanager
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml
from mujoco import rollout

from frasa_rl.randomize import Randomizer
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import Calibration, Range, actuators_of, dofs_of, load_model, servo_law
from frasa_sysid.calibration.friction import Friction

M4 = Friction(0.1, 0.05, 0.08, 0.06, 0.06, 0.1, 0.1, stribeck_speed=0.4, stribeck_exponent=1.2)
RANGES = Calibration(
    id="c0ffee",
    ranges={
        "mx106.frictionloss": Range(0.04, 0.05, 0.06, "N m", "a test"),
        "mx106.stribeck": Range(0.06, 0.08, 0.10, "N m", "a test"),
        "mx106.load_motor": Range(0.04, 0.06, 0.08, "1", "a test"),
        "mx106.kp": Range(20.0, 21.0, 22.0, "N m/rad", "a test"),
        "supply_voltage": Range(14.0, 15.0, 15.5, "V", "a test"),
    },
)
CUSTOM = """<custom><text name="calibration_id" data="c0ffee"/>
<numeric name="present_supply_voltage" data="15"/>
<numeric name="mx106_friction" data="{law}"/><numeric name="mx64_friction" data="{law}"/></custom></mujoco>"""


pytestmark = pytest.mark.usefixtures("law_as_before")


@pytest.fixture
def with_law(model_copy):
    """A calibrated model whose two servo classes have the law M4, and ranges for one of them."""
    law = " ".join(map(repr, [M4.viscous, *M4.coefficients().tolist()]))
    path = model_copy.with_name("calibrated.xml")
    path.write_text(model_copy.read_text().replace("</mujoco>", CUSTOM.format(law=law)))
    path.with_name("randomization.yaml").write_text(yaml.safe_dump(RANGES.to_dict()))
    return path


def end_of(env, steps=10, seed=3):
    """Observation after some random actions in an episode of a seeded environment."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    for _ in range(steps):
        last = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape))
    return last[0]


def test_the_environment_feels_the_law(with_law):
    """Episodes run, repeat with their seed, and are others where the law does not act."""
    env = StandUp(with_law)
    assert servo_law.installed()
    first = end_of(env)
    assert np.isfinite(first).all()
    np.testing.assert_array_equal(end_of(StandUp(with_law)), first)
    assert env.divergences == 0
    servo_law.uninstall()
    assert not np.array_equal(end_of(env), first)


def test_every_episode_has_its_own_law(with_law):
    """Measured coefficients come from their ranges, the rest stays, and the original can be restored."""
    env, rng = StandUp(with_law), np.random.default_rng(0)
    seen, maker = [], env._maker
    for _ in range(30):
        model, drawn = maker.draw_robot(rng)
        law = servo_law.law(model, "mx106")
        load = drawn["mx106.load_motor"]
        assert law == replace(
            M4,
            coulomb=drawn["mx106.frictionloss"],
            stribeck=drawn["mx106.stribeck"],
            load_motor=load,
            load_external=load,
        )
        # The other class has no measured friction: its Coulomb part takes the assumed ratio.
        other = servo_law.law(model, "mx64")
        assert other == replace(M4, coulomb=M4.coulomb * drawn["frictionloss"])
        assert model.dof_frictionloss[dofs_of(model, actuators_of(model, "mx64"))[0]] == other.coulomb
        seen.append(load)
    assert 0.04 <= min(seen) < 0.05
    assert 0.07 < max(seen) <= 0.08
    env.randomizer.restore()
    fresh = load_model(with_law)
    for name in ("numeric_data", "dof_frictionloss", "actuator_gainprm", "actuator_forcerange"):
        np.testing.assert_array_equal(getattr(maker.model, name), getattr(fresh, name))


def test_a_measured_supply_replaces_the_assumed_one(with_law):
    """Gains and limits of all servos follow the measured supply, once."""
    env, original = StandUp(with_law), load_model(with_law)
    for seed in range(20):
        model, drawn = env._maker.draw_robot(np.random.default_rng(seed))
        assert 14.0 <= drawn["supply_voltage"] <= 15.5
        ratio = drawn["supply_voltage"] / 15.0
        np.testing.assert_allclose(model.actuator_forcerange, ratio * original.actuator_forcerange)
        gains = model.actuator_gainprm[actuators_of(model, "mx106"), 0]
        np.testing.assert_allclose(gains, ratio * drawn["mx106.kp"])


def test_copies_of_the_model_are_drawn_apart(with_law):
    """A batch of copies, each with a draw of its own, in one rollout as in loops of steps."""
    env = StandUp(with_law)
    original = load_model(with_law)
    models = [copy.copy(original) for _ in range(3)]
    for seed, model in enumerate(models):
        Randomizer(model, env.robot, env.task, RANGES).draw(np.random.default_rng(seed))
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    data = mujoco.MjData(original)
    mujoco.mj_resetDataKeyframe(original, data, 0)
    start = np.empty((3, mujoco.mj_stateSize(original, full)))
    mujoco.mj_getState(original, data, start[0], full)
    start[:] = start[0]
    goals = np.tile(original.key_ctrl[0], (3, 100, 1))
    together, _ = rollout.rollout(models, [mujoco.MjData(original) for _ in range(2)], start, goals)
    for model, path in zip(models, together, strict=True):
        alone = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, alone, 0)
        mujoco.mj_step(model, alone, 100)
        np.testing.assert_array_equal(path[-1, 1 : 1 + model.nq], alone.qpos)
    assert not np.array_equal(together[0], together[1])


def test_the_environments_of_a_run_feel_it_too(with_law, tmp_path):
    """A run's robots move as one alone does from the same start; without the law they move otherwise."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.plan import Plan
    from frasa_rl.settings import Settings
    from frasa_rl.train import make_loop

    settings = Settings(envs=2, pool=3, physics="model", buffer=100)
    plan = Plan(model=with_law, out=tmp_path, settings=settings, steps=10, device="cpu")
    loop = make_loop(plan)
    try:
        episodes = loop.collector.episodes
        alone = StandUp(with_law, plan.task)
        chosen = int(episodes.chosen[0])
        alone.core.begin(0, episodes.pool.starts[chosen])
        rng = np.random.default_rng(3)
        actions = rng.uniform(-1.0, 1.0, (10, len(plan.task.joints)))
        for action in actions:
            last = episodes.step(np.tile(action, (2, 1))).following
            felt = alone.step(action)[0]
        pool = episodes.pool
    finally:
        loop.close()
    np.testing.assert_array_equal(last[0], felt)
    with lawless():
        alone.core.begin(0, pool.starts[chosen])
        for action in actions:
            unfelt = alone.step(action)[0]
    assert np.abs(unfelt - felt).max() > 1e-3


@contextmanager
def lawless():
    """MuJoCo without the law, for a moment."""
    servo_law.uninstall()
    try:
        yield
    finally:
        servo_law.install()

"""Named physics: what they change, what a task says itself, and what a policy is measured on."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.compat2024 import compat_task
from frasa_rl.config import Physics, Task
from frasa_rl.physics import own_physics, with_physics
from frasa_rl.settings import PRESETS, Settings
from frasa_rl.standup_env import StandUp
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import UsageError


def test_fast_physics_reach_the_model(nominal):
    """Steps of 6.25 ms and no noslip pass; the model file's own are 2 ms and one."""
    own, fast = (build_model(nominal, with_physics(Task(), name)).opt for name in ("model", "fast"))
    assert (own.timestep, own.noslip_iterations) == (0.002, 1)
    assert (fast.timestep, fast.noslip_iterations) == (0.00625, 0)
    island = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    assert (own.disableflags & island, fast.disableflags & island) == (0, island)


def test_islands_change_no_number(nominal):
    """A robot is one island: searching for it or not, it moves alike."""
    ends = []
    for islands in (True, False):
        env = StandUp(nominal, Task(physics=Physics(islands=islands)), randomize=False)
        env.reset(seed=3, options={"start": "prone"})
        for k in range(20):
            env.step(np.full(5, 0.3 * (-1) ** (k // 5), dtype=np.float32))
        ends.append(env.data.qpos.copy())
    np.testing.assert_allclose(*ends, atol=1e-6)


def test_what_a_task_says_itself_stays():
    """A time step from a task file, another period, the published environment."""
    said = with_physics(Task(physics=Physics(timestep=0.001, noslip_iterations=2)), "fast").physics
    assert (said.timestep, said.noslip_iterations) == (0.001, 2)
    assert with_physics(replace(Task(), control_period_s=0.04), "fast").physics.timestep == 0.04 / 7
    published = compat_task(Task())
    assert with_physics(published, "fast") == published


def test_a_policy_is_measured_on_the_models_own_physics():
    """Whatever it was trained with; the published environment stays what it is."""
    assert own_physics(with_physics(Task(), "fast")) == Task()
    assert own_physics(compat_task(Task())).physics.timestep == 0.002


def test_presets_and_settings():
    """The quick preset is fast, the paper's steps as the model file says, and other words are refused."""
    assert (PRESETS["quick"].physics, PRESETS["paper"].physics) == ("fast", "model")
    with pytest.raises(UsageError, match="physics are 'quick'"):
        Settings(physics="quick")

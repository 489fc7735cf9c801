"""Environments and models that several tests of training share."""

import copy
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from frasa_rl.config import Task
from frasa_rl.policy import Policy
from frasa_rl.simulation import Start, fresh, state_of
from frasa_rl.standup_env import StandUp
from frasa_rl.task_text import task_data
from frasa_sysid.calibration import Calibration, Range, hold_history

MEASURED = Calibration(
    id="c0ffee",
    ranges={
        "mx106.damping": Range(1.60, 1.65, 1.70, "N m s/rad", "a test"),
        "mx106.frictionloss": Range(0.11, 0.12, 0.13, "N m", "a test"),
        "mx106.kp": Range(20.0, 21.0, 22.0, "N m/rad", "a test"),
        "mx106.delay": Range(0.004, 0.006, 0.008, "s", "a test"),
        "sensor.gyro_delay": Range(0.020, 0.025, 0.030, "s", "a test"),
    },
)


@pytest.fixture(scope="session")
def random_policy() -> Callable[..., Policy]:
    """Makes a policy of the Sigmaban's task that moves all joints and saturates now and then."""

    def make(*hidden: int, inputs: int = 22, run: dict[str, object] | None = None) -> Policy:
        rng = np.random.default_rng(0)
        layers = tuple(
            ((rng.normal(size=(to, of)) / np.sqrt(of)).astype(np.float32), rng.normal(size=to).astype(np.float32))
            for of, to in pairwise((inputs, *hidden, 5))
        )
        said = {"task": task_data(Task()), "calibration_id": None, "settings": {"seed": 3}, "trained": {"steps": 10}}
        return Policy(layers, {**said, **(run or {})})

    return make


@pytest.fixture
def nominal(robot_model_dir: Path) -> Path:
    return robot_model_dir / "nominal.xml"


@pytest.fixture
def model_copy(robot_model_dir: Path, tmp_path: Path) -> Path:
    """A copy of the nominal model, to be edited."""
    folder = tmp_path / "model"
    shutil.copytree(robot_model_dir, folder)
    return folder / "nominal.xml"


@pytest.fixture
def calibrated(model_copy: Path) -> Path:
    """A model with a calibration id, and the ranges that belong to it."""
    text = model_copy.read_text().replace(
        "</mujoco>", f'<custom><text name="calibration_id" data="{MEASURED.id}"/></custom></mujoco>'
    )
    path = model_copy.with_name("calibrated.xml")
    path.write_text(text)
    path.with_name("randomization.yaml").write_text(yaml.safe_dump(MEASURED.to_dict()))
    return path


@pytest.fixture
def env(nominal: Path) -> StandUp:
    return StandUp(nominal)


@pytest.fixture
def plain_env(nominal: Path) -> StandUp:
    """The robot as it is in its file, episode after episode."""
    return StandUp(nominal, randomize=False)


@pytest.fixture
def start_by_hand():
    """Makes a start of a state that is set by hand, held since ever."""

    def make(env: StandUp, qpos: object = None, qvel: object = None) -> Start:
        model = copy.copy(env._maker.original)
        data = mujoco.MjData(model)
        data.qpos[:] = env.data.qpos if qpos is None else qpos
        data.qvel[:] = 0.0 if qvel is None else qvel
        data.ctrl[:] = env.data.ctrl
        hold_history(model, data)
        ages = fresh(model)
        return Start(model, state_of(model, data), data.ctrl.copy(), np.array(data.sensordata), ages, {})

    return make


@pytest.fixture
def crossq_model(monkeypatch):
    """Makes a CrossQ of a class, with random transitions in its buffer; `double`: all of it in double precision."""
    gym, torch = pytest.importorskip("gymnasium"), pytest.importorskip("torch")
    pytest.importorskip("sb3_contrib")
    from stable_baselines3.common.logger import Logger

    class Nothing(gym.Env):
        def __init__(self, seen, acted):
            self.observation_space = gym.spaces.Box(-9, 9, (seen,), np.float32)
            self.action_space = gym.spaces.Box(-1, 1, (acted,), np.float32)

        def reset(self, *, seed=None, options=None):
            return np.zeros(self.observation_space.shape, np.float32), {}

        def step(self, action):
            return self.reset()[0], 0.0, False, False, {}

    def make(kind, seen=22, acted=5, double=False, pi=(64, 64), qf=(64, 64), warmup=100, policy=None, **more):
        torch.set_num_threads(1)
        extra = {"net_arch": {"pi": list(pi), "qf": list(qf)}, "renorm_warmup_steps": warmup, **(policy or {})}
        settings = {"buffer_size": 3000, "seed": 3, "device": "cpu", "learning_rate": 1e-3, **more}
        model = kind("MlpPolicy", Nothing(seen, acted), policy_kwargs=extra, **settings)
        model.set_logger(Logger(None, []))
        fill(model.replay_buffer)
        return in_double(model) if double else model

    def fill(buffer):
        rng = np.random.default_rng(1)
        shape = buffer.observations.shape
        buffer.observations[:] = rng.normal(0.5, 1.0, shape) * rng.uniform(0.2, 2.0, shape[-1])
        buffer.next_observations[:] = buffer.observations + rng.normal(0.0, 0.3, shape)
        buffer.actions[:] = rng.uniform(-1.0, 1.0, buffer.actions.shape)
        buffer.rewards[:] = rng.normal(0.0, 1.0, buffer.rewards.shape)
        buffer.dones[:] = rng.random(buffer.dones.shape) < 0.05
        buffer.timeouts[:] = (rng.random(buffer.dones.shape) < 0.3) * buffer.dones
        buffer.pos = buffer.buffer_size - 1

    def in_double(model):
        monkeypatch.setattr("stable_baselines3.common.policies.preprocess_obs", lambda x, *_, **__: x)
        model.policy.double()
        if model.log_ent_coef is not None:
            model.log_ent_coef = model.log_ent_coef.detach().double().requires_grad_(True)
            model.ent_coef_optimizer = torch.optim.Adam([model.log_ent_coef], lr=1e-3)
        else:
            model.ent_coef_tensor = model.ent_coef_tensor.double()
        model.replay_buffer.to_torch = lambda x, copy=True: torch.as_tensor(x.astype(np.float64))
        return model

    return make

"""The environment keeps gymnasium's contract and the task's definition."""

import subprocess
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import frasa_rl
from frasa_rl.config import Joint, Task
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import ModelError, UsageError

STILL = np.zeros(5, dtype=np.float32)


def run_episode(env, seed, steps):
    """Observations and rewards of `steps` random steps from a seed, over as many episodes as they take."""
    rng = np.random.default_rng(7)
    seen = [env.reset(seed=seed)[0]]
    rewards = []
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 5).astype(np.float32))
        seen.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            seen.append(env.reset()[0])
    return np.array(seen), np.array(rewards)


@pytest.mark.filterwarnings("ignore:.*:UserWarning")
def test_gymnasium_accepts_the_environment(env):
    """The environment passes gymnasium's own check."""
    check_env(env, skip_render_check=True)


def test_stable_baselines_accepts_the_environment(env):
    """The environment passes stable-baselines3's own check."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(env, warn=True)


def test_it_is_registered_with_gymnasium(nominal):
    """Importing frasa_rl makes the environment known to gymnasium.make, which truncates nothing itself."""
    made = gymnasium.make("frasa/StandUp-v0", model=nominal)
    assert isinstance(made.unwrapped, frasa_rl.StandUp)


def test_the_environment_needs_no_torch(nominal):
    """Importing frasa_rl loads neither torch nor MuJoCo; running the environment loads no torch."""
    code = (
        "import sys, frasa_rl; assert not {'torch', 'mujoco'} & set(sys.modules)\n"
        f"frasa_rl.StandUp({str(nominal)!r}).reset(seed=0); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_same_seed_same_trajectory(nominal):
    """All chance comes from the seed: two environments agree over 1,000 steps, resets included."""
    first, second = (run_episode(StandUp(nominal), seed=3, steps=1000) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def test_a_reset_does_not_depend_on_what_was_before(nominal):
    """A seeded reset is the same in a fresh environment and after other episodes (upstream bug B7, B8)."""
    fresh, used = StandUp(nominal), StandUp(nominal)
    run_episode(used, seed=1, steps=30)
    np.testing.assert_array_equal(fresh.reset(seed=5)[0], used.reset(seed=5)[0])


def test_an_episode_lasts_five_seconds(plain_env):
    """Truncation comes with the 100th action, not the 101st."""
    plain_env.reset(seed=0)
    flags = [plain_env.step(STILL)[2:4] for _ in range(100)]
    assert flags[:99] == [(False, False)] * 99
    assert flags[99] == (False, True)


def test_an_action_is_a_rate_for_one_control_period(plain_env):
    """Action 1 moves a command by 2 pi rad/s times 50 ms, on both sides, and takes 50 ms of simulation."""
    plain_env.reset(seed=0, options={"start": "target"})
    servos, before, time = plain_env.robot.actuators, plain_env.data.ctrl.copy(), plain_env.data.time
    plain_env.step(np.array([0.5, 0.0, 0.0, 0.0, -1.0]))
    moved = (plain_env.data.ctrl - before)[servos]
    others = np.setdiff1d(np.arange(plain_env.model.nu), servos)
    assert not (plain_env.data.ctrl - before)[others].any()
    expected = np.array([0.5, 0.0, 0.0, 0.0, -1.0]) * 2 * np.pi * 0.05
    np.testing.assert_allclose(moved, np.stack([expected, expected], axis=1), atol=1e-12)
    assert plain_env.data.time - time == pytest.approx(0.05)


def test_commands_ramp_and_stay_inside_their_limits(plain_env, monkeypatch):
    """Commands rise linearly over the 25 substeps and never leave the control range."""
    plain_env.reset(seed=0, options={"start": "target"})
    told, sim = [], plain_env.core.batch.sim
    advance = sim.advance
    monkeypatch.setattr(sim, "advance", lambda commands: (told.append(commands.copy()), advance(commands)))
    first = plain_env.data.ctrl.copy()
    plain_env.step(np.array([0.2, 0, 0, 0, 0]))
    commands = np.vstack([first, told[0][0]])[:, plain_env.robot.actuators[0]]
    assert commands.shape == (26, 2)  # what it was, and 25 substeps
    np.testing.assert_allclose(np.diff(commands, axis=0), 0.2 * 2 * np.pi * 0.05 / 25)
    for _ in range(20):
        plain_env.step(np.ones(5))
    low, high = plain_env.model.actuator_ctrlrange.T
    for commands in told:
        assert (commands >= low).all()
        assert (commands <= high).all()
    np.testing.assert_allclose(told[-1][0, -1, plain_env.robot.actuators[0]], plain_env.robot.limits[0, 1])


def test_actions_beyond_one_are_clipped(nominal):
    """An action outside [-1, 1] acts like the nearest one inside."""
    one, other = StandUp(nominal), StandUp(nominal)
    one.reset(seed=2)
    other.reset(seed=2)
    np.testing.assert_array_equal(one.step(np.full(5, 9.0))[0], other.step(np.ones(5))[0])


@pytest.mark.parametrize(
    ("limits", "ends"),
    [({"end_pitch_deg": 20.0}, True), ({"end_gyro": 0.0}, True), ({}, False)],
)
def test_an_episode_ends_beyond_pitch_or_rate(nominal, limits, ends, start_by_hand):
    """An episode ends beyond the pitch limit or the rate limit, and not otherwise."""
    env = StandUp(nominal, replace(Task(), **limits), randomize=False)
    lying = StandUp(nominal, randomize=False)
    lying.reset(seed=0, options={"start": "prone"})  # one that ends at 20 deg never starts prone
    env.core.begin(0, start_by_hand(lying))
    assert env.step(STILL)[2] is ends


@pytest.mark.parametrize(
    ("pitch", "rate", "over"),
    [
        (132.0, 0.0, False),
        (138.0, 0.0, True),
        (-138.0, 0.0, True),
        (0.0, -5.5, True),
        (0.0, 5.5, True),
        (0, 4.5, False),
    ],
)
def test_ends_are_tested_on_the_true_state_both_ways(nominal, start_by_hand, pitch, rate, over):
    """Tilt beyond 135 deg and rate beyond 5 rad/s end an episode in either direction, though not yet measured."""
    env = StandUp(nominal, replace(Task(), control_period_s=0.004), randomize=False)
    env.reset(seed=0)
    qpos, half = env.data.qpos.copy(), np.radians(pitch) / 2
    qpos[2:7] = (2.0, np.cos(half), 0.0, np.sin(half), 0.0)  # in the air, where nothing stops it
    qvel = np.zeros(env.model.nv)
    qvel[4] = rate
    env.core.begin(0, start_by_hand(env, qpos, qvel))
    assert env.step(STILL)[2] is over


@pytest.mark.parametrize("poison", [1e12, np.nan])
def test_a_diverged_simulation_ends_the_episode(plain_env, start_by_hand, poison, monkeypatch, tmp_path):
    """A simulation that blows up ends its episode, is counted, and the next episode is sound."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it runs
    plain_env.reset(seed=0)
    before = start_by_hand(plain_env)
    state = before.state.copy()
    state[1 + plain_env.model.nq :][: plain_env.model.nv] = poison
    plain_env.core.begin(0, replace(before, state=state), look=False)  # what it saw last was sound
    observation, reward, terminated, truncated, info = plain_env.step(STILL)
    assert terminated
    assert not truncated
    assert info["diverged"]
    assert reward == 0.0
    assert np.isfinite(observation).all()
    assert plain_env.divergences == 1
    plain_env.reset(seed=0)
    assert not plain_env.step(STILL)[4]["diverged"]


@pytest.mark.parametrize("action", [np.zeros(1), np.full(5, np.nan), np.zeros((5, 1))])
def test_broken_actions_are_refused(plain_env, action):
    """An action of another shape, or not finite, is a mistake and not a command."""
    plain_env.reset(seed=0)
    with pytest.raises(ValueError, match="5 finite numbers"):
        plain_env.step(action)


def test_missing_names_are_all_listed(nominal):
    """A model without the task's joints is refused with what is missing and what there is."""
    task = replace(Task(), joints=(*Task().joints, Joint("tail", 0.0), Joint("wing", 0.0)))
    with pytest.raises(ModelError, match=r"lacks joint left_tail, right_tail, left_wing.* it has .*left_knee"):
        StandUp(nominal, task)


def test_another_robot_is_refused(tmp_path):
    """A model that is not this robot leads to one clear error."""
    path = tmp_path / "box.xml"
    path.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(ModelError, match="lacks joint left_elbow"):
        StandUp(path)


def test_a_time_step_must_divide_the_control_period(model_copy):
    """A time step that does not divide 50 ms is refused: rounding it would change the clock."""
    model_copy.write_text(model_copy.read_text().replace('timestep="0.002"', 'timestep="0.003"'))
    with pytest.raises(ModelError, match="does not divide"):
        StandUp(model_copy)


def test_unknown_options_are_refused(nominal, plain_env):
    """A start or render mode that does not exist is named, with those that do."""
    with pytest.raises(UsageError, match="prone"):
        plain_env.reset(options={"start": "sideways"})
    with pytest.raises(UsageError, match="rgb_array"):
        StandUp(nominal, render_mode="human")


def test_success_needs_half_a_second(plain_env, monkeypatch):
    """Standing counts only after all six errors were below 5 deg for 0.5 s without a gap."""
    plain_env.reset(seed=0)
    error = np.zeros((1, 6))
    monkeypatch.setattr(plain_env.core.batch, "errors", lambda: error)
    seen = [plain_env.step(STILL)[4]["is_success"] for _ in range(11)]
    assert seen == [False] * 10 + [True]
    error[0, 3] = np.radians(5.1)
    assert not plain_env.step(STILL)[4]["is_success"]

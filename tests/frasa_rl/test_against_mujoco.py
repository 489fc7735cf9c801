"""The batch against a plain loop over `mj_step`: the same states, readings, observations and rewards."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.batch import Batch
from frasa_rl.batch_env import StandUpBatch
from frasa_rl.config import Physics, Reward, Task
from frasa_rl.poses import place, standing, trunk_heights
from frasa_rl.readings import read
from frasa_rl.robot import pitch_of
from frasa_rl.simulation import FULL
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import load_calibration

TARGET = np.radians([-49.5, 19.5, -52.0, 79.0, -36.5, 8.5])
STEPS, ROBOTS = 100, 3
# Model, delay of every sensor [s] (None: as it is drawn), physics step and control period [s].
CASES = [
    ("nominal", 0.0, 0.005, 0.05),
    ("nominal", 0.0007, 0.002, 0.01),
    ("nominal", 0.0073, 0.002, 0.05),
    ("nominal", 0.05, 0.005, 0.05),
    ("nominal", 0.0007, 0.005, 0.05),
    ("nominal", 0.0031, 0.002, 0.01),
    ("nominal", 0.004, 0.002, 0.01),
    ("nominal", 0.0073, 0.005, 0.01),
    ("calibrated", None, 0.002, 0.01),
]


class Alone:
    """One robot, stepped in Python, its sensors with the delays that the model states."""

    def __init__(self, robot, start):
        self.robot, self.ages = robot, start.ages
        self.model = copy.copy(start.model)
        self.model.sensor_delay[:] = start.ages
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, self.data, start.state, FULL)
        self.data.ctrl[:] = start.ctrl
        self.command = start.ctrl[robot.actuators[:, 0]].copy()
        self.previous = np.zeros(5)
        self.feet = [i for i in range(self.model.nbody) if "_cleat_" in self.model.body(i).name]

    def act(self, action, period):
        """One control period; keeps the two last instants for readings younger than a physics step."""
        model, data, robot = self.model, self.data, self.robot
        low, high = robot.limits.T
        goal = np.clip(self.command + action * 2 * np.pi * period, low, high)
        steps = round(period / model.opt.timestep)
        data.qacc_warmstart[:] = 0.0
        for k in range(1, steps + 1):
            now = self.command + k / steps * (goal - self.command)
            data.ctrl[robot.actuators] = now[:, None]
            self.old = self.instant()
            mujoco.mj_step(model, data)
        self.contact = sum(np.linalg.norm(data.sensordata[robot.self_contact].reshape(-1, 3), axis=1))
        self.above_feet = data.subtree_com[robot.trunk] - data.xpos[self.feet].mean(axis=0)
        self.upward = data.xmat[self.feet].reshape(-1, 3, 3)[:, 2]
        mujoco.mj_forward(model, data)
        self.command, self.last, self.previous = goal, self.previous, action

    def instant(self):
        """Truth by the sensor that measures it: joint angles and speeds (5, 2), quaternion, turning rate."""
        q, v, robot = self.data.qpos, self.data.qvel, self.robot
        return q[robot.qpos], v[robot.dofs], q[3:7].copy(), v[3:6].copy()

    def readings(self):
        """Angles, speeds, pitch and its rate, as old as the delays."""
        robot, data, h = self.robot, self.data, self.model.opt.timestep
        found = []
        for sensors, size, old, now in zip(
            (robot.position, robot.velocity, robot.orientation, robot.gyro),
            (1, 1, 4, 3), self.old, self.instant(), strict=True,
        ):  # fmt: skip
            seen = np.array([[data.sensordata[a : a + size] for a in row] for row in np.atleast_2d(sensors.start)])
            age = self.ages[sensors.ids].reshape(*np.atleast_2d(sensors.ids).shape, 1)
            # MuJoCo has no sample younger than its last step: between that and now it is a straight line.
            young = now.reshape(seen.shape) + age / h * (old - now).reshape(seen.shape)
            found.append(np.where((age > 0) & (age < h), young, seen))
        q, v, quaternion, turning = found
        return q[:, :, 0], v[:, :, 0], pitch_of(quaternion[0, 0]), turning[0, 0, 1]

    def rewards(self, standing, mass, upward):
        """The published formula on what is true, and the terms that lead up to the standing height, of its mass [m]."""
        angles = self.data.qpos[self.robot.qpos].mean(axis=1)
        error = np.append(angles, pitch_of(self.data.qpos[3:7])) - TARGET
        rate, before = self.previous * 2 * np.pi, self.last * 2 * np.pi
        high = min(max((self.data.qpos[2] / standing - 0.25) / 0.75, 0.0), 1.0)
        flat = np.mean(1 + np.sum(self.upward * upward, axis=1)) / 2
        upright = (1 + np.cos(error[5])) / 4 + np.exp(-4 * error[5] ** 2) / 2
        square, still = np.sum(error**2), 1 - np.sqrt(np.mean((rate / (2 * np.pi)) ** 2))
        return [
            np.exp(-20 * square),
            0.1 * np.exp(-np.linalg.norm(rate)),
            0.05 * np.exp(-np.linalg.norm(rate - before)),
            0.1 * np.exp(-self.contact),
            0.8
            * np.exp(-np.sum((self.above_feet / mass - [0, 0, 1]) ** 2) / 0.72)
            * (0.3 + 0.7 * flat)
            * (0.3 + 0.35 * (1 + np.cos(error[5]))),
            high * upright * (np.exp(-2 * square) + np.exp(-8 * square) + still * np.exp(-64 * square)) / 3,
        ]


def actions(period):
    """Waves and random steps of 3 robots, shape (100, 3, 5)."""
    rng, time = np.random.default_rng(1), period * np.arange(STEPS)[:, None, None]
    wave = np.sin(5.0 * time + np.arange(15).reshape(3, 5))
    return np.clip(0.5 * wave + rng.normal(0.0, 0.3, (STEPS, ROBOTS, 5)), -1.0, 1.0)


def falling_robots(path, task, delay):
    """A model of the task and three starts in mid-fall, each of a random robot."""
    model = build_model(path, task)
    if delay is not None:
        model.sensor_delay[model.sensor_history[:, 0] > 0] = delay
    maker = StartMaker(model, task, load_calibration(path), threads=1)
    return model, maker.make([np.random.default_rng(seed) for seed in range(ROBOTS)], ["falling"] * ROBOTS)


@pytest.mark.parametrize(("name", "delay", "timestep", "period"), CASES)
def test_the_batch_is_a_loop_of_steps(robot_model_dir, name, delay, timestep, period):
    """Three random robots over 100 decisions, with one thread and with two, each as it would be alone."""
    task = replace(Task(), physics=Physics(timestep=timestep))
    model, starts = falling_robots(robot_model_dir / f"{name}.xml", task, delay)
    told = actions(period)
    batches = [Batch(model, task, ROBOTS, threads, period_s=period) for threads in (1, 2)]
    alone = [Alone(batches[0].robot, start) for start in starts]
    if delay is not None:
        assert {float(one) for one in starts[0].ages} == {0.0, delay}  # that of self-contact is none
    for batch in batches:
        for index, start in enumerate(starts):
            batch.put(index, start)
    recent, parts = np.zeros((ROBOTS, round(0.05 / period), 5)), round(0.05 / period)
    for k in range(STEPS):
        for batch in batches:
            batch.act(told[k])
        np.testing.assert_array_equal(batches[0].sim.state, batches[1].sim.state)
        np.testing.assert_array_equal(batches[0].observation, batches[1].observation)
        batch = batches[0]
        seen = read(batch.robot, batch.sim, batch.now, batch._ages)
        recent[:, k % parts] = told[k]
        for i, one in enumerate(alone):
            one.act(told[k, i], period)
            np.testing.assert_allclose(batch.sim.qpos[i], one.data.qpos, rtol=0, atol=1e-9)
            np.testing.assert_allclose(batch.sim.qvel[i], one.data.qvel, rtol=0, atol=1e-9)
            q, v, pitch, rate = one.readings()
            np.testing.assert_allclose(seen.positions[i], q, rtol=0, atol=1e-9)
            np.testing.assert_allclose(seen.velocities[i], v, rtol=0, atol=1e-9)
            np.testing.assert_allclose([seen.pitch[i], seen.pitch_rate[i]], [pitch, rate], rtol=0, atol=1e-9)
            row = [*q.mean(axis=1), *v.mean(axis=1), *one.command, pitch, rate, *recent[i].mean(axis=0)]
            limit = np.repeat([2 * np.pi, 30, np.pi, np.pi, 30, 1], [5, 5, 5, 1, 1, 5])
            np.testing.assert_allclose(batch.observation[i], np.clip(row, -limit, limit), rtol=2e-7, atol=2e-7)
    assert np.abs(batch.sim.qvel).max() > 0.1  # they did move
    for batch in batches:
        batch.close()


@pytest.mark.parametrize("name", ["nominal", "calibrated"])
def test_rewards_are_the_formula_of_the_loop(robot_model_dir, name):
    """States and all six terms of three robots, every step, and no robot that takes another's."""
    task = replace(Task(), reward=Reward(gathering=0.8, approach=1.0))
    model, starts = falling_robots(robot_model_dir / f"{name}.xml", task, None)
    core = StandUpBatch(model, task, ROBOTS, threads=2)
    robot, alone = core.batch.robot, [Alone(core.batch.robot, start) for start in starts]
    place(model, data := mujoco.MjData(model), robot, *standing(task))
    mujoco.mj_forward(model, data)
    mass = data.subtree_com[robot.trunk] - data.xpos[alone[0].feet].mean(axis=0)
    pose = trunk_heights(model, robot, task)[1], mass[2], data.xmat[alone[0].feet].reshape(-1, 3, 3)[:, 2]
    for index, start in enumerate(starts):
        core.begin(index, start)
    touched = set()
    for action in actions(0.05)[: STEPS if name == "calibrated" else 30]:
        out = core.step(action)
        for i, one in enumerate(alone):
            one.act(action[i], 0.05)
            np.testing.assert_allclose(core.batch.sim.qpos[i], one.data.qpos, rtol=0, atol=1e-9)
            np.testing.assert_allclose(out.terms[:, i], one.rewards(*pose), rtol=0, atol=1e-9)
            assert out.reward[i] == pytest.approx(sum(one.rewards(*pose)), abs=1e-9)
            touched.add(bool(one.contact > 0.0))
    assert touched == {True, False}
    core.close()

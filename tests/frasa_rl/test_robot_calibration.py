"""What a fit of the whole robot found reaches every episode: delays, zeros, trunk, supply; and no episode the next."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl.config import AssumedRanges, Task
from frasa_rl.falls import draw_release, let_go
from frasa_rl.observation import layout
from frasa_rl.standup_env import StandUp
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid import stored_robot_fit
from frasa_sysid.calibration import load_calibration, load_model, read
from frasa_sysid.publish import publish, write

ASSUMED = AssumedRanges()
MEASURED_ZEROS = ("left_knee.zero", "right_knee.zero", "left_hip_yaw.zero")
DELAYS = ("position", "velocity", "gyro", "orientation")


def publish_to(folder, record):
    record.save(folder / "robot.json")
    nominal, out = folder / "nominal.xml", folder / "calibrated.xml"
    write(publish([], nominal, out, stored_robot_fit.load(folder / "robot.json")), nominal, out)
    return out


@pytest.fixture
def calibrated(model_dir, robot_record):
    """A model published from a fit of the whole robot."""
    return publish_to(model_dir, robot_record())


@pytest.fixture
def late(model_dir, robot_record):
    """One whose gyro and orientation may be older than a falling start, by an amount that differs much."""
    record = robot_record()
    wide = [replace(one, value=0.1, low=0.001, high=0.2, spread=None, bootstrap=None)
            if one.name in ("sensor.gyro_delay", "sensor.orientation_delay") else one
            for one in record.estimates]  # fmt: skip
    return publish_to(model_dir, replace(record, estimates=wide))


def seen(env, name):
    """A part of the present observation, by name."""
    sizes = [(part.name, part.size) for part in layout(env.task)]
    first = sum(size for _, size in sizes[: [one for one, _ in sizes].index(name)])
    return env.core.batch.observation[0, first : first + dict(sizes)[name]]


def test_draws_reach_the_ends_of_every_range(calibrated):
    """Every measured number is drawn over its range, ends included, written into the model and told."""
    env, ranges = StandUp(calibrated), load_calibration(calibrated).ranges
    rng = np.random.default_rng(0)
    seen = {name: [] for name in ranges}
    for _ in range(300):
        drawn = env.randomizer.draw(rng)
        for name, values in seen.items():
            values.append(drawn[name])
            assert read(env.model, name) == pytest.approx(drawn[name], rel=1e-12)
    for name, one in ranges.items():
        width = one.high - one.low
        assert one.low <= min(seen[name]) < one.low + 0.03 * width, name
        assert one.high - 0.03 * width < max(seen[name]) <= one.high, name


def test_measured_replaces_assumed_number_by_number(calibrated):
    """Measured zeros, mass and coordinates keep to their ranges, the others are assumed around the model's own."""
    env, original = StandUp(calibrated), load_model(calibrated)
    ranges, trunk = load_calibration(calibrated).ranges, env.robot.trunk
    joints = [original.actuator(i).name for i in range(original.nu)]
    rng = np.random.default_rng(1)
    zeros = {joint: [] for joint in joints}
    side = []
    for _ in range(200):
        drawn = env.randomizer.draw(rng)
        for joint in joints:
            zeros[joint].append(read(env.model, f"{joint}.zero"))
        assert ranges["trunk.mass"].low <= env.model.body_mass[trunk] <= ranges["trunk.mass"].high
        assert drawn["trunk_mass"] == pytest.approx(env.model.body_mass[trunk] / original.body_mass[trunk])
        ratio = env.model.body_inertia[trunk] / original.body_inertia[trunk]
        np.testing.assert_allclose(ratio, drawn["trunk_mass"])
        assert ranges["trunk.com_z"].low <= env.model.body_ipos[trunk, 2] <= ranges["trunk.com_z"].high
        side.append(env.model.body_ipos[trunk, 1] - original.body_ipos[trunk, 1])
        assert ranges["supply_voltage"].low <= drawn["supply_voltage"] <= ranges["supply_voltage"].high
    assert 0.0045 < np.abs(side).max() <= ASSUMED.trunk_com.high
    for joint, values in zeros.items():
        spread = np.ptp(values)
        if f"{joint}.zero" in MEASURED_ZEROS:
            one = ranges[f"{joint}.zero"]
            assert one.low <= min(values) <= max(values) <= one.high
        else:  # also head_pitch, which the logs did not excite
            assert 0.95 * 2 * ASSUMED.joint_zero.high < spread <= 2 * ASSUMED.joint_zero.high


def test_nothing_accumulates_over_300_draws(calibrated):
    """Afterwards the original can be restored to the last bit, and one seed draws the robot of the first episode."""
    env, fresh = StandUp(calibrated), build_model(calibrated, Task())
    mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
    names = [one for one in dir(fresh) if not one.startswith("_") and isinstance(getattr(fresh, one), np.ndarray)]
    first = env.randomizer.draw(np.random.default_rng(5))
    kept = {name: getattr(env.model, name).copy() for name in names}
    rng = np.random.default_rng(0)
    for _ in range(300):
        env.randomizer.draw(rng)
    assert env.randomizer.draw(np.random.default_rng(5)) == first
    for name in names:
        np.testing.assert_array_equal(getattr(env.model, name), kept[name], err_msg=name)
    env.randomizer.restore()
    for name in names:
        np.testing.assert_array_equal(getattr(env.model, name), getattr(fresh, name), err_msg=name)


def test_the_first_observation_is_the_settled_robots(late):
    """At rest, what is measured is what is true, whatever delay is drawn and whatever the last episode did."""
    env, drawn = StandUp(late), []
    rng = np.random.default_rng(0)
    at_rest = 0
    for seed in range(12):
        env.reset(seed=seed, options={"start": "random"})
        drawn.append(env.drawn["sensor.orientation_delay"])
        now = env.core.batch.now
        if np.abs(env.data.qvel).max() < env.task.still_speed:
            at_rest += 1
            assert seen(env, "pitch") == pytest.approx(now.pitch, abs=0.015)
            assert seen(env, "pitch_rate") == pytest.approx(now.turning[:, 1], abs=2 * env.task.still_speed)
            np.testing.assert_allclose(seen(env, "position"), env.robot.mean_of_sides(now.positions)[0], atol=1e-3)
        for _ in range(int(rng.integers(1, 20))):
            env.step(rng.uniform(-1, 1, 5))
    assert at_rest > 5
    assert np.diff(drawn).max() > 0.05  # a delay much longer than the last episode's


def test_a_reset_does_not_depend_on_what_was_before(late):
    """A seeded episode is the same to the last bit in a fresh environment and after wild ones, also from a fall."""
    used = StandUp(late)
    rng = np.random.default_rng(1)
    for kind in ("falling", "prone", "target"):
        fresh = StandUp(late)
        for seed in (100, 101):
            used.reset(seed=seed, options={"start": "random"})
            for _ in range(15):
                used.step(rng.uniform(-1, 1, 5))
        one, other = (env.reset(seed=9, options={"start": kind})[0] for env in (fresh, used))
        np.testing.assert_array_equal(one, other)
        for _ in range(6):
            action = rng.uniform(-1, 1, 5)
            np.testing.assert_array_equal(fresh.step(action)[0], used.step(action)[0])


def test_a_delay_longer_than_the_fall_reads_the_released_robot(late):
    """A falling start is shorter than such a delay: what is measured is the robot as it was released, never zeros."""
    env = StandUp(late)
    longer = 0
    for seed in range(10):
        env.reset(seed=seed, options={"start": "falling"})
        start = env.robot.orientation.start[0]
        reading = env.core.batch.sim.sensors[0, start : start + 4]
        assert np.linalg.norm(reading) == pytest.approx(1.0, abs=1e-3)
        if env.drawn["sensor.orientation_delay"] > env.data.time + 0.002:
            longer += 1
            assert reading[[1, 3]] == pytest.approx([0, 0], abs=1e-12)  # released with a pitch, and nothing else
        if env.drawn["sensor.gyro_delay"] > env.data.time + 0.002:
            assert seen(env, "pitch_rate") == 0.0
    assert longer > 2


def test_released_is_as_if_it_had_always_been_there(late):
    """Right after release all readings are those of the pose, and the servos hold it: no zero, no stale sample."""
    model, task, rng = build_model(late, Task()), Task(), np.random.default_rng(0)
    maker = StartMaker(model, task, load_calibration(late), threads=1)
    robot, data = maker.robot, mujoco.MjData(model)
    for _ in range(5):
        own, drawn = maker.draw_robot(rng)
        mujoco.mj_step(own, data, 20)  # whatever was there before
        let_go(own, data, robot, task, draw_release(robot, task, rng), drawn)
        np.testing.assert_allclose(data.sensor("measured_orientation").data, data.qpos[3:7], atol=1e-15)
        assert not data.sensor("measured_gyro").data.any()
        np.testing.assert_array_equal(data.sensordata[robot.position.start], data.qpos[robot.qpos])
        assert not data.sensordata[robot.velocity.start].any()
        np.testing.assert_allclose(data.actuator_force, 0.0, atol=1e-9)
        mujoco.mj_step(own, data)
        np.testing.assert_allclose(data.actuator_force, 0.0, atol=1e-9)


def test_without_randomization_the_model_is_its_file(calibrated):
    """Zeros, delays and trunk are then the published values, episode after episode."""
    env = StandUp(calibrated, randomize=False)
    for seed in range(2):
        env.reset(seed=seed)
        step = env.model.opt.timestep
        for name, one in load_calibration(calibrated).ranges.items():
            # A simulated model's sensors are younger by the step they wait for (`simulation.fresh`).
            wanted = max(one.value - step, 0.0) if name.startswith("sensor.") else one.value
            assert read(env.model, name) == pytest.approx(wanted, rel=1e-12)

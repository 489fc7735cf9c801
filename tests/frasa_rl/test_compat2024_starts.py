"""How FRASA's published environment begins an episode, and how ours does: each quirk a pair."""

import random
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_rl import compat2024
from frasa_rl.compat2024 import CompatStarts, Draw, compat_task
from frasa_rl.config import Task
from frasa_rl.falls import draw_release
from frasa_rl.pool import Pool
from frasa_rl.simulation import Simulation
from frasa_rl.standup_env import StandUp
from frasa_rl.starts import StartMaker, compat_starts
from frasa_rl.task_model import build_model

OURS, THEIRS = Task(), compat_task(Task())


def maker_of(path, task):
    return StartMaker(build_model(path, task), task, None, threads=1)


@pytest.fixture
def theirs(nominal):
    return maker_of(nominal, THEIRS)


@pytest.fixture
def ours(nominal):
    return maker_of(nominal, OURS)


def rng(seed=0):
    return np.random.default_rng(seed)


def depth(start, model=None):
    """How far some geom is inside the floor or another, at the start [m]."""
    data = mujoco.MjData(start.model)
    data.qpos[:] = start.state[1 : 1 + start.model.nq]
    mujoco.mj_forward(model or start.model, data)
    return -float(data.contact.dist.min(initial=0.0))


def test_b6_joints_jump_and_nothing_is_derived(theirs, ours):
    """Their robot is another one than has settled, with constants of neither; ours is the one that has."""
    random.seed(0)
    (start,) = compat_starts(theirs).make([rng()])
    (mine,) = ours.make([rng()], ["any"])
    original = theirs.original
    trunk, model = theirs.robot.trunk, start.model
    for one in (start, mine):  # D16, of a robot that nobody has measured
        for name in ("body_mass", "body_ipos"):
            changed = np.flatnonzero(getattr(one.model, name) != getattr(original, name))
            assert set(changed // (1 if name == "body_mass" else 3)) == {trunk}
    ratio = start.drawn["trunk_mass"]
    assert abs(ratio - 1.0) > 0.01
    assert model.body_mass[trunk] == pytest.approx(original.body_mass[trunk] * ratio)
    np.testing.assert_array_equal(model.body_inertia, original.body_inertia)
    for name in ("body_subtreemass", "dof_invweight0", "body_invweight0"):
        np.testing.assert_array_equal(getattr(model, name), getattr(original, name))
    ratio = mine.drawn["trunk_mass"]
    np.testing.assert_allclose(mine.model.body_inertia[trunk], original.body_inertia[trunk] * ratio)
    assert mine.model.body_subtreemass[trunk] != original.body_subtreemass[trunk]
    # Zeros of all joints, up to 1.5 deg, that it had not while it settled.
    zeros = (model.qpos0 - original.qpos0)[model.jnt_qposadr[model.actuator_trnid[:, 0]]]
    assert 0.5 < np.degrees(np.abs(zeros)).max() <= 1.5
    assert zeros.size == np.unique(zeros).size == 20
    # Theirs lies in the floor by more than it did as it settled; ours as deep as it lay.
    assert depth(start) > depth(start, original) + 1e-3
    rolls = [model.actuator(f"{side}_shoulder_roll").id for side in ("left", "right")]
    start.ctrl[rolls] = 0.0  # as it settled: the arms shall not be what moves
    for lying, task, moves in ((start, THEIRS, True), (mine, OURS, False)):
        sim = Simulation(lying.model, 1)
        sim.put(0, lying)
        still = np.abs(sim.qvel).max() < task.still_speed
        sim.advance(np.repeat(lying.ctrl[None, None], 25, axis=1))
        assert still
        fastest = np.abs(sim.path[0, :, 1 + sim.nq : 1 + sim.nq + sim.nv]).max()
        assert bool(fastest > 4 * task.still_speed) is moves


def test_b7_the_robot_before(theirs, ours, monkeypatch):
    """Theirs settles as the robot of the episode before, the first as the file's; ours as itself."""
    settled = []
    settle = CompatStarts._settle
    monkeypatch.setattr(CompatStarts, "_settle", lambda self, start: settled.append(start.model) or settle(self, start))
    starts = compat_starts(theirs).make([rng(seed) for seed in range(3)])
    before = [theirs.original, starts[0].model, starts[1].model]
    for used, expected in zip(settled, before, strict=True):
        for name in ("body_mass", "qpos0", "dof_damping", "actuator_gainprm", "geom_friction"):
            np.testing.assert_array_equal(getattr(used, name), getattr(expected, name))
    assert not {id(one) for one in settled} & {id(one.model) for one in starts}
    for start in starts:  # nothing accumulates
        np.testing.assert_array_equal(start.model.sensor_delay, starts[0].model.sensor_delay)
        np.testing.assert_array_equal(start.ages, starts[0].ages)
        assert start.ages.max() == pytest.approx(0.05)
    one, other = (ours.make([rng(1)], ["any"])[0] for _ in range(2))
    np.testing.assert_array_equal(one.state, other.state)


def test_b8_the_seed(nominal):
    """Their pose comes from the process' own generator, whatever the seed; ours from the seed."""
    theirs, ours = StandUp(nominal, THEIRS, randomize=False), StandUp(nominal, OURS, randomize=False)
    random.seed(1)
    first, second = (theirs.reset(seed=5)[0] for _ in range(2))
    assert not np.array_equal(first, second)
    random.seed(1)
    np.testing.assert_array_equal(theirs.reset(seed=6)[0], first)
    np.testing.assert_array_equal(ours.reset(seed=5)[0], ours.reset(seed=5)[0])


def test_what_is_drawn_accumulates_nowhere(theirs):
    """The same seed gives the same robot after others, and every field that a draw writes to is restored."""
    draw = Draw(theirs.model, theirs.robot, THEIRS)
    first = draw(rng(1))
    fields = {name: getattr(theirs.model, name).copy() for name in Draw._FIELDS}
    written = bytes(_content(theirs.model))
    for seed in range(2, 6):
        draw(rng(seed))
    assert draw(rng(1)) == first
    for name, value in fields.items():
        np.testing.assert_array_equal(getattr(theirs.model, name), value)
    assert bytes(_content(theirs.model)) == written
    assert 0.98 <= first["time_ratio"] <= 1.02
    ratio = first["supply_voltage"] / 15.0
    np.testing.assert_allclose(theirs.model.actuator_forcerange, theirs.original.actuator_forcerange * ratio)
    np.testing.assert_allclose(theirs.model.actuator_biasprm, theirs.original.actuator_biasprm * ratio)
    np.testing.assert_allclose(theirs.model.dof_damping, theirs.original.dof_damping * first["damping"])


def _content(model):
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content


def test_knees_at_their_limits(theirs, ours):
    """Half of their knees start straight and a seventh bent as far as it goes; none of ours."""
    random.seed(0)
    compat, bare = compat_starts(theirs), replace(OURS, near_target_share=0.0)
    compat._task = replace(THEIRS, near_target_share=0.0)
    knees = {
        "theirs": np.array([compat._release().joints[3] for _ in range(3000)]),
        "ours": np.array([draw_release(ours.robot, bare, rng(seed)).joints[3] for seed in range(3000)]),
    }
    low, high = ours.robot.limits[3]
    assert low == pytest.approx(0.0, abs=1e-6)
    shares = {name: ((angles <= low).mean(), (angles >= high).mean()) for name, angles in knees.items()}
    assert shares["theirs"][0] == pytest.approx(0.50, abs=0.03)
    assert shares["theirs"][1] == pytest.approx((np.pi - high) / (2 * np.pi), abs=0.02)
    assert shares["theirs"][1] == pytest.approx(0.14, abs=0.03)
    assert shares["ours"] == (0.0, 0.0)


def test_near_the_standing_pose(theirs, ours):
    """A tenth of theirs has legs bent by one offset; of ours every joint has an offset of its own."""
    random.seed(0)
    compat = compat_starts(theirs)
    pose = np.radians([one.target_deg for one in OURS.joints])
    drawn = np.array([compat._release().joints - pose for _ in range(2000)])
    near = drawn[np.abs(drawn).max(axis=1) <= 0.2 + 1e-12]
    assert len(near) / 2000 == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(near, near[:, 3:4] / 2 * [0, 0, -1, 2, -1], atol=1e-12)
    assert 0.08 < near[:, 3].max() / 2 <= 0.1
    mine = np.array([draw_release(ours.robot, OURS, rng(seed), "target").joints - pose for seed in range(200)])
    assert np.linalg.matrix_rank(mine) == 5


def test_release_and_settling(theirs, ours, monkeypatch):
    """They put the trunk's site at 0.4 m with straight arms and wait 2 s; we 1 cm above the floor until it is still."""
    begun = []
    monkeypatch.setattr(compat2024.CompatStarts, "_settle", lambda _, start: begun.append(start) or start)
    compat = compat_starts(theirs)
    starts = compat.make([rng(seed) for seed in range(4)])
    rolls = [theirs.model.actuator(f"{side}_shoulder_roll").id for side in ("left", "right")]
    for start in begun:
        data = mujoco.MjData(start.model)
        mujoco.mj_setState(start.model, data, start.state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_kinematics(start.model, data)
        assert data.site("trunk").xpos[2] == pytest.approx(0.4)
        assert not start.ctrl[rolls].any()
    for start in starts:
        np.testing.assert_allclose(np.degrees(start.ctrl[rolls]), [-5.0, 5.0])
    monkeypatch.undo()
    times = [start.state[0] for start in compat_starts(theirs).make([rng(seed) for seed in range(3)])]
    np.testing.assert_allclose(times, 2.0)
    mine = [start.state[0] for start in ours.make([rng(seed) for seed in range(8)], ["random"] * 8)]
    assert len({round(one, 6) for one in mine}) > 2
    assert min(mine) < 1.5


def test_their_physics(nominal, model_copy):
    """Steps of 2 ms with Euler, whatever the file says."""
    text = model_copy.read_text()
    model_copy.write_text(text.replace('timestep="0.002"', 'timestep="0.001"'))
    assert 'timestep="0.001"' in model_copy.read_text()
    assert build_model(model_copy, THEIRS).opt.timestep == 0.002
    assert build_model(model_copy, OURS).opt.timestep == 0.001


def test_a_pool_of_theirs(theirs, tmp_path):
    """Made one after the other, as each settles under the one before, and never kept: no seed repeats it."""
    random.seed(0)
    pool = Pool(theirs, None, 3, 0, tmp_path)
    assert len(pool) == 3
    assert not list(tmp_path.iterdir())
    assert len({start.state.tobytes() for start in pool.starts}) == 3
    random.seed(0)
    for one, other in zip(pool.starts, Pool(maker_of_same(theirs), None, 3, 0, tmp_path).starts, strict=True):
        np.testing.assert_array_equal(one.state, other.state)


def maker_of_same(maker):
    return StartMaker(maker.original, maker.task, None, threads=1)

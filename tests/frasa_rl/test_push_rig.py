"""The pendulum: its energy, where it hits, that it hits once, and that the robot does not change by it."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from frasa_rl.config import Joint, Names, PushRig, Task
from frasa_rl.controllers import Nothing
from frasa_rl.protocol import Conditions
from frasa_rl.protocol_push import PushRun
from frasa_rl.push_rig import Rig, add_rig
from frasa_rl.robot import find_robot
from frasa_rl.simulation import FULL, state_of
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import ModelError, UsageError

BOX = Path(__file__).with_name("box_robot.xml")
BOX_TASK = Task(
    joints=(Joint("neck", 0.0),),
    target_pitch_deg=0.0,
    held_deg=(),
    names=Names("torso", "ground", "{}", "{}", None, None, None, None, None),
)
RIG = PushRig()


def box_with_rig(rig=RIG):
    model = build_model(BOX, BOX_TASK, add=lambda spec: add_rig(spec, rig, "torso"))
    return model, Rig(model, find_robot(model, BOX_TASK), rig)


@pytest.mark.parametrize("energy", [0.0, -1.0, 11.4, float("nan")])
def test_an_energy_the_pendulum_cannot_give_is_refused(energy):
    """Level with its hinge the pendulum holds m g L = 11.3 J."""
    with pytest.raises(UsageError, match=r"11\.3 J"):
        RIG.release_angle(energy)


@pytest.mark.parametrize("energy", [4.0, 5.5, 7.3])
@pytest.mark.parametrize("randomize", [False, True])
def test_the_bob_arrives_with_its_energy(nominal, energy, randomize):
    """Just before it hits, the bob's kinetic energy is that of the push to 1 %, whatever robot was drawn."""
    run = PushRun(Conditions(nominal, randomize=randomize), [("back", energy)], [0])
    run.release()
    sim, fastest, touched = run.trials.batch.sim, 0.0, False
    while not touched and run.trials.now_s < 1.0:
        run.step(Nothing(Task()))
        fastest = max(fastest, np.abs(sim.path[0, :, run.rig.rate]).max())
        touched = sim.sensor_path[0, :, run.rig.touch].any()
    run.trials.batch.close()
    assert touched
    assert 0.5 * RIG.mass * (RIG.length * fastest) ** 2 == pytest.approx(energy, rel=0.01)


@pytest.mark.parametrize(("direction", "sign"), [("front", 1.0), ("back", -1.0)])
@pytest.mark.parametrize(("x", "y", "yaw"), [(0.0, 0.0, 0.0), (1.3, -0.7, 0.8), (-2.0, 4.0, -2.5)])
def test_the_rig_follows_the_robot(direction, sign, x, y, yaw):
    """Wherever the robot stands and looks, the hanging bob touches it at its height, on the right side."""
    model, rig = box_with_rig()
    robot, data = find_robot(model, BOX_TASK), mujoco.MjData(model)
    data.qpos[robot.root_qpos : robot.root_qpos + 7] = (x, y, 0.46, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    placed = rig.place(model, data, state_of(model, data), direction, 7.3)
    assert abs(placed[rig.angle]) == pytest.approx(RIG.release_angle(7.3))
    mujoco.mj_setState(model, data, placed, FULL)
    mujoco.mj_kinematics(model, data)
    released = data.geom("push_bob").xpos.copy()
    data.joint("push_hinge").qpos = 0.0
    mujoco.mj_kinematics(model, data)
    bob, forward = data.geom("push_bob").xpos, np.array([np.cos(yaw), np.sin(yaw), 0.0])
    gap = mujoco.mj_geomDistance(model, data, model.geom("push_bob").id, model.geom("block").id, 1.0, None)
    assert gap == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(bob, np.array([x, y, 0.46]) + sign * 0.2 * forward, atol=1e-4)
    assert sign * (released - bob) @ forward == pytest.approx(RIG.length * np.sin(RIG.release_angle(7.3)), abs=1e-6)


def test_a_pendulum_too_high_is_an_error():
    """A pendulum that passes above the robot is said, not silently counted as a miss."""
    model, rig = box_with_rig(replace(RIG, height=3.0))
    with pytest.raises(ModelError, match="passes the robot"):
        rig.place(model, mujoco.MjData(model), state_of(model, mujoco.MjData(model)), "front", 4.0)


def test_the_momentum_of_the_bob_goes_into_the_robot():
    """A box hit in its middle moves on with the impulse, which lies between that of clay and that of steel."""
    run = PushRun(Conditions(BOX, BOX_TASK), [("front", 4.0)], [0])
    run.release()
    while run.trials.now_s < 0.8:
        run.step(Nothing(BOX_TASK))
    trial = run.judge()[0]
    speed = np.linalg.norm(run.trials.batch.sim.qvel[0, :2])
    run.trials.batch.close()
    clay = np.sqrt(2 * 4.0 / RIG.mass) / (1 / RIG.mass + 1 / 5.05)
    assert clay < trial.impulse < 1.5 * clay
    assert 5.05 * speed == pytest.approx(trial.impulse, rel=0.05)


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_it_hits_once_and_is_pulled_back(rate):
    """After its hit the bob is drawn back to where it was released and stays; nothing touches the robot again."""
    run = PushRun(Conditions(BOX, BOX_TASK, rate), [("front", 7.3), ("back", 4.0)], [0, 0])
    run.release()
    forces, sim = [], run.trials.batch.sim
    while run.trials.now_s < 3.0:
        run.step(Nothing(BOX_TASK))
        forces.append(np.linalg.norm(sim.sensor_path[:, :, run.rig.touch], axis=2))
    touched = np.concatenate(forces, axis=1) > 0.0
    run.trials.batch.close()
    for one, energy, sign in zip(range(2), (7.3, 4.0), (-1.0, 1.0), strict=True):
        when = np.flatnonzero(touched[one]) * 0.002
        assert 0.55 < when[0] < 0.7
        assert when[-1] - when[0] < 0.1
        assert sim.state[one, run.rig.angle] == pytest.approx(sign * RIG.release_angle(energy), abs=0.05)
        assert abs(sim.state[one, run.rig.rate]) < 0.01


def test_the_robot_is_the_same_with_the_rig(nominal):
    """The rig comes after everything of the robot: same actuators, same addresses, same motion."""
    task = Task()
    bare, rigged = build_model(nominal, task), build_model(nominal, task, add=lambda spec: add_rig(spec, RIG, "trunk"))
    one, other = find_robot(bare, task), find_robot(rigged, task)
    assert bare.nu == rigged.nu
    for name in ("actuators", "qpos", "dofs", "limits", "held", "root_qpos", "root_dof", "self_contact", "trunk"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    ends = []
    for model in (bare, rigged):
        data = mujoco.MjData(model)
        data.qpos[2] = 0.5
        mujoco.mj_step(model, data, 300)
        ends.append(data.qpos[: bare.nq].copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)

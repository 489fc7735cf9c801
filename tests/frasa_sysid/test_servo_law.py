"""The compiled friction law inside MuJoCo: against written-out equations, over threads, on the robot."""

import copy
import ctypes
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from mujoco import rollout

from frasa_sysid.calibration import ModelError, actuators_of, dofs_of, load_model, servo_law, stepping
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.servo import PUBLISHED_M4

Floats = npt.NDArray[np.float64]
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
M4 = PUBLISHED_M4["mx106"].friction
M5 = replace(M4, coulomb=0.03, load_external=0.06, load_external_stribeck=0.12)
M6 = replace(M5, quad_motor=0.02, quad_external=0.04)
LAWS = {
    "m2": Friction(0.05, 0.06, stribeck=0.08, stribeck_speed=0.4, stribeck_exponent=1.1),
    "m3": Friction(0.05, 0.06, load_motor=0.08, load_external=0.08),
    "m4": M4,
    "m5": M5,
    "m6": M6,
}


@pytest.fixture(autouse=True)
def callback() -> Iterator[None]:
    """The law for the length of a test; MuJoCo has one callback for the whole process."""
    with servo_law.active():
        yield


@pytest.fixture(scope="session")
def with_law(
    robot_model_dir: Path, bench_files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """The bench as it is and as MuJoCo steps by default, and the robot, each with places for a law."""
    folder = tmp_path_factory.mktemp("models")
    for source in robot_model_dir.glob("*.xml"):
        (folder / source.name).write_text(source.read_text())
    sources = {"bench_pendulum": bench_files[stepping.TRAPEZOIDAL], "bench_euler": bench_files[stepping.EULER]}
    for name, source in {**sources, "nominal": robot_model_dir / "nominal.xml"}.items():
        names = ["mx64", "mx106"] if name == "nominal" else ["mx106"]
        numbers = "".join(f'<numeric name="{one}_friction" data="0 0.1 0 0 0 0 0 0 0 1 1"/>' for one in names)
        text = re.sub("</mujoco>\\s*$", f"<custom>{numbers}</custom></mujoco>", source.read_text())
        (folder / f"{name}.xml").write_text(text)
    return {name: folder / f"{name}.xml" for name in (*sources, "nominal")}


@pytest.fixture(params=["bench_pendulum", "bench_euler"])
def bench(request: pytest.FixtureRequest, with_law: dict[str, Path]) -> mujoco.MjModel:
    model = load_model(with_law[request.param])
    model.dof_damping[0] = PUBLISHED_M4["mx106"].damping()
    model.actuator_delay[0] = 0.0083
    return model


@pytest.fixture
def robot(with_law: dict[str, Path]) -> mujoco.MjModel:
    model = load_model(with_law["nominal"])
    for servo in ("mx64", "mx106"):
        servo_law.set_law(model, servo, M6 if servo == "mx106" else PUBLISHED_M4[servo].friction)
    return model


def goal(t: Floats) -> Floats:
    """A swing with steps and rests in it [rad]."""
    return np.where(t % 2.0 < 1.4, 1.1 * np.sin(t**2), 0.9)


def in_mujoco(model: mujoco.MjModel, seconds: float) -> Floats:
    data = mujoco.MjData(model)
    steps = round(seconds / model.opt.timestep)
    angles = np.empty(steps)
    for i, one in enumerate(goal(np.arange(steps) * model.opt.timestep)):
        data.ctrl[0] = one
        mujoco.mj_step(model, data)
        angles[i] = data.qpos[0]
    return angles


def in_python(model: mujoco.MjModel, friction: Friction, seconds: float) -> Floats:
    """MuJoCo's equations for one joint, written out: semi-implicit Euler, friction as a clip."""
    h, damping, delay = float(model.opt.timestep), float(model.dof_damping[0]), float(model.actuator_delay[0])
    kp, limit = float(model.actuator_gainprm[0, 0]), float(model.actuator_forcerange[0, 1])
    mass, arm = float(model.body_mass[1]), -float(model.body_ipos[1, 2])
    inertia = mass * arm**2 + float(model.body_inertia[1, 1] + model.dof_armature[0])
    timeconst, stiff = max(float(model.dof_solref[0, 0]), 2 * h), float(model.dof_solimp[0, 1])
    pull = 2.0 / (stiff * timeconst)
    times = np.arange(round(seconds / h)) * h
    # A command of time t is what a delay later is read, linear between the steps; before the first it is zero.
    sent = np.interp(times - delay, np.concatenate([[-h], times]), np.concatenate([[0.0], goal(times)]))
    q = v = 0.0
    angles = np.empty(times.size)
    for i, command in enumerate(sent):
        actuator = min(max(kp * (command - q), -limit), limit)
        gravity = -mass * 9.81 * arm * np.sin(q)
        motor = actuator - (damping - friction.viscous) * v
        bound = friction.bound(np.array(motor), np.array(gravity), np.array(v)) - friction.viscous * abs(v)
        smooth = actuator + gravity - damping * v
        force = min(max(-(smooth + pull * v * inertia), -bound), bound)
        v += h * (smooth + force) / (inertia + (0.0 if stepping.lead(model) else h * damping))
        q += h * v
        angles[i] = q
    return angles


@pytest.mark.parametrize("law", LAWS)
def test_one_joint_moves_as_the_written_out_equations_do(bench: mujoco.MjModel, law: str) -> None:
    servo_law.set_law(bench, "mx106", LAWS[law])
    assert servo_law.law(bench, "mx106") == LAWS[law]
    simulated, expected = in_mujoco(bench, 6.0), in_python(bench, LAWS[law], 6.0)
    assert np.abs(simulated - expected).max() < 1e-10
    servo_law.set_law(bench, "mx106", Friction(0.05, 0.1))
    felt = 4.5e-3 if stepping.lead(bench) else 5e-3  # what the law does is far more than that
    assert np.abs(in_mujoco(bench, 6.0) - expected).max() > felt


@pytest.mark.parametrize("solver", ["PGS", "CG", "NEWTON"])
@pytest.mark.parametrize("islands", [True, False])
def test_every_solver_gets_the_bound(bench: mujoco.MjModel, solver: str, islands: bool) -> None:
    bench.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver}")
    if not islands:
        bench.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    servo_law.set_law(bench, "mx106", M6)
    assert np.abs(in_mujoco(bench, 2.0) - in_python(bench, M6, 2.0)).max() < 1e-6


def commands(model: mujoco.MjModel, seed: int, swing: float, steps: int) -> Floats:
    """Goals around the neutral pose, new ones every 20 ms [rad], shape (steps, nu)."""
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, model.nu)
    t = np.arange(steps)[:, None] // 10 * 10 * model.opt.timestep
    return np.asarray(model.key_ctrl[0] + swing * np.sin(8.0 * t + phases) * np.minimum(t, 1.0))


def path_of(model: mujoco.MjModel, goals: Floats) -> Floats:
    """Positions after each step from the neutral pose [m, rad], shape (steps, nq)."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    path = np.empty((len(goals), model.nq))
    for row, one in zip(path, goals, strict=True):
        data.ctrl[:] = one
        mujoco.mj_step(model, data)
        row[:] = data.qpos
    return path


def coulomb_only(model: mujoco.MjModel) -> None:
    """The law's simplest form, with the very numbers that the model has."""
    for servo in ("mx64", "mx106"):
        dof = dofs_of(model, actuators_of(model, servo))[0]
        servo_law.set_law(model, servo, Friction(0.01, float(model.dof_frictionloss[dof])))


def test_coulomb_friction_through_the_callback_is_mujocos_own_to_the_last_bit(robot: mujoco.MjModel) -> None:
    coulomb_only(robot)
    goals = commands(robot, 0, 0.3, 600)
    law = path_of(robot, goals)
    servo_law.uninstall()
    assert np.array_equal(law, path_of(robot, goals))


def test_a_model_without_a_law_does_not_notice_the_callback(robot_model_dir: Path) -> None:
    plain = load_model(robot_model_dir / "nominal.xml")
    assert not servo_law.has_law(plain)
    assert servo_law.law(plain, "mx106") is None
    goals = commands(plain, 0, 0.3, 300)
    beside = path_of(plain, goals)
    servo_law.uninstall()
    assert np.array_equal(beside, path_of(plain, goals))


def test_threads_copies_and_used_data_give_the_same_rollout(robot: mujoco.MjModel) -> None:
    goals = np.array([commands(robot, seed, 0.05 * seed, 250) for seed in range(8)])
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    start = np.empty(mujoco.mj_stateSize(robot, FULL))
    mujoco.mj_getState(robot, data, start, FULL)

    def states(models: mujoco.MjModel | list[mujoco.MjModel], threads: int, order: list[int]) -> Floats:
        pool = [mujoco.MjData(robot) for _ in range(threads)]
        with rollout.Rollout(nthread=threads) as runner:
            # The second time the data hold what other runs left in them.
            for _ in range(2):
                path, _ = runner.rollout(models, pool, np.tile(start, (8, 1)), goals[order])
        return np.asarray(path)[np.argsort(order)]

    alone = np.array([path_of(robot, one) for one in goals])
    one = states(robot, 1, list(range(8)))
    assert np.array_equal(one[:, :, 1 : 1 + robot.nq], alone)
    assert np.array_equal(one, states(robot, 2, list(range(8))[::-1]))
    assert np.array_equal(one, states([copy.copy(robot) for _ in range(8)], 2, [3, 1, 7, 0, 2, 6, 4, 5]))


def test_copies_of_a_model_may_have_other_coefficients(bench: mujoco.MjModel) -> None:
    servo_law.set_law(bench, "mx106", M4)
    other = copy.copy(bench)
    servo_law.set_law(other, "mx106", M6)
    assert servo_law.law(bench, "mx106") == M4
    start = np.zeros((2, mujoco.mj_stateSize(bench, FULL)))
    mujoco.mj_getState(bench, mujoco.MjData(bench), start[0], FULL)
    start[1] = start[0]
    angles = goal(np.arange(1000) * bench.opt.timestep)
    pool = [mujoco.MjData(bench) for _ in range(2)]
    with rollout.Rollout(nthread=2) as runner:
        path, _ = runner.rollout([bench, other], pool, start, np.tile(angles, (2, 1))[..., None])
    assert np.array_equal(path[0, :, 1], in_mujoco(bench, 2.0))
    assert np.array_equal(path[1, :, 1], in_mujoco(other, 2.0))


@pytest.mark.parametrize("swing", [0.02, 0.8])
def test_friction_on_the_robot_is_what_the_torques_of_the_step_ask_for(robot: mujoco.MjModel, swing: float) -> None:
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    misses, bounds, touching = [], [], []
    for goals in commands(robot, 1, swing, 1500):
        speed = data.qvel.copy()
        data.ctrl[:] = goals
        mujoco.mj_step(robot, data)
        touching.append(data.ncon)
        # The second solve starts from the first, so what follows from its result is close to what it was given.
        rows = slice(data.ne, data.ne + data.nf)
        row_of = dict(zip(data.efc_id[rows], np.arange(data.ne, data.ne + data.nf), strict=True))
        motor = data.qfrc_actuator
        others = data.qfrc_smooth - motor - data.qfrc_damper + data.qfrc_constraint
        for servo in ("mx64", "mx106"):
            law = servo_law.law(robot, servo)
            assert law is not None
            for dof in dofs_of(robot, actuators_of(robot, servo)):
                row, dq = row_of[dof], speed[dof]
                back_emf = (robot.dof_damping[dof] - law.viscous) * dq
                external = others[dof] - data.efc_force[row]
                bound = law.bound(np.array(motor[dof] - back_emf), np.array(external), np.array(dq))
                bounds.append(bound - law.viscous * abs(dq))
                misses.append(abs(bounds[-1] - data.efc_frictionloss[row]))
                assert data.iefc_frictionloss[data.map_efc2iefc[row]] == data.efc_frictionloss[row]
    fell = data.body("trunk").xpos[2] < 0.2
    assert np.isfinite(data.qpos).all()
    assert np.median(touching) > 0
    assert fell == (swing > 0.5)
    assert np.mean(misses) < 0.05 * np.mean(bounds)
    assert np.mean(bounds) > 0.1


def test_an_actuator_outside_the_class_and_a_body_without_friction_are_left_alone() -> None:
    model = mujoco.MjModel.from_xml_string("""<mujoco>
      <worldbody>
        <body><freejoint/><geom size="0.1" pos="0 0 2"/></body>
        <body><joint name="a" frictionloss="0.7" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
        <body><joint name="free" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
        <body><joint name="b" frictionloss="0.7" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
      </worldbody>
      <actuator><motor name="a" joint="a"/><position name="b" joint="b" kp="2"/></actuator>
      <custom><tuple name="s"><element objtype="actuator" objname="b"/></tuple>
        <numeric name="s_friction" data="0 0.3 0 0 0 0 0 0 0 1 1"/></custom>
    </mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    loss = dict(zip(data.efc_id[: data.nf], data.efc_frictionloss[: data.nf], strict=True))
    assert loss == {model.joint("a").dofadr[0]: 0.7, model.joint("b").dofadr[0]: 0.3}


def test_the_law_runs_while_python_is_held(robot: mujoco.MjModel) -> None:
    """A thread that never gives up the interpreter's lock sees the simulation of another thread go on to its end."""
    assert isinstance(mujoco.get_mjcb_control(), ctypes._CFuncPtr)  # else MuJoCo would take the lock to call it
    steps = 5000
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    start = np.empty((1, mujoco.mj_stateSize(robot, FULL)))
    mujoco.mj_getState(robot, data, start[0], FULL)
    results = {
        "state": np.zeros((1, steps, start.size)),
        "sensordata": np.zeros((1, steps, robot.nsensordata)),
    }
    clock = results["state"][0, :, 0]
    with rollout.Rollout(nthread=1) as runner:
        arguments = (robot, [data], start, commands(robot, 2, 0.1, steps)[None])
        worker = threading.Thread(target=runner.rollout, args=arguments, kwargs=results)
        worker.start()
        while clock[5] == 0.0:
            time.sleep(0.001)
        kept = sys.getswitchinterval()
        sys.setswitchinterval(1e4)  # [s] from here on this thread keeps the lock until it waits
        try:
            under_way = clock[-1] == 0.0
            deadline = time.monotonic() + 30.0
            while clock[-1] == 0.0 and time.monotonic() < deadline:
                pass
            finished = clock[-1] != 0.0
        finally:
            sys.setswitchinterval(kept)
            worker.join()
    assert under_way
    assert finished


def test_a_users_own_callback_is_neither_replaced_nor_removed() -> None:
    servo_law.uninstall()
    assert not servo_law.installed()

    def own(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        pass

    mujoco.set_mjcb_control(own)
    try:
        with pytest.raises(ModelError, match="another mjcb_control"):
            servo_law.install()
        servo_law.uninstall()
        assert mujoco.get_mjcb_control() is own
    finally:
        mujoco.set_mjcb_control(None)


def test_a_law_that_cannot_be_evaluated_is_refused(robot_model_dir: Path, with_law: dict[str, Path]) -> None:
    plain = load_model(robot_model_dir / "bench_pendulum.xml")
    with pytest.raises(ModelError, match='add <numeric name="mx106_friction"'):
        servo_law.set_law(plain, "mx106", M4)
    path = with_law["bench_pendulum"]
    model = load_model(path)
    with pytest.raises(ModelError, match="none negative"):
        servo_law.set_law(model, "mx106", replace(M4, stribeck=-0.1))
    model.dof_frictionloss[0] = 0.0
    with pytest.raises(ModelError, match="frictionloss"):
        servo_law.set_law(model, "mx106", M4)
    good = path.read_text()
    for wrong, match in (
        (good.replace('data="0 0.1 0', 'data="0 0.1'), "has 10 numbers"),
        (good.replace("mx106_friction", "mx999_friction"), "no servo class 'mx999'"),
        (good.replace("0 1 1", "0 0 1"), "Stribeck speed"),
    ):
        other = path.with_name("wrong.xml")
        other.write_text(wrong)
        with pytest.raises(ModelError, match=match):
            load_model(other)


def test_loading_a_model_brings_the_law_and_the_compiler_only_where_it_is_needed(
    robot_model_dir: Path, with_law: dict[str, Path]
) -> None:
    code = """
import sys
from pathlib import Path
from frasa_sysid.calibration import load_model, servo_law
load_model(Path(sys.argv[1]))
assert "numba" not in sys.modules and not servo_law.installed()
load_model(Path(sys.argv[2]))
assert servo_law.installed()
"""
    plain = robot_model_dir / "nominal.xml"
    subprocess.run([sys.executable, "-c", code, str(plain), str(with_law["nominal"])], check=True)

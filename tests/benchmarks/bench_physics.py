"""What physics settings change and what they cost, against the model file's own: the table a setting is chosen from.

    python tests/benchmarks/bench_physics.py [MODEL] [FALLS]

Settled poses: the same releases, held for 3 s; a fall can be chaotic, so the first row after the reference is the
reference itself with commands moved by 0.1 mrad: what no setting can be better than. Stand-up: the keyframe routines
from prone and supine. Standing: the neutral pose commanded, after 3 s. Energy: drift of a passive robot (no servos,
no friction, no floor) tumbling for 1 s, as a share of its kinetic energy. Cost: one thread, best of several
interleaved rounds, per 50 ms, on random actions from falls and standing still.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from frasa_rl.batch_env import StandUpBatch
from frasa_rl.config import Physics, Task
from frasa_rl.falls import draw_release, let_go
from frasa_rl.keyframe import KeyframeController
from frasa_rl.keyframe_file import load_keyframes
from frasa_rl.robot import find_robot, pitch_of
from frasa_rl.simulation import Simulation, Start
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model, substeps

KEYFRAMES = Path("robot_model/keyframes.yaml")
SETTINGS = {
    "as the file": Physics(),
    "as the file, moved 0.1 mrad": Physics(),
    "1 ms": Physics(timestep=0.001),
    "noslip 0": Physics(noslip_iterations=0),
    "elliptic": Physics(cone="elliptic"),
    "elliptic, noslip 0": Physics(cone="elliptic", noslip_iterations=0),
    "implicitfast": Physics(integrator="implicitfast"),
    "no self-collision": Physics(self_collision=False),
    "2.5 ms, noslip 0": Physics(timestep=0.0025, noslip_iterations=0),
    "5 ms": Physics(timestep=0.005),
    "5 ms, noslip 0": Physics(timestep=0.005, noslip_iterations=0),
    "5 ms, noslip 0, no islands": Physics(timestep=0.005, noslip_iterations=0, islands=False),
    "5 ms, noslip 0, elliptic": Physics(timestep=0.005, noslip_iterations=0, cone="elliptic"),
    "5 ms, noslip 0, implicitfast": Physics(timestep=0.005, noslip_iterations=0, integrator="implicitfast"),
    "5 ms, noslip 0, no self-collision": Physics(timestep=0.005, noslip_iterations=0, self_collision=False),
    "5 ms, noslip 0, 10 iterations": Physics(timestep=0.005, noslip_iterations=0, iterations=10, tolerance=1e-6),
    "6.25 ms, noslip 0, no islands": Physics(timestep=0.00625, noslip_iterations=0, islands=False),
    "10 ms, noslip 0": Physics(timestep=0.010, noslip_iterations=0),
}


@dataclass
class Found:
    """What one setting gives."""

    poses: np.ndarray
    pitches: np.ndarray
    standing: tuple[float, float]
    drift: float
    stood: float
    earned: float
    diverged: int


def settle(path: Path, task: Task, falls: int, moved: float) -> tuple[np.ndarray, np.ndarray]:
    """Joints (falls, n) and pitch (falls,) after 3 s."""
    model = build_model(path, task)
    robot, data = find_robot(model, task), mujoco.MjData(model)
    starts = []
    for i in range(falls):
        how = draw_release(robot, task, np.random.default_rng([7, i]), "random")
        starts.append(let_go(build_model(path, task), data, robot, task, replace(how, joints=how.joints + moved), {}))
    sim = put_all(starts)
    steps = substeps(model, task.control_period_s)
    for _ in range(60):
        sim.advance(np.repeat(sim.ctrl[:, None], steps, axis=1))
    quaternion = sim.qpos[:, robot.root_qpos + 3 : robot.root_qpos + 7]
    return robot.mean_of_sides(sim.qpos[:, robot.qpos]), pitch_of(quaternion)


def put_all(starts: list[Start]) -> Simulation:
    sim = Simulation(starts[0].model, len(starts))
    for i, start in enumerate(starts):
        sim.put(i, start)
    return sim


def stand(path: Path, task: Task) -> tuple[float, float]:
    """Pitch and knee [deg] of the neutral pose commanded, after 3 s."""
    model = build_model(path, task)
    robot, data = find_robot(model, task), mujoco.MjData(model)
    still = replace(task, near_target_spread=0.0)
    sim = put_all(
        [let_go(model, data, robot, still, draw_release(robot, still, np.random.default_rng(0), "target"), {})]
    )
    for _ in range(60):
        sim.advance(np.repeat(sim.ctrl[:, None], substeps(model, task.control_period_s), axis=1))
    knee = [one.name for one in task.joints].index("knee")
    joints = robot.mean_of_sides(sim.qpos[:, robot.qpos])[0]
    root = robot.root_qpos
    return float(np.degrees(pitch_of(sim.qpos[0, root + 3 : root + 7]))), float(np.degrees(joints[knee]))


def energy_drift(path: Path, task: Task) -> float:
    """Largest change of the energy in 1 s of free tumbling, as a share of the kinetic energy."""
    model = build_model(path, task)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(flags.mjDSBL_ACTUATION) | int(flags.mjDSBL_CONTACT) | int(flags.mjDSBL_FRICTIONLOSS)
    model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(3).normal(0.0, 2.0, model.nv)
    mujoco.mj_forward(model, data)
    kinetic, total = data.energy[1], data.energy.sum()
    drift = 0.0
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        drift = max(drift, abs(data.energy.sum() - total))
    return float(drift / kinetic)


def stand_up(path: Path, task: Task, falls: int) -> tuple[float, float, int]:
    """Share that ends standing, mean return, divergences, of the keyframe routines over 10 s."""
    longer = replace(task, episode_s=10.0)
    model = build_model(path, longer)
    rngs = [np.random.default_rng([9, i]) for i in range(falls)]
    half = falls // 2
    starts = StartMaker(model, longer, None, randomize=False).make(rngs, ["prone"] * half + ["supine"] * (falls - half))
    env = StandUpBatch(model, longer, falls)
    for place, start in enumerate(starts):
        env.begin(place, start, look=False)
    env.batch.look()
    controller = KeyframeController(load_keyframes(KEYFRAMES), longer)
    controller.start(falls, longer.control_period_s)
    earned, stood = np.zeros(falls), np.zeros(falls, dtype=bool)
    for _ in range(200):
        out = env.step(controller.act(env.batch.observation))
        earned += out.reward
        stood |= out.success
    env.close()
    return float(stood.mean()), float(earned.mean()), env.divergences


def cost(path: Path, task: Task, standing: bool) -> float:
    """Seconds a robot's 50 ms on one thread."""
    model = build_model(path, task)
    count, steps = (1, 20) if standing else (16, 10)
    kind = "target" if standing else "random"
    rngs = [np.random.default_rng([5, i]) for i in range(count)]
    starts = StartMaker(model, task, None, randomize=False, threads=1).make(rngs, [kind] * count)
    env = StandUpBatch(model, task, count, 1)
    for place, start in enumerate(starts):
        env.begin(place, start)
    rng, spent = np.random.default_rng(2), 9e9
    for _ in range(4):
        began = time.perf_counter()
        for _ in range(steps):
            env.step(np.zeros((count, 5)) if standing else rng.uniform(-1, 1, (count, 5)))
        spent = min(spent, (time.perf_counter() - began) / steps / count)
    env.close()
    return spent


def main() -> None:
    """Print the table."""
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "robot_model/nominal.xml")
    falls = int(sys.argv[2]) if len(sys.argv) > 2 else 64
    print(f"{path}, {falls} falls")
    print(
        f"{'':36} falls ending   d pitch  d joints  standing: pitch  knee   energy  stand-up        50 ms cost [us]\n"
        f"{'':36} elsewhere [%]     [deg]     [deg]            [deg]  [deg]  drift   [%]   return    falls standing"
    )
    costs: dict[str, list[tuple[float, float]]] = {}
    found: dict[str, Found] = {}
    for name, physics in SETTINGS.items():
        task = replace(Task(), physics=physics)
        poses, pitches = settle(path, task, falls, 1e-4 if "moved" in name else 0.0)
        found[name] = Found(poses, pitches, stand(path, task), energy_drift(path, task), *stand_up(path, task, falls))
    for _ in range(3):
        for name, physics in SETTINGS.items():
            task = replace(Task(), physics=physics)
            costs.setdefault(name, []).append((cost(path, task, False), cost(path, task, True)))
    base = found["as the file"]
    for name, one in found.items():
        d_pitch = np.degrees(np.abs(one.pitches - base.pitches))
        elsewhere = d_pitch > 10.0
        d_joints = np.degrees(np.abs(one.poses - base.poses).max(axis=1))
        rest = ~elsewhere if (~elsewhere).any() else np.ones_like(elsewhere)
        falling, standing = np.min(costs[name], axis=0) * 1e6
        print(
            f"{name:36} {100 * elsewhere.mean():13.0f} {np.median(d_pitch[rest]):9.2f} "
            f"{np.median(d_joints[rest]):9.2f} "
            f"{one.standing[0]:16.2f} {one.standing[1]:6.2f} {one.drift:7.4f} {100 * one.stood:5.0f} {one.earned:8.1f} "
            f"{falling:8.0f} {standing:8.0f}" + (f"  {one.diverged} diverged" if one.diverged else "")
        )


if __name__ == "__main__":
    main()

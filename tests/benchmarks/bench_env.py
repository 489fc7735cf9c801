"""Environment steps per second: the published environment's way, ours single, ours batched, the raw rollout.

    python tests/benchmarks/bench_env.py [MODEL] [STEPS]

All do the same: robots from the same falls, the same random actions, 50 ms a step. The published way is re-made after
our notes on Rhoban/frasa at 78457df: one MuJoCo, a Python loop over physics steps with joint and sensor look-ups by
name, three histories, commands written through fancy indices. The raw rollout repeats what the batch did, from its own
states with its own commands: what no environment on `mujoco.rollout` can beat. Ratios in one run; the machine's other
work changes absolute numbers, so ratios are medians over interleaved rounds.
"""

import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from frasa_rl.batch_env import StandUpBatch
from frasa_rl.config import Task
from frasa_rl.physics import with_physics
from frasa_rl.simulation import Start, all_threads
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import load_calibration, load_model

COUNT, ROUNDS = 64, 8
JOINTS = ("elbow", "shoulder_pitch", "hip_pitch", "knee", "ankle_pitch")


def starts_of(path: Path, task: Task) -> tuple[mujoco.MjModel, list[Start]]:
    """Robots and falls, the same for every way of stepping."""
    model = build_model(path, task)
    rngs = [np.random.default_rng([1, i]) for i in range(COUNT)]
    return model, StartMaker(model, task, load_calibration(path)).make(rngs, ["any"] * COUNT)


class PublishedWay:
    """One robot, stepped as the published environment steps it."""

    def __init__(self, path: Path) -> None:
        self.model = load_model(path)
        self.data = mujoco.MjData(self.model)
        names = [self.model.actuator(i).name for i in range(self.model.nu)]
        self.index = {name: i for i, name in enumerate(names)}
        self.q_history: list[list[float]] = [[0.0] * 5] * 15
        self.tilt_history, self.dtilt_history = [0.0] * 25, [0.0] * 25

    def begin(self, qpos: np.ndarray, ctrl: np.ndarray) -> None:
        """Another fall."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.ctrl[:] = qpos, ctrl

    def step(self, action: np.ndarray) -> float:
        """A control step of 25 physics steps; returns a reward so that all is really computed."""
        data, model = self.data, self.model
        ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, f"left_{name}") for name in JOINTS]
        start = np.array([data.ctrl[i] for i in ids])
        target = np.clip(
            start + np.clip(action * 2.0 * np.pi * 0.05, -0.3142, 0.3142), *model.actuator_ctrlrange[ids].T
        )
        left = [self.index[f"left_{name}"] for name in JOINTS]
        right = [self.index[f"right_{name}"] for name in JOINTS]
        for k in range(25):
            now = start + (target - start) * (k + 1) / 25
            data.ctrl[left] = now
            data.ctrl[right] = now
            mujoco.mj_step(model, data)
            self.q_history.append([float(data.joint(f"left_{name}").qpos[0]) for name in JOINTS])
            rotation = data.site("torso").xmat
            self.tilt_history.append(float(np.arctan2(-rotation[6], rotation[8])))
            self.dtilt_history.append(float(data.sensor("gyro").data[1]))
            self.q_history, self.tilt_history = self.q_history[-15:], self.tilt_history[-25:]
            self.dtilt_history = self.dtilt_history[-25:]
        q = np.array(self.q_history[-1])
        speed = (q - np.array(self.q_history[0])) / 0.03
        seen = np.concatenate([q, speed, data.ctrl[left], [self.tilt_history[0], self.dtilt_history[0]], action])
        touching = 0.0
        for i in range(data.ncon):
            contact = data.contact[i]
            if model.geom_bodyid[contact.geom1] and model.geom_bodyid[contact.geom2]:
                force = np.zeros(6)
                mujoco.mj_contactForce(model, data, i, force)
                touching += float(np.linalg.norm(force[:3]))
        return float(np.exp(-20.0 * np.sum(seen[:5] ** 2)) + 0.1 * np.exp(-touching))


def time_published(path: Path, starts: list[Start], actions: np.ndarray) -> float:
    """Seconds a step."""
    way = PublishedWay(path)
    spent, done = 0.0, 0
    nq = way.model.nq
    for robot in range(COUNT):
        way.begin(starts[robot].state[1 : 1 + nq], starts[robot].ctrl)
        began = time.perf_counter()
        for action in actions[:, robot]:
            way.step(action)
        spent, done = spent + time.perf_counter() - began, done + len(actions)
    return spent / done


def time_batch(
    model: mujoco.MjModel,
    task: Task,
    starts: list[Start],
    actions: np.ndarray,
    threads: int,
    record: list | None = None,
) -> float:
    """Seconds a robot's step; with `record`, keep what was rolled out."""
    env = StandUpBatch(model, task, len(starts), threads)
    for place, start in enumerate(starts):
        env.begin(place, start, look=False)
    env.batch.look()
    sim = env.batch.sim
    advance = sim.advance
    if record is not None:

        def kept(commands: np.ndarray) -> None:
            record.append((list(sim.models), sim.state.copy(), commands.copy()))
            advance(commands)

        sim.advance = kept  # type: ignore[method-assign]
    began = time.perf_counter()
    for action in actions:
        env.step(action[: len(starts)])
    spent = time.perf_counter() - began
    env.close()
    return spent / (len(actions) * len(starts))


def time_raw(record: list, nsensordata: int, threads: int) -> float:
    """Seconds a robot's step of `mujoco.rollout` alone."""
    models, state, commands = record[0]
    data = [mujoco.MjData(models[0]) for _ in range(threads)]
    out = np.zeros((len(models), commands.shape[1], state.shape[1]))
    sensors = np.zeros((len(models), commands.shape[1], nsensordata))
    chunk = max(1, len(models) // (8 * threads))
    with rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
        began = time.perf_counter()
        for models, state, commands in record:
            pool.rollout(models, data, state, commands, nstep=commands.shape[1], skip_checks=True, state=out,
                         sensordata=sensors, chunk_size=chunk)  # fmt: skip
        spent = time.perf_counter() - began
    return spent / (len(record) * len(models))


def main() -> None:
    """Print the table."""
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "robot_model/nominal.xml")
    steps, threads = int(sys.argv[2]) if len(sys.argv) > 2 else 20, all_threads()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, COUNT, 5))
    rows: dict[str, list[float]] = {}
    tasks = {"as the file steps": Task(), "fast physics": with_physics(Task(), "fast")}
    prepared = {name: (task, *starts_of(path, task)) for name, task in tasks.items()}
    first = prepared["as the file steps"][2]
    for _ in range(ROUNDS):
        rows.setdefault("published way, one loop", []).append(time_published(path, first, actions))
        for name, (task, model, starts) in prepared.items():
            rows.setdefault(f"ours, single, {name}", []).append(time_batch(model, task, starts[:1], actions, 1))
            record: list = []
            time_batch(model, task, starts, actions, threads, record)
            rows.setdefault(f"ours, batch of {COUNT}, {name}", []).append(
                time_batch(model, task, starts, actions, threads)
            )
            rows.setdefault(f"raw rollout, {name}", []).append(time_raw(record, model.nsensordata, threads))
    reference = np.array(rows["published way, one loop"])
    print(f"{path}, {threads} threads, {steps} steps of 50 ms, medians of {ROUNDS} interleaved rounds")
    print(f"{'':40} steps/s   us/step   x published   of raw rollout")
    for name, times in rows.items():
        raw = rows.get("raw rollout, " + name.split(", ", 2)[-1])
        share = f"{np.median(np.divide(raw, times)):13.1%}" if raw and name.startswith("ours, batch") else ""
        middle = float(np.median(times))
        print(f"{name:40} {1 / middle:7.0f} {middle * 1e6:9.0f} {np.median(reference / times):12.2f}   {share}")


if __name__ == "__main__":
    main()

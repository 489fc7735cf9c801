"""Many candidates on many bench runs, simulated by MuJoCo itself in its own threads.

Every pair (candidate, run) is a job with a schedule of phases: powered, unpowered, and one
blended step where the torque flag turns inside a step. A phase of all jobs is one call of
`mujoco.rollout`; the state (with the command history that makes the native delay) is handed on.
"""

import copy
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import mujoco
import numpy as np
from mujoco import rollout

from frasa_sysid.calibration import load_model, load_spec, servo_classes, servo_law, sha256_of, stepping
from frasa_sysid.calibration.apply import LEAST_FRICTION
from frasa_sysid.errors import ModelError
from frasa_sysid.kernel import slew_limited
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.servo_values import NO_LIMIT, ServoValues

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_NO_FRICTION = [0.0] * 9 + [1.0, 1.0]  # coefficients in the order of `Friction`
_MEMORY = 96e6  # [bytes] of states in one call; larger batches are split


@dataclass
class _Job:
    run: BenchRun
    values: ServoValues
    schedule: list[tuple[float, int]]  # (share of power, physics steps)
    commands: FloatArray
    angle: FloatArray
    state: FloatArray
    done: int = 0


class BenchSimulator:
    """Simulates bench runs in MuJoCo; use as a context manager, it owns threads.

    Args:
        model_path: `robot_model/bench_pendulum.xml`.
        torque_per_volt_scale: torque per volt [N m/V] for each N m/rad of kp (voltage benches).
        threads: worker threads; by default one per core.
        law: evaluate friction laws beyond M1, by the callback that published models use.
    """

    def __init__(
        self, model_path: Path, torque_per_volt_scale: float, threads: int | None = None, law: bool = False
    ) -> None:
        self._law = law
        self._model = _with_law(model_path) if law else load_model(model_path)
        self._joint = _hinge(self._model, model_path)
        self._dofs = np.zeros(1, np.int64)
        self._body = int(self._model.jnt_bodyid[self._joint])
        self._volt_scale = torque_per_volt_scale
        count = threads or len(os.sched_getaffinity(0))
        self._data = [mujoco.MjData(self._model) for _ in range(count)]
        self._scratch = mujoco.MjData(self._model)
        self._pool: list[mujoco.MjModel] = []
        self._rollout = rollout.Rollout(nthread=count)
        self._states = mujoco.mj_stateSize(self._model, _STATE)

    def __enter__(self) -> "BenchSimulator":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._rollout.close()

    @property
    def timestep(self) -> float:
        """Physics step [s]."""
        return float(self._model.opt.timestep)

    @property
    def fingerprint(self) -> str:
        """Hash of the compiled model: what it is, whatever file it came from."""
        compiled = np.empty(mujoco.mj_sizeModel(self._model), np.uint8)
        mujoco.mj_saveModel(self._model, None, compiled)
        return sha256_of(compiled.tobytes())

    @property
    def delay_range(self) -> tuple[float, float]:
        """Shortest and longest command delay that the model tells apart [s].

        MuJoCo (3.17) reads a delayed command from the history before it adds the present one: any
        delay above zero acts as at least one step, and the history holds no more than its size.
        """
        step = float(self._model.opt.timestep)
        return step, float(self._model.actuator_history[0, 0]) * step

    def simulate(self, runs: Sequence[BenchRun], candidates: Sequence[ServoValues]) -> list[list[FloatArray]]:
        """Encoder readings of every candidate on every run, at the measured times.

        Args:
            runs: n prepared recordings.
            candidates: m sets of values.

        Returns:
            m lists of n arrays [rad], each of the run's own length. A simulation that
            diverged yields NaN from there on.
        """
        jobs = [self._job(run, values) for values in candidates for run in runs]
        for phase in range(max((len(job.schedule) for job in jobs), default=0)):
            for batch in self._batches([job for job in jobs if len(job.schedule) > phase], phase):
                self._advance(batch, phase)
        readings = [_at_measured_times(job) for job in jobs]
        n = len(runs)
        return [readings[i * n : (i + 1) * n] for i in range(len(candidates))]

    def _job(self, run: BenchRun, values: ServoValues) -> _Job:
        angle = np.full(run.steps + 1, np.nan)
        angle[0] = run.q0 - values.offset
        schedule = _schedule(run, values.delay, self.timestep)
        commands = _commands(run, values, self.timestep)[run.lead :]
        return _Job(run, values, schedule, commands, angle, self._initial(run, values))

    def _initial(self, run: BenchRun, values: ServoValues) -> FloatArray:
        """State at the start: measured angle and speed, history full of the first command."""
        data = self._scratch
        mujoco.mj_resetData(self._model, data)
        data.qpos[0] = run.q0 - values.offset
        data.qvel[0] = run.dq0
        size = int(self._model.actuator_history[0, 0])
        times = (np.arange(size) - size) * self.timestep
        commands = _commands(run, values, self.timestep)
        first = np.full(size, commands[0])
        under_way = commands[: run.lead][-size:]
        first[size - under_way.size :] = under_way
        mujoco.mj_initCtrlHistory(self._model, data, 0, times, first)
        state = np.empty(self._states)
        mujoco.mj_getState(self._model, data, state, _STATE)
        return state

    def _batches(self, jobs: list[_Job], phase: int) -> Iterator[list[_Job]]:
        """Jobs of similar length together (short ones are padded), within the memory limit."""
        waiting = sorted(jobs, key=lambda job: -job.schedule[phase][1])
        while waiting:
            longest = max(waiting[0].schedule[phase][1], 1)
            room = max(1, int(_MEMORY / (8 * self._states * longest)))
            alike = sum(job.schedule[phase][1] >= 0.8 * longest - 1 for job in waiting)
            count = min(room, alike)
            yield waiting[:count]
            waiting = waiting[count:]

    def _advance(self, jobs: list[_Job], phase: int) -> None:
        steps = max(job.schedule[phase][1] for job in jobs)
        commands = np.empty((len(jobs), steps, 1))
        for row, job in zip(commands, jobs, strict=True):
            ahead = job.commands[job.done : job.done + steps]
            row[: ahead.size, 0] = ahead
            row[ahead.size :, 0] = job.commands[-1]
        models = self._models(len(jobs))
        for model, job in zip(models, jobs, strict=True):
            self._configure(model, job.run, job.values, job.schedule[phase][0])
        start = np.array([job.state for job in jobs])
        states, _ = self._rollout.rollout(models, self._data, start, commands)
        for job, path in zip(jobs, states, strict=True):
            count = job.schedule[phase][1]
            # Column 0 is time, column 1 the joint angle. MuJoCo resets a simulation that blew up, clock and all.
            expected = (job.done + 1 + np.arange(count)) * self.timestep
            sound = np.abs(path[:count, 0] - expected) < 0.5 * self.timestep
            job.angle[job.done + 1 : job.done + 1 + count] = np.where(sound, path[:count, 1], np.nan)
            job.state = path[count - 1].copy()
            job.done += count

    def _models(self, count: int) -> list[mujoco.MjModel]:
        while len(self._pool) < count:
            self._pool.append(copy.copy(self._model))
        return self._pool[:count]

    def _configure(self, model: mujoco.MjModel, run: BenchRun, values: ServoValues, power: float) -> None:
        """Write the load and a candidate into a model; `power` is 1 powered, 0 off, between: blended."""
        self._set_load(model, run)
        gain = power * drive_gain(values.kp, run, self._volt_scale)
        model.actuator_gainprm[0, 0] = gain
        model.actuator_biasprm[0, 1] = 0.0 if run.absolute else -gain
        # A step that is powered for a part of it gets that part of the torque, saturated or not.
        limit = 1e6 if run.absolute else max(power, 1e-9) * values.forcerange * run.force_scale
        model.actuator_forcerange[0] = (-limit, limit)
        model.actuator_delay[0] = values.delay
        stepping.set_damping(model, self._dofs, power * values.damping + (1.0 - power) * values.damping_off)
        model.dof_frictionloss[0] = max(values.frictionloss, LEAST_FRICTION) if self._law else values.frictionloss
        if self._law:
            servo_law.set_law(model, servo_classes(model)[0], values.friction())
        stepping.set_armature(model, self._dofs, values.armature)
        mujoco.mj_setConst(model, self._scratch)

    def _set_load(self, model: mujoco.MjModel, run: BenchRun) -> None:
        """Split inertia and gravity torque into a body: mass at a distance, the rest about its centre."""
        gravity = float(-model.opt.gravity[2])
        distance = 0.9 * run.inertia * gravity / run.gravity_torque if run.gravity_torque > 0.0 else 0.0
        mass = run.gravity_torque / (gravity * distance) if distance else 1e-3
        model.body_mass[self._body] = mass
        model.body_ipos[self._body] = (0.0, 0.0, -distance)
        model.body_inertia[self._body] = run.inertia - mass * distance**2


def _with_law(model_path: Path) -> mujoco.MjModel:
    """The bench model with room for the coefficients of its servo's friction law."""
    plain = load_model(model_path)
    spec = load_spec(model_path)
    spec.add_numeric(name=servo_classes(plain)[0] + servo_law.SUFFIX, size=servo_law.NUMBERS, data=_NO_FRICTION)
    model = spec.compile()
    servo_law.install()
    return model


def drive_gain(kp: float, run: BenchRun, volt_scale: float) -> float:
    """Torque for each unit of command: N m/rad of a goal, N m/V of a voltage, one of a force."""
    return {"position": kp * run.kp_scale, "voltage": kp * volt_scale, "force": 1.0}[run.control]


def _commands(run: BenchRun, values: ServoValues, timestep: float) -> FloatArray:
    """Commands as the joint angle counts, profile speed applied, shape (lead + steps,)."""
    commands = run.command
    if values.goal_speed < 0.1 * NO_LIMIT:
        commands = slew_limited(commands, values.goal_speed * timestep)
    return commands - (0.0 if run.absolute else values.offset)


def _hinge(model: mujoco.MjModel, path: Path) -> int:
    if (model.nq, model.nv, model.nu) != (1, 1, 1) or not model.actuator_history[0, 0]:
        raise ModelError(
            f"{path}: expected one hinge with one delayed position actuator, found nq={model.nq}, nu={model.nu}"
        )
    return int(model.actuator_trnid[0, 0])


def _schedule(run: BenchRun, delay: float, timestep: float) -> list[tuple[float, int]]:
    """Phases of a run: (share of power, steps); a turn inside a step becomes one blended step."""
    phases: list[tuple[float, int]] = []
    power, done = float(run.powered_first), 0
    for turn in run.switches:
        # The torque flag travels the same way as the goals, so it is late by the same delay.
        whole, part = divmod((turn + delay) / timestep, 1.0)
        stop = min(int(whole), run.steps)
        if stop > done:
            phases.append((power, stop - done))
            done = stop
        following = 1.0 - power
        if done < run.steps and part > 1e-9 and stop >= done:
            phases.append((part * power + (1.0 - part) * following, 1))
            done += 1
        power = following
    if run.steps > done:
        phases.append((power, run.steps - done))
    return phases


def _at_measured_times(job: _Job) -> FloatArray:
    """Simulated readings at the run's own times [rad], shape (T,)."""
    index = job.run.step.astype(np.intp)
    low, high = job.angle[index], job.angle[np.minimum(index + 1, job.run.steps)]
    reading = low + job.run.weight * (high - low) + job.values.offset
    # Far beyond the encoder's world it is no answer.
    return np.where(np.abs(reading) < 1e3, reading, np.nan)

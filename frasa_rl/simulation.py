"""Many robots at once through `mujoco.rollout`: arrays in, arrays out, no Python between two physics steps."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import rollout

from frasa_rl.robot import Floats
from frasa_rl.snapshots import Arrays, put_back, taken
from frasa_sysid.calibration import UsageError

FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)  # begins with time, qpos, qvel
_KEPT = ("state", "sensors", "older", "ctrl", "diverged", "resting")


@dataclass(frozen=True)
class Start:
    """A robot about to begin: its own model and where it is.

    Attributes:
        model: not written to by anyone.
        state: MuJoCo's full physics state, delay histories included, shape (ns,).
        ctrl: what every actuator is commanded [rad], shape (nu,).
        sensors: `sensordata`, one physics step old as after a step, shape (nsensordata,).
        ages: delay of every sensor [s], shape (nsensor,); the model's own are shorter by a step (see `fresh`).
        drawn: what was randomized, by name.
        older: `sensordata` of the physics step before; None for a robot that has always been where it is.
        kind: how it was released, a `falls.Kind` that is not `any`; empty where nobody says.
    """

    model: mujoco.MjModel
    state: Floats
    ctrl: Floats
    sensors: Floats
    ages: Floats
    drawn: dict[str, float]
    older: Floats | None = None
    kind: str = ""


def fresh(model: mujoco.MjModel) -> Floats:
    """Shorten every sensor's delay by one physics step, in place, and return the delays there were, shape (nsensor,).

    A step computes sensors before it moves, so at its end they are one step old. With the delay
    shorter by that step the reading is exactly as old as the delay says, at no cost. MuJoCo looks up
    no delay between 0 and a step, so `young` readings are made up from undelayed ones (`readings`).
    """
    step = model.opt.timestep
    ages: Floats = np.where(model.sensor_history[:, 0] > 0, model.sensor_delay, 0.0)
    model.sensor_delay[:] = np.where(young(ages, step), 0.0, ages - step)
    return ages


def young(ages: Floats, timestep: float) -> npt.NDArray[np.bool_]:
    """Which delays [s] are below two physics steps; the sensors of a `fresh` model have none for them."""
    return np.asarray(ages < 2.0 * timestep * (1.0 - 1e-9))


def all_threads() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Simulation:
    """Robots side by side, each with a model of its own.

    Attributes:
        models: one for each robot, all of the same sizes.
        state: present full physics states, shape (count, ns).
        sensors: present sensor data, shape (count, nsensordata).
        older: sensor data of the physics step before, shape (count, nsensordata).
        ctrl: present commands [rad], shape (count, nu).
        path: states after every physics step of the last `advance`, shape (count, steps, ns).
        sensor_path: sensor data of these steps, each taken as its step began, shape (count, steps, nsensordata).
        diverged: whose simulation blew up in the last `advance`, shape (count,).
        resting: who is left out of every `advance` until it is `put` anew; may be written to, shape (count,).

    Args:
        model: what all robots are until they are `put`.
        count: of robots.
        threads: to step them with; None for one a core.

    Raises:
        UsageError: no robots or no threads.
    """

    def __init__(self, model: mujoco.MjModel, count: int, threads: int | None = None) -> None:
        if count < 1 or (threads is not None and threads < 1):
            raise UsageError(f"{count} robots on {threads} threads: expected at least 1 of both")
        self.count, self.nq, self.nv = count, int(model.nq), int(model.nv)
        self.timestep = float(model.opt.timestep)
        self.models = [model] * count
        self.state = np.zeros((count, mujoco.mj_stateSize(model, FULL)))
        self.sensors = np.zeros((count, model.nsensordata))
        self.older = np.zeros_like(self.sensors)
        self.ctrl = np.zeros((count, model.nu))
        self.diverged = np.zeros(count, dtype=bool)
        self.resting = np.zeros(count, dtype=bool)
        self.path = np.zeros((count, 0, self.state.shape[1]))
        self.sensor_path = np.zeros((count, 0, model.nsensordata))
        workers = min(threads or all_threads(), count)
        self._data = [mujoco.MjData(model) for _ in range(workers)]
        self._pool = rollout.Rollout(nthread=workers if workers > 1 else 0)

    @property
    def qpos(self) -> Floats:
        """Present positions, shape (count, nq)."""
        return self.state[:, 1 : 1 + self.nq]

    @property
    def qvel(self) -> Floats:
        """Present velocities, shape (count, nv)."""
        return self.state[:, 1 + self.nq : 1 + self.nq + self.nv]

    def put(self, index: int, start: Start) -> None:
        """Make one robot another."""
        self.models[index] = start.model
        self.state[index], self.sensors[index], self.ctrl[index] = start.state, start.sensors, start.ctrl
        self.older[index] = start.sensors if start.older is None else start.older
        self.diverged[index] = self.resting[index] = False

    def snapshot(self) -> Arrays:
        """Where all robots are, for a checkpoint; which models they have is not part of it."""
        return taken(self, _KEPT)

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round, after every robot was `put` with its model."""
        put_back(self, _KEPT, kept)

    def advance(self, commands: Floats) -> None:
        """Step all robots.

        Args:
            commands: of every actuator for every physics step [rad], shape (count, steps, nu).
        """
        steps = commands.shape[1]
        if self.path.shape[1] != steps:
            self.path = np.zeros((self.count, steps, self.state.shape[1]))
            self.sensor_path = np.zeros((self.count, steps, self.sensors.shape[1]))
        time = self.state[:, 0].copy()
        if self.resting.any():
            self._advance_some(np.flatnonzero(~self.resting), commands)
        else:
            self._roll(self.models, self.state, np.ascontiguousarray(commands), self.path, self.sensor_path)
        self.state[:] = self.path[:, -1]
        self.older[:] = self.sensor_path[:, -2] if steps > 1 else self.sensors
        self.sensors[:] = self.sensor_path[:, -1]
        self.ctrl[:] = commands[:, -1]
        # MuJoCo stops a rollout at its first warning and repeats what it had: the clock tells.
        late = np.abs(self.state[:, 0] - time - steps * self.timestep) > 0.5 * self.timestep
        moving = self.state[:, 1 : 1 + self.nq + self.nv]
        self.diverged = (late & ~self.resting) | ~np.isfinite(moving).all(axis=1)

    def _advance_some(self, awake: npt.NDArray[np.intp], commands: Floats) -> None:
        """Paths of those who do not rest; the others' repeat their present, shape (awake,)."""
        self.path[:], self.sensor_path[:] = self.state[:, None], self.sensors[:, None]
        if awake.size:
            path, sensor_path = self.path[awake], self.sensor_path[awake]
            self._roll([self.models[one] for one in awake], self.state[awake], commands[awake], path, sensor_path)
            self.path[awake], self.sensor_path[awake] = path, sensor_path

    def _roll(
        self, models: list[mujoco.MjModel], state: Floats, commands: Floats, path: Floats, sensor_path: Floats
    ) -> None:
        """Step robots; path and sensor_path are written to."""
        self._pool.rollout(
            models,
            self._data,
            state,
            commands,
            nstep=commands.shape[1],
            skip_checks=True,
            state=path,
            sensordata=sensor_path,
            # A robot that lies takes half the time of one that stands: small chunks keep all threads busy.
            chunk_size=max(1, len(models) // (8 * len(self._data))),
        )

    def close(self) -> None:
        """End the threads."""
        self._pool.close()


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """The full physics state of one robot, shape (ns,)."""
    state = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, state, FULL)
    return state


def set_state(model: mujoco.MjModel, data: mujoco.MjData, state: Floats) -> None:
    """The other way round; then `mj_forward`."""
    mujoco.mj_setState(model, data, state, FULL)
    mujoco.mj_forward(model, data)

"""FRASA's published environment as it behaves (Rhoban/frasa at 78457df), for comparison with ours.

What it does otherwise, by the numbers of our notes on it, each held by a test:

D1  joints are read on the left side only
D2  joint velocity is the difference of 15 samples, which span 28 ms, divided by 30 ms
D3  pitch and its rate are exactly one control period old, joints and commands not at all
D4  the "random time ratio" only cuts saturated actions by up to 2 %
B5  the observation holds the action before the one just applied
B6  robots are randomized after they have settled: joints jump, and nothing derived from masses follows; mass changes
    without inertia
B7  robots settle under the randomized model of the episode before
B8  the starting pose ignores the seed
    joints start at U(-pi, pi) clipped to the command limits, or near the standing pose by one offset that bends both
    legs; the trunk's site 0.4 m above the floor, 2 s to settle with straight arms, whose roll follows in the episode
    an episode has 101 steps
D16 only the trunk's mass and centre of mass are randomized (ours too, beside what is measured)

Not reproduced, as they change no number: ignored options and warnings (B9, B10), a crash on current numpy (B11),
dead configuration (D13 to B15), names in the code (B18, D19). B12 was mended there before that commit. Not reproduced
either: reward and ends there take the trunk's pitch and rate of one physics step (2 ms) before, and poses come from a
file of them made earlier, where we settle each when it is asked for.
"""

import copy
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any

import mujoco
import numpy as np
from numpy.random import Generator

from frasa_rl.config import Physics, Task
from frasa_rl.falls import Release, let_go
from frasa_rl.poses import standing
from frasa_rl.readings import Readings, Truth
from frasa_rl.robot import Floats, Robot
from frasa_rl.simulation import Simulation, Start, fresh
from frasa_rl.snapshots import Arrays, put_back, taken
from frasa_sysid.calibration import UsageError, number

VELOCITY_WINDOW_S = 0.030
TIME_RATIO = (0.98, 1.02)
NEAR_SHARE = 0.10
SETTLE_S, HEIGHT, SITE = 2.0, 0.4, "trunk"
SQUAT = {"hip_pitch": -1.0, "knee": 2.0, "ankle_pitch": -1.0}  # one offset bends the whole leg of a start near the pose
_REMEMBERED = ("pitch", "rate", "velocity", "last", "shown", "new")
EXTRA_STEPS = 1  # an episode ends after its time has passed, not when it is reached


def compat_task(task: Task) -> Task:
    """The task as the published environment has it: its physics, its steps, its errors."""
    physics = Physics(timestep=0.002, integrator="euler")
    reward = replace(task.reward, gathering=0.0, approach=0.0)
    return replace(
        task,
        compat="frasa2024",
        physics=physics,
        near_target_share=NEAR_SHARE,
        near_target_push=0.0,
        falling_share=0.0,
        end_gyro=Task().end_gyro,
        reward=reward,
    )


@dataclass
class Memory:
    """What the published environment remembers of each robot between two control steps.

    Args:
        count: of robots.
        joints: moved on each side.
    """

    count: int
    joints: int
    pitch: Floats = field(init=False)
    rate: Floats = field(init=False)
    velocity: Floats = field(init=False)
    last: Floats = field(init=False)
    shown: Floats = field(init=False)
    new: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.pitch, self.rate = np.zeros(self.count), np.zeros(self.count)
        self.velocity = np.zeros((self.count, self.joints, 2))
        self.last, self.shown = np.zeros((self.count, self.joints)), np.zeros((self.count, self.joints))
        self.new = np.ones(self.count, dtype=bool)

    def forget(self, index: int) -> None:
        """Another robot: its histories are filled with what is, its turning rate with zeros."""
        self.rate[index] = self.velocity[index] = self.last[index] = self.shown[index] = 0.0
        self.new[index] = True

    def snapshot(self) -> Arrays:
        """All of it, for a checkpoint."""
        return taken(self, _REMEMBERED)

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""
        put_back(self, _REMEMBERED, kept)

    def keep(self, sim: Simulation, robot: Robot, before: Truth, actions: Floats) -> None:
        """Remember a control step: the truth before it, the path through it, the actions applied in it."""
        window = round(VELOCITY_WINDOW_S / sim.timestep)
        positions = sim.path[:, :, 1 + robot.qpos]
        self.velocity = (positions[:, -1] - positions[:, -window]) / (window * sim.timestep)
        self.pitch, self.rate = before.pitch, before.turning[:, 1].copy()
        self.shown, self.last = self.last, actions.copy()
        self.new[:] = False

    def read(self, now: Truth) -> tuple[Readings, Floats]:
        """What it shows now, and which action it takes for the previous one."""
        pitch = np.where(self.new, now.pitch, self.pitch)
        return Readings(now.positions, self.velocity, pitch, self.rate), self.shown


class CompatStarts:
    """Starts as the published environment makes them, one after the other.

    Args:
        model: of the task; written to.
        robot: where things are in it.
        task: how robots are released.
        draw: writes a random robot into the model and returns what was drawn.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, task: Task, draw: "Draw | None") -> None:
        self._model, self._task, self._draw = model, task, draw
        self._robot = replace(robot, held=np.zeros_like(robot.held))  # the arms' roll too while it settles
        self._held = robot.held
        self._before = copy.copy(model)  # B7: what the next robot settles under
        self._data = mujoco.MjData(model)

    def make(self, rngs: Sequence[Generator]) -> list[Start]:
        """One start for each generator, in their order."""
        return [self._one(rng) for rng in rngs]

    def _one(self, rng: Generator) -> Start:
        start = let_go(self._before, self._data, self._robot, self._task, self._release(), {})
        site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, SITE)
        height = self._data.site_xpos[site, 2] if site >= 0 else self._data.xpos[self._robot.trunk, 2]
        start.state[1 + self._robot.root_qpos + 2] += HEIGHT - height
        settled = self._settle(start)
        drawn = self._draw(rng) if self._draw is not None else {}
        self._before = copy.copy(self._model)  # B6: no forward, no derived constants
        after = copy.copy(self._model)  # the robot's own: nobody writes to it
        moved = np.zeros(after.nu, dtype=bool)
        moved[self._robot.actuators] = True
        return replace(
            settled, model=after, ages=fresh(after), drawn=drawn, ctrl=np.where(moved, settled.ctrl, self._held)
        )

    def _release(self) -> Release:
        robot, task, half = self._robot, self._task, np.radians(self._task.start_pitch_deg)
        if random.random() < task.near_target_share:  # B8: the process' own generator
            (pose, pitch), deeper = standing(task), random.uniform(-1.0, 1.0) * task.near_target_spread
            offsets = [deeper * SQUAT.get(one.name, 0.0) for one in task.joints]
            return Release(np.clip(pose + offsets, *robot.limits.T), pitch, SETTLE_S, "target")
        joints = np.clip([random.uniform(-pi, pi) for _ in task.joints], *robot.limits.T)
        return Release(joints, random.uniform(-half, half), SETTLE_S)

    def _settle(self, start: Start) -> Start:
        sim = Simulation(start.model, 1)
        try:
            sim.put(0, start)
            sim.advance(np.repeat(sim.ctrl[:, None], round(SETTLE_S / sim.timestep), axis=1))
            return replace(start, state=sim.state[0].copy(), sensors=sim.sensors[0].copy(), older=sim.older[0].copy())
        finally:
            sim.close()


class Draw:
    """Writes a random robot into a model as the published environment does, deriving nothing (B6).

    Args:
        model: changed in place by a call; as it is now, it is the original.
        robot: where things are in it.
        task: holds the ranges.
    """

    _RANGES = ("floor_friction", "trunk_mass", "trunk_com", "supply_voltage", "joint_zero", "damping", "frictionloss")
    _FIELDS = ("geom_friction", "geom_priority", "body_mass", "body_ipos", "actuator_gainprm", "actuator_biasprm",
               "actuator_forcerange", "dof_damping", "dof_frictionloss", "qpos0")  # fmt: skip

    def __init__(self, model: mujoco.MjModel, robot: Robot, task: Task) -> None:
        self._model, self._robot = model, robot
        self._ranges = {name: one for name in self._RANGES if (one := getattr(task.assumed, name)) is not None}
        if set(self._ranges) != set(self._RANGES):
            raise UsageError(f"compat frasa2024 needs all of assumed.{', '.join(self._RANGES)}")
        self._originals = {name: getattr(model, name).copy() for name in self._FIELDS}
        self._voltage = number(model, "servo_supply_voltage")

    def __call__(self, rng: Generator) -> dict[str, float]:
        """Draw one, and return what was drawn."""
        model, ranges = self._model, self._ranges
        com, zero = ranges["trunk_com"], ranges["joint_zero"]
        for name, value in self._originals.items():
            getattr(model, name)[:] = value
        drawn = {
            name: float(rng.uniform(one.low, one.high))
            for name, one in ranges.items()
            if name not in ("trunk_com", "joint_zero")
        }
        model.geom_friction[self._robot.floor, 0] = drawn["floor_friction"]
        model.geom_priority[self._robot.floor] = 1
        model.body_mass[self._robot.trunk] *= drawn["trunk_mass"]  # without inertia
        model.body_ipos[self._robot.trunk] += rng.uniform(com.low, com.high, 3)
        ratio = drawn["supply_voltage"] / self._voltage
        model.actuator_gainprm[:, 0] *= ratio
        model.actuator_biasprm[:, 1] *= ratio
        model.actuator_forcerange *= ratio
        model.dof_damping *= drawn["damping"]
        model.dof_frictionloss *= drawn["frictionloss"]
        hinges = model.jnt_qposadr[np.unique(model.actuator_trnid[:, 0])]
        model.qpos0[hinges] += rng.uniform(zero.low, zero.high, hinges.size)
        drawn["time_ratio"] = float(rng.uniform(*TIME_RATIO))  # D4
        return drawn

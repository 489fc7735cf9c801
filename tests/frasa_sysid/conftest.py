"""A pendulum bench that shares no code with frasa: 0.1 ms steps, M1 friction as a clip, and all the faults of a log."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.stepping import EULER, TRAPEZOIDAL
from frasa_sysid.excitation_hung import design, first_sizes
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.problem import FitProblem, state_problem, stated_servo
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.rig import BenchRun, runs_of
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_truth import draw
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.servo import Servo
from frasa_sysid.simulate_robot import simulate_robot

Floats = npt.NDArray[np.float64]
COUNT = 2 * np.pi / 4096
STEP = 1e-4
SUPPLY, GAIN = 15.0, 12.0  # where kp and force limit are stated

TRUTH = {
    "kp": 25.0,
    "forcerange": 6.5,
    "damping": 1.35,
    "damping_off": 0.12,
    "frictionloss": 0.16,
    "armature": 0.031,
    "delay": 0.0073,
    "offset": 0.011,
}


def chirp(t: Floats) -> Floats:
    return np.sin(t**2)


def steps(t: Floats) -> Floats:
    return np.where(t % 1.4 < 0.7, 0.0, 1.3)


def drop(t: Floats) -> Floats:
    return -1.4 * np.clip(t / 1.2, 0, 1)


def small(t: Floats) -> Floats:
    return 0.05 * np.sin(4 * t)


@dataclass(frozen=True)
class Plan:
    """One run of the independent bench."""

    goal: Callable[[Floats], Floats] = chirp
    mass: float = 0.5
    length: float = 0.15
    gain: float = 16.0
    supply: float = 14.0
    off_at: float = np.inf
    duration: float = 3.2
    seed: int = 0
    truth: dict[str, float] = field(default_factory=lambda: dict(TRUTH))


def measured(plan: Plan, name: str = "run", noise: bool = True) -> Recording:
    """What a servo of known parameters would log; `noise` adds encoder, jitter of the loop and of its stamps."""
    rng = np.random.default_rng(plan.seed)
    truth, n = plan.truth, int(plan.duration * 100)
    sampled = np.arange(n) * 0.01 + (rng.uniform(0, 0.0015, n) if noise else 0.0)
    sampled[0] = 0.0
    at = np.round(sampled / STEP).astype(int)
    sampled = at * STEP
    goals = plan.goal(sampled)
    grid = np.arange(at[-1] + 1) * STEP
    seen = np.maximum(np.searchsorted(sampled + truth["delay"], grid + 1e-9, side="right") - 1, 0)
    held = goals[seen].tolist()
    powered = (sampled < plan.off_at)[seen].tolist()
    kp = truth["kp"] * plan.gain / GAIN * plan.supply / SUPPLY
    limit = truth["forcerange"] * plan.supply / SUPPLY
    inertia = plan.mass * plan.length**2 + truth["armature"]
    weight = plan.mass * 9.81 * plan.length
    q, dq, angle = 0.0, 0.0, []
    for goal, on in zip(held, powered, strict=True):
        angle.append(q)
        torque = -weight * np.sin(q)
        if on:
            torque += min(max(kp * (goal - q - truth["offset"]), -limit), limit) - truth["damping"] * dq
        else:
            torque -= truth["damping_off"] * dq
        stop = -(inertia * dq / STEP + torque)
        dq += STEP * (torque + min(max(stop, -truth["frictionloss"]), truth["frictionloss"])) / inertia
        q += STEP * dq
    reading = np.array(angle)[at] + truth["offset"]
    stamps = sampled.copy()
    if noise:
        reading = np.round(reading / COUNT) * COUNT
        stamps[1:] += rng.normal(0, 0.0001, n - 1)
    columns = {
        "position": ("rad", reading),
        "goal": ("rad", goals),
        "torque_enable": ("1", (sampled < plan.off_at).astype(float)),
        "supply_voltage": ("V", np.full(n, plan.supply)),
    }
    rig = RigFacts(
        servo="mx106", mass=plan.mass, length=plan.length, firmware_gain=plan.gain, trajectory=plan.goal.__name__
    )
    signals = {key: Signal(key, unit, stamps, y) for key, (unit, y) in columns.items()}
    return Recording(name, signals, rig, "simulated", f"{name}.mcap", "0" * 64, "header")


PLANS = [
    Plan(goal=goal, mass=mass, length=length, gain=gain, off_at=1.6 if goal is drop else np.inf, seed=i)
    for i, (goal, mass, length, gain) in enumerate(
        [
            (chirp, 0.5, 0.15, 8.0),
            (chirp, 0.5, 0.15, 32.0),
            (chirp, 1.2, 0.15, 16.0),
            (steps, 0.5, 0.15, 32.0),
            (steps, 1.2, 0.15, 8.0),
            (drop, 0.5, 0.15, 16.0),
            (drop, 1.2, 0.15, 32.0),
        ]
    )
]


@dataclass(frozen=True)
class BenchKit:
    """The nominal servo, its bench (compiled, and as MuJoCo steps it), and the way from plans to runs and problems."""

    servo: Servo
    nominal: dict[str, float]
    session: BenchSession
    simulator: BenchSimulator
    Plan: type = Plan
    truth: dict[str, float] = field(default_factory=lambda: dict(TRUTH))
    goals: dict[str, Callable[[Floats], Floats]] = field(
        default_factory=lambda: {"chirp": chirp, "steps": steps, "drop": drop, "small": small}
    )

    @property
    def timestep(self) -> float:
        return self.session.options.timestep

    def recording(self, plan: Plan, name: str = "run", noise: bool = True) -> Recording:
        return measured(plan, name, noise)

    def runs(self, recordings: list[Recording]) -> list[BenchRun]:
        return runs_of(recordings, self.servo, self.timestep)

    def problem(
        self,
        runs: list[BenchRun],
        held_out: tuple[BenchRun, ...] = (),
        seed: int = 0,
        law: str = "m1",
        effects: tuple[str, ...] = (),
    ) -> FitProblem:
        delays = self.session.delay_range
        return state_problem(self.servo, self.nominal, runs, held_out, delays, "none", seed, law, effects)


@pytest.fixture(scope="session")
def kit(robot_model_dir: Path) -> Iterator[BenchKit]:
    """A bench kit for the mx106."""
    servo, nominal = stated_servo("mx106", robot_model_dir / "nominal.xml")
    model = robot_model_dir / "bench_pendulum.xml"
    with BenchSession(model, servo, threads=2) as session, session.mujoco() as simulator:
        yield BenchKit(servo, nominal, session, simulator)


@pytest.fixture(scope="session")
def recordings() -> list[Recording]:
    """Seven noisy runs of one servo that is not the nominal one."""
    return [measured(plan, f"run{i}") for i, plan in enumerate(PLANS)]


@pytest.fixture(scope="session")
def bench_files(robot_model_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The bench as it is and as MuJoCo steps by default, each in a folder with its includes, by stepping."""
    found = {}
    for stepping in (TRAPEZOIDAL, EULER):
        folder = tmp_path_factory.mktemp(stepping)
        for source in robot_model_dir.glob("*.xml"):
            text = source.read_text()
            if source.name == "bench_pendulum.xml" and stepping == EULER:
                text = re.sub(r'<flag eulerdamp="disable"/>|armature="0.0267"|sol\w+friction="[^"]*"', "", text)
            (folder / source.name).write_text(text)
        found[stepping] = folder / "bench_pendulum.xml"
    return found


@pytest.fixture(scope="session")
def held_robot(robot_model_dir: Path) -> Callable[[float, str], Recording]:
    """A maker of logs [s] of one held virtual robot without zeros, small motions as its computer records them."""
    path = robot_model_dir / "nominal.xml"
    joints = joints_of(path)
    truth = replace(draw("fixed", 5, joints.classes, joints.names), zeros=None)
    sizes = first_sizes(joints)
    small = replace(sizes, quick=sizes.quick / 3, swing=sizes.swing / 3, step=sizes.step / 3)
    goals = design(joints, small, 10.0)
    return lambda seconds, name: simulate_robot(path, joints, truth, goals, seconds, name, timestep=0.0005)


@pytest.fixture(scope="session")
def standing_robot(robot_model_dir: Path) -> Callable[[float, str], Recording]:
    """A maker of logs [s] of one virtual robot without zeros that stands on its feet."""
    path = robot_model_dir / "nominal.xml"
    joints = joints_of(path)
    truth = replace(draw("floating", 5, joints.classes, joints.names), zeros=None)
    goals = standing(joints, 10.0)
    return lambda seconds, name: simulate_robot(path, joints, truth, goals, seconds, name, timestep=0.0005)

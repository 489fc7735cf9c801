"""A first task for a foreign humanoid: what was found in its model, and the Sigmaban's numbers in this robot's size."""

import re
from dataclasses import replace

import numpy as np

from frasa_rl.assumed import Assumed, AssumedRanges
from frasa_rl.config import Joint, Names, Task
from frasa_rl.config_rig import PushRig
from frasa_rl.own_look import Looked
from frasa_rl.own_stance import Stance
from frasa_rl.task_text import dump_task

PERIOD = 0.05  # [s] about, of decisions
# The Sigmaban's height and mass, for what grows with a robot.
_HEIGHT, _MASS = 0.636, 7.80  # [m], [kg]
_WORDS = re.compile(r"[_\-. ]+|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def first_task(looked: Looked, stance: Stance, names: Names, step: float) -> Task:
    """The task with everything that a model tells.

    Args:
        looked: the robot.
        stance: that it stands in.
        names: of trunk, floor and sensors.
        step: time step of the model [s].
    """
    joints = tuple(_joint(looked, stance, name) for name in looked.moved)
    moved = {name for one in joints for name in (one.left, one.right)}
    held = tuple(
        (looked.model.actuator(one.actuator).name or f"servo_{one.name}", _degrees(stance.commands[one.actuator]))
        for one in looked.hinges
        if one.name not in moved and _degrees(stance.commands[one.actuator])
    )
    size = stance.height / _HEIGHT
    base = Task()
    return Task(
        joints=joints,
        target_pitch_deg=round(float(np.degrees(stance.pitch)), 1),
        held_deg=held,
        control_period_s=_period(step),
        rate_limit=_rate(looked),
        names=names,
        assumed=_assumed(base, size),
        rig=_rig(base, size, float(looked.model.body_subtreemass[looked.trunk]) / _MASS),
    )


def task_text(task: Task, lines: list[str]) -> str:
    """The task as a file, with what was found and is not known above it."""
    return dump_task(task, "".join(f"# {line}\n" for line in lines))


def stem(left: str, right: str) -> str:
    """What two names have in common without their sides: `l_knee` and `r_knee` are `knee`."""
    one, other = _WORDS.split(left), _WORDS.split(right)
    shared = [word for word, twin in zip(one, other, strict=False) if word == twin and word]
    glue = "_" if re.search(r"[_\-. ]", left) else ""
    return glue.join(shared) or left


def _joint(looked: Looked, stance: Stance, name: str) -> Joint:
    one = looked.hinge(name)
    angle = _degrees(stance.commands[one.actuator])
    if one.partner is None:
        return Joint(name, angle, 1, name, name)
    others = [stem(other, looked.hinge(other).partner or other) for other in looked.moved if other != name]
    short = stem(name, one.partner)
    return Joint(short if short not in others else name, angle, one.mirror, name, one.partner)


def _degrees(angle: float) -> float:
    return round(float(np.degrees(angle)), 1) + 0.0


def _period(timestep: float) -> float:
    """The multiple of a time step that is nearest to the usual period [s]."""
    return round(max(round(PERIOD / timestep), 1) * timestep, 9)


def _rate(looked: Looked) -> float:
    """Joint rate that action 1 stands for: what the slowest moved servo can do without load, but for a tenth."""
    fastest = [looked.servos[looked.servo_of[name]] for name in looked.moved]
    return round(float(min(2.0 * np.pi, *(0.9 * one.force / one.damping for one in fastest))), 2)


def _assumed(base: Task, size: float) -> AssumedRanges:
    guess = "assumed as the Sigmaban's, in this robot's size"
    shift = round(0.005 * size, 4)
    return replace(
        base.assumed,
        trunk_com=Assumed(-shift, shift, "m", guess),
        supply_voltage=Assumed(0.92, 1.12, "ratio", "assumed: a battery from empty to full"),
    )


def _rig(base: Task, size: float, mass: float) -> PushRig:
    rig = base.rig
    length = round(rig.length * size, 3)
    hit = round((rig.height - rig.length) * size, 3)
    return replace(
        rig,
        mass=round(rig.mass * mass, 3),
        length=length,
        height=round(length + hit, 3),
        radius=round(rig.radius * size, 3),
        energies_j=tuple(round(one * mass * size, 2) for one in rig.energies_j),
    )

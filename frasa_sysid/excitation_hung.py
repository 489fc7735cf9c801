"""Excitation of a robot held by the trunk: multisines, steps, slow ramps with reversals, and still poses.

All shapes are written for one unit of amplitude about zero; `design` scales them joint by joint.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from frasa_sysid.excitation import PERIOD, Excitation, joined
from frasa_sysid.holds import UPRIGHT, index_of
from frasa_sysid.robot_body import Joints

FloatArray = npt.NDArray[np.float64]
SHORTEST = 10.0  # [s] below it a part would be shorter than its own transitions
SHARES = {"still": 0.06, "multisine": 0.36, "steps": 0.2, "ramps": 0.24, "holds": 0.14}
PURPOSES = {
    "still": "noise of every channel, gyro bias, how the trunk is held",
    "multisine": "gain, damping, age of velocity, inertia; every joint at frequencies of its own",
    "steps": "command delay and gain: every joint jumps at times of its own",
    "ramps": "friction: slow both ways through standstill",
    "holds": "joint zeros and friction under load: gravity at poses far apart",
}
LINES = 9  # sines of a joint
LOWEST, HIGHEST, CORNER = 0.15, 3.5, 0.4  # [Hz]; above the corner amplitudes fall as 1/f: equal speeds
TAPER = 0.4  # [s] in and out of a multisine
RAMP = 2.4  # [s] of one ramp from end to end and back, per unit of amplitude both ways
POSES = 3
MOVE = 0.7  # [s] from pose to pose


@dataclass(frozen=True)
class Sizes:
    """How far each joint may go; each field of shape (n,) [rad].

    Attributes:
        centre: pose between all motions.
        swing: of slow motions.
        quick: of multisines.
        step: of steps.
    """

    centre: FloatArray
    swing: FloatArray
    quick: FloatArray
    step: FloatArray


def first_sizes(joints: Joints) -> Sizes:
    """A start within the command limits: half way from the neutral pose to the middle of each range."""
    centre = (joints.neutral + (joints.low + joints.high) / 2.0) / 2.0
    room = np.minimum(centre - joints.low, joints.high - centre)
    return Sizes(centre, np.minimum(0.75 * room, 0.8), np.minimum(0.75 * room, 0.5), np.minimum(0.5 * room, 0.25))


def design(
    joints: Joints,
    sizes: Sizes,
    seconds: float,
    seed: int = 0,
    hold: str = UPRIGHT,
    firmware_gain: float | None = None,
) -> Excitation:
    """The whole excitation.

    Args:
        joints: of the model.
        sizes: amplitudes.
        seconds: duration.
        seed: of phases and of the order of steps.
        hold: how the trunk is held; another hold is another draw of phases.
        firmware_gain: P of the servos; None for the model's own.
    """
    own = (index_of(hold),) if index_of(hold) else ()
    n, rng = len(joints.names), np.random.default_rng((seed, 7, *own))
    count = {name: max(1, round(share * seconds / PERIOD)) for name, share in SHARES.items()}
    shapes = {
        "still": np.zeros((count["still"], n)),
        "multisine": sizes.quick * _multisines(rng, count["multisine"], n),
        "steps": sizes.step * _steps(rng, count["steps"], n),
        "ramps": sizes.swing * _ramps(rng, count["ramps"], n),
        "holds": sizes.swing * _holds(rng, count["holds"], n),
    }
    pieces = [(name, PURPOSES[name], sizes.centre + shape) for name, shape in shapes.items()]
    return replace(joined(joints.names, pieces), hold=hold, firmware_gain=firmware_gain)


def _multisines(rng: Generator, count: int, n: int) -> FloatArray:
    """Random-phase multisines of largest value 1, tapered at both ends, shape (count, n)."""
    t: FloatArray = np.asarray(np.arange(count) * PERIOD, dtype=np.float64)
    taper = np.clip(np.minimum(t, t[-1] - t) / TAPER, 0.0, 1.0)
    taper = taper**2 * (3.0 - 2.0 * taper)
    ratio = (HIGHEST / LOWEST) ** (1.0 / (LINES * n))
    shape = np.empty((count, n))
    order = rng.permutation(n)
    for joint in range(n):
        # Interleaved: no two joints share a line, so that their responses can be told apart.
        lines: FloatArray = np.asarray(LOWEST * ratio ** (order[joint] + n * np.arange(LINES)), dtype=np.float64)
        shape[:, joint] = _lowest_crest(rng, t, lines)
    return np.asarray(shape * taper[:, None])


def _lowest_crest(rng: Generator, t: FloatArray, lines: FloatArray) -> FloatArray:
    """The flattest of several draws of phases, scaled to a largest value of 1."""
    weights = np.minimum(1.0, CORNER / lines)
    best, crest = np.zeros_like(t), np.inf
    for _ in range(24):
        phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
        wave = np.sin(2.0 * np.pi * np.outer(t, lines) + phases) @ weights
        most = float(np.abs(wave).max())
        if most < crest:
            best, crest = wave / most, most
    return best


def _steps(rng: Generator, count: int, n: int) -> FloatArray:
    """Up, down and back, each joint at times of its own, shape (count, n)."""
    shape = np.zeros((count, n))
    slots = max(2, round(count * PERIOD / 0.45))
    edges = np.linspace(0.0, count, slots + 1)
    for joint in range(n):
        level, sign = 0.0, rng.choice((-1.0, 1.0))
        late = rng.integers(0, max(1, round(edges[1])), slots)
        for slot in range(slots):
            start = int(edges[slot]) + int(late[slot])
            level = 0.0 if level else sign
            sign = -sign if level else sign
            shape[start:, joint] = 0.0 if slot == slots - 1 else level
    return shape


def _ramps(rng: Generator, count: int, n: int) -> FloatArray:
    """Triangles of constant speed, shape (count, n); neighbours in turn, so that speeds differ."""
    t = np.arange(count) * PERIOD
    whole = t[-1] if count > 1 else PERIOD
    shape = np.empty((count, n))
    for joint in range(n):
        cycles = max(1, round(whole / RAMP) - int(rng.integers(0, 2)))
        phase = cycles * t / whole
        triangle = 4.0 * np.abs((phase - 0.25) % 1.0 - 0.5) - 1.0
        shape[:, joint] = rng.choice((-1.0, 1.0)) * triangle
    return shape


def _holds(rng: Generator, count: int, n: int) -> FloatArray:
    """Still poses with smooth moves between them, back to the centre, shape (count, n)."""
    levels = np.vstack([np.zeros(n), rng.choice((-1.0, -0.4, 0.4, 1.0), (POSES, n)), np.zeros(n)])
    t = np.arange(count) * PERIOD
    starts = np.linspace(0.0, t[-1] - MOVE, POSES + 1)
    shape = np.repeat(levels[:1], count, axis=0)
    for i, start in enumerate(starts):
        s = np.clip((t - start) / MOVE, 0.0, 1.0)[:, None]
        shape += (levels[i + 1] - levels[i]) * s * s * (3.0 - 2.0 * s)
    return shape

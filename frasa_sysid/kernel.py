r"""The bench simulation, compiled: the equations MuJoCo steps for one hinge, sixteen simulations at a time.

For one hinge with a dry-friction constraint MuJoCo's solver (with its noslip pass) has a closed form.
With the step h, total inertia M, joint damping B, actuator torque u, gravity -G sin q, and the
friction bound eta of `calibration.friction`:

.. math::
    \tau &= u - G \sin q - B \dot q \\
    f &= clip(-(\tau + b M \dot q), \pm \eta), \qquad b = 2 / (d_{max} t_{ref}) \\
    \dot q^+ &= \dot q + h (\tau + f) / (M + h B), \qquad q^+ = q + h \dot q^+

b belongs to MuJoCo's reference acceleration of a friction row (solref, solimp); M + h B is its
implicit damping in the Euler integrator. Tests hold this against `mujoco` itself.

Sixteen simulations ("lanes", pairs of a candidate and a run) go through every step together, so
that the compiler uses vector instructions; there is no call and no branch in the inner loop.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from frasa_sysid.calibration.fast_math import fast_sin
from frasa_sysid.calibration.friction import friction_loss

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LANES = 16
ROWS = 25  # numbers a lane has, in the order `_steps` reads them (see `bench_kernel`)
_CHUNK = 256  # steps whose inputs are laid out side by side before they are simulated: they fit the first cache
_BEYOND = 1e3  # [rad] a simulation that got here has diverged
_NO_LIMIT = 1e5  # [rad/s] goal speed limits from here on are none


# NaN and infinity are left to IEEE on purpose: "fast" forms would drop the clipping of a diverging simulation.
@njit(nogil=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"}, cache=True)  # type: ignore[untyped-decorator]
def _steps(
    h: float, count: int, w: FloatArray, q_state: FloatArray, v_state: FloatArray, u: FloatArray, out: FloatArray
) -> None:
    """Advance all lanes by `count` steps; u holds goal, supply and power of each step, `out` gets the angles."""
    for k in range(count):
        o = k * LANES
        for i in range(LANES):
            q = q_state[i]
            v = v_state[i]
            goal = u[3 * o + i]
            supply = u[3 * o + LANES + i]
            power = u[3 * o + 2 * LANES + i]
            # The firmware: dead zone, punch, duty limit, gain collapse; then the supply under load.
            error = goal - w[23 * LANES + i] * q
            error = error - min(max(error, -w[20 * LANES + i]), w[20 * LANES + i])
            pushed = error + w[18 * LANES + i] * min(max(error * w[19 * LANES + i], -1.0), 1.0)
            asked = min(max(w[i] * pushed, -w[LANES + i]), w[LANES + i])
            asked = asked * (1.0 if abs(error) < w[21 * LANES + i] else w[22 * LANES + i])
            back = w[4 * LANES + i] * v
            sagged = supply * (1.0 - w[17 * LANES + i] * asked * (asked * supply - back))
            act = power * asked * sagged
            external = w[24 * LANES + i] - w[2 * LANES + i] * fast_sin(q)
            damping = w[3 * LANES + i] + power * w[4 * LANES + i]
            bound = friction_loss(
                act - power * back,
                external,
                v,
                w[7 * LANES + i],
                w[8 * LANES + i],
                w[9 * LANES + i],
                w[10 * LANES + i],
                w[11 * LANES + i],
                w[12 * LANES + i],
                w[13 * LANES + i],
                w[14 * LANES + i],
                w[15 * LANES + i],
                w[16 * LANES + i],
            )
            mass = w[5 * LANES + i]
            smooth = act + external - damping * v
            f = -(smooth + mass * w[6 * LANES + i] * v)
            f = min(max(f, -bound), bound)
            v = v + h * (smooth + f) / (mass + h * damping)
            q = q + h * v
            q = min(max(q, -2.0 * _BEYOND), 2.0 * _BEYOND)
            q_state[i] = q
            v_state[i] = v
            out[o + i] = q


@njit(nogil=True, error_model="numpy", cache=True)  # type: ignore[untyped-decorator]
def slew_limited(command: FloatArray, most: float) -> FloatArray:
    """A goal that moves by at most `most` [rad] each step, shape as given: the firmware's profile speed."""
    out = np.empty_like(command)
    goal = command[0]
    for k in range(command.size):
        goal += min(max(command[k] - goal, -most), most)
        out[k] = goal
    return out


@njit(nogil=True, error_model="numpy", cache=True)  # type: ignore[untyped-decorator]
def _lay_out(
    u: FloatArray,
    first: int,
    count: int,
    lane: int,
    command: FloatArray,
    supply: FloatArray,
    follow: float,
    lead: int,
    h: float,
    delay: float,
    offset: float,
    switches: FloatArray,
    powered_first: bool,
) -> None:
    """Inputs of one lane for `count` steps from `first` on: delayed goal, supply, share of power."""
    shift = delay / h
    whole = int(np.floor(shift))
    part = shift - whole
    last = command.size - 1
    last_supply = supply.size - 1
    start = 1.0 if powered_first else 0.0
    for j in range(count):
        k = first + j
        a = min(max(k + lead - whole, 0), last)
        b = min(max(k + lead - whole - 1, 0), last)
        base = 3 * j * LANES + lane
        # As MuJoCo's history interpolates linearly between the commands of two steps.
        u[base] = (1.0 - part) * command[a] + part * command[b] - offset
        u[base + LANES] = 1.0 + follow * (supply[min(k, last_supply)] - 1.0)
        u[base + 2 * LANES] = start
    power = powered_first
    for s in range(switches.size):
        # The torque flag travels the same way as the goals, so it is late by the same delay.
        edge = (switches[s] + delay) / h
        cell = int(np.floor(edge))
        before = 1.0 if power else 0.0
        after = 1.0 - before
        power = not power
        for j in range(max(cell - first, 0), count):
            share = edge - cell if first + j == cell else 0.0
            u[3 * j * LANES + 2 * LANES + lane] = share * before + (1.0 - share) * after


@njit(nogil=True, error_model="numpy", cache=True)  # type: ignore[untyped-decorator]
def simulate_blocks(
    blocks: IntArray,
    h: float,
    w: FloatArray,
    q0: FloatArray,
    v0: FloatArray,
    offset: FloatArray,
    delay: FloatArray,
    goal_speed: FloatArray,
    follow: FloatArray,
    run: IntArray,
    candidate: IntArray,
    command: FloatArray,
    command_start: IntArray,
    lead: IntArray,
    supply: FloatArray,
    start: IntArray,
    switches: FloatArray,
    switch_start: IntArray,
    powered_first: npt.NDArray[np.bool_],
    absolute: npt.NDArray[np.bool_],
    step: IntArray,
    weight: FloatArray,
    sample_start: IntArray,
    out: FloatArray,
) -> None:
    """Simulate blocks of 16 lanes and write their readings at the measured times.

    Args:
        blocks: which blocks this call does.
        h: step [s].
        w: numbers of each lane, shape (blocks, ROWS * 16).
        q0, v0: start of each lane [rad], [rad/s], (blocks, 16).
        offset, delay, goal_speed, follow: of each lane [rad], [s], [rad/s], [1], (blocks, 16).
        run, candidate: indices of each lane, (blocks, 16); candidate -1 is a lane that only fills up.
        command: all runs one after another, run r from command_start[r] on, with its lead.
        supply: likewise, one for each step: run r from start[r] to start[r + 1].
        switches, powered_first: of the torque flag, likewise.
        absolute: whether a run's commands are volts or torques, which no encoder offset shifts.
        step, weight: position of each measured time on the grid, run r from sample_start[r] on.
        out: readings [rad], (candidates, samples); NaN where the simulation diverged.
    """
    u = np.empty(3 * _CHUNK * LANES)
    for n in range(blocks.size):
        block = blocks[n]
        steps = 0
        for i in range(LANES):
            steps = max(steps, start[run[block, i] + 1] - start[run[block, i]])
        angles = np.empty((steps + 1) * LANES)
        q = q0[block].copy()
        v = v0[block].copy()
        angles[:LANES] = q
        limited = [command[:0] for _ in range(LANES)]
        for i in range(LANES):
            r = run[block, i]
            limited[i] = command[command_start[r] : command_start[r + 1]]
            if goal_speed[block, i] < _NO_LIMIT:
                limited[i] = slew_limited(limited[i], goal_speed[block, i] * h)
        for first in range(0, steps, _CHUNK):
            count = min(_CHUNK, steps - first)
            for i in range(LANES):
                r = run[block, i]
                _lay_out(
                    u,
                    first,
                    count,
                    i,
                    limited[i],
                    supply[start[r] : start[r + 1]],
                    follow[block, i],
                    lead[r],
                    h,
                    delay[block, i],
                    0.0 if absolute[r] else offset[block, i],
                    switches[switch_start[r] : switch_start[r + 1]],
                    powered_first[r],
                )
            _steps(h, count, w[block], q, v, u, angles[(first + 1) * LANES :])
        for i in range(LANES):
            c = candidate[block, i]
            if c < 0:
                continue
            r = run[block, i]
            last = start[r + 1] - start[r]
            for j in range(sample_start[r], sample_start[r + 1]):
                low = angles[step[j] * LANES + i]
                high = angles[min(step[j] + 1, last) * LANES + i]
                reading = low + weight[j] * (high - low) + offset[block, i]
                out[c, j] = reading if abs(reading) < _BEYOND else np.nan

r"""The bench simulation, compiled: the equations MuJoCo steps for one hinge, sixteen simulations at a time.

For one hinge with a dry-friction constraint MuJoCo's solver (with its noslip pass) has a closed form.
With the step h, total inertia M, joint damping B, actuator torque u, gravity -G sin q, and the
friction bound eta of `calibration.friction`:

.. math::
    \tau &= u - G \sin q - B \dot q \\
    f &= clip(-(\tau + b M \dot q), \pm \eta), \qquad b = 2 / (d_{max} t_{ref}) \\
    \dot q^+ &= \dot q + h (\tau + f) / (M + h B), \qquad q^+ = q + h \dot q^+

b belongs to MuJoCo's reference acceleration of a friction row (solref, solimp); M + h B is its
implicit damping in the Euler integrator. A model of trapezoidal stepping (`calibration.stepping`) has
M + h B/2 in its place, in the friction's row too. Tests hold both against `mujoco` itself.

Sixteen simulations ("lanes", pairs of a candidate and a run) go through every step together, so
that the compiler uses vector instructions; there is no call and no branch in the inner loop. What
most fits do not need (friction laws beyond M1, effects) is left out of loops of their own, and gives
the same bits as the full loop with zeros: products are fused by name only (`fma`).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration.fast_math import fast_sin, fma
from frasa_sysid.calibration.friction import faded_loss, stribeck_fade
from frasa_sysid.calibration.kept_compiled import kept

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LANES = 16
# Numbers a lane has, each a row of 16: where its row starts. First what every lane needs ...
GAIN, LIMIT, TRACK, KEPT, PART, SHIFT, GRAVITY, HOLD, COULOMB = (LANES * row for row in range(9))
# ... what changes with the power (`_set_power`) and what it follows from ...
POWER, DAMPING, BACK, ADVANCE, DAMPING_OFF, BACK_ON, MASS = (LANES * row for row in range(9, 16))
# ... of the friction law ...
STRIBECK, LOAD_M, LOAD_E, STATIC_M, STATIC_E, QUAD_M, QUAD_E, EXPONENT, FADE_SHIFT = (
    LANES * row for row in range(16, 25)
)
# ... and of effects.
SAG, BACK_EMF, FOLLOW, PUNCH, STEEP, DEAD, COLLAPSE_AT, COLLAPSE_TO, BIAS, LAG, GOAL_STEP = (
    LANES * row for row in range(25, 36)
)
IMPLICIT = LANES * 36  # step [s] by which the damping torque looks ahead
DRAG = LANES * 37
AHEAD = LANES * 38  # share of its last change that a speed is carried on by, to the time of the angle beside it
CREEP = LANES * 39  # b of the friction constraint's reference acceleration [1/s]
SOLID = LANES * 40  # step [s] by which its inertia knows of damping
ROWS = 41
_CHUNK = 128  # steps whose inputs are laid out side by side before they are simulated: they fit the first cache
_BEYOND = 1e3  # [rad] a simulation that got here has diverged
_NO_LIMIT = 1e3  # [rad] goal steps from here on are not limited


def _stepper(law: bool, effects: bool) -> Any:  # noqa: ANN401 (numba's functions have no type)
    """The loop over steps, with or without what lies beyond M1 and beyond a linear motor."""

    @kept(nogil=True, error_model="numpy", fastmath={"nsz"})
    def steps(
        h: float,
        count: int,
        w: FloatArray,
        q_state: FloatArray,
        v_state: FloatArray,
        v_last: FloatArray,
        command: FloatArray,
        supply: FloatArray,
        out: FloatArray,
    ) -> None:
        """Advance all lanes by `count` steps; commands are one row ahead, for the one before."""
        for k in range(count):
            o = k * LANES
            for i in range(LANES):
                q = q_state[i]
                v = v_state[i]
                # A step's torque makes the speed of the step's middle, so v is half a step older than q.
                now = fma(w[AHEAD + i], v - v_last[i], v) if law or effects else v
                # As MuJoCo's history interpolates linearly between the commands of two steps.
                goal = fma(w[PART + i], command[o + i], fma(w[KEPT + i], command[o + LANES + i], w[SHIFT + i]))
                error = fma(-w[TRACK + i], q, goal)
                external = w[GRAVITY + i] * fast_sin(q)
                if effects:
                    external = fma(-w[DRAG + i] * abs(now), now, external + w[BIAS + i])
                    # The firmware: age of its reading, dead zone, punch, duty limit, gain collapse; then the supply.
                    error = fma(w[LAG + i], now, error)
                    error = error - min(max(error, -w[DEAD + i]), w[DEAD + i])
                    pushed = fma(w[PUNCH + i], min(max(error * w[STEEP + i], -1.0), 1.0), error)
                    asked = min(max(w[GAIN + i] * pushed, -w[LIMIT + i]), w[LIMIT + i])
                    asked = asked * (1.0 if abs(error) < w[COLLAPSE_AT + i] else w[COLLAPSE_TO + i])
                    volts = fma(w[FOLLOW + i], supply[o + i] - 1.0, 1.0)
                    # The drop is resistance times current, and the current is what is left after the drop.
                    drop = w[SAG + i] * asked
                    volts = fma(drop, w[BACK_EMF + i] * now, volts) / fma(drop, asked, 1.0)
                    act = w[POWER + i] * asked * volts
                else:
                    act = w[POWER + i] * min(max(w[GAIN + i] * error, -w[LIMIT + i]), w[LIMIT + i])
                bound = w[COULOMB + i]
                if law:
                    bound = faded_loss(
                        fma(-w[BACK + i], now, act),
                        external,
                        stribeck_fade(now, w[EXPONENT + i], w[FADE_SHIFT + i]),
                        bound,
                        w[STRIBECK + i],
                        w[LOAD_M + i],
                        w[LOAD_E + i],
                        w[STATIC_M + i],
                        w[STATIC_E + i],
                        w[QUAD_M + i],
                        w[QUAD_E + i],
                    )
                smooth = fma(-w[DAMPING + i], v, act) + external
                f = min(max(-fma(w[HOLD + i], v, smooth), -bound), bound)
                if law or effects:
                    v_last[i] = v
                v = fma(w[ADVANCE + i], smooth + f, v)
                q = fma(h, v, q)
                q_state[i] = q
                v_state[i] = v
                out[o + LANES + i] = q

    return steps


_steps_plain = _stepper(law=False, effects=False)
_steps_effects = _stepper(law=False, effects=True)
_steps_law = _stepper(law=True, effects=False)
_steps_full = _stepper(law=True, effects=True)


@kept(nogil=True, error_model="numpy")
def slew_limited(command: FloatArray, most: float) -> FloatArray:
    """A goal that moves by at most `most` [rad] each step, shape as given: the firmware's profile speed."""
    out = np.empty_like(command)
    goal = command[0]
    for k in range(command.size):
        goal += min(max(command[k] - goal, -most), most)
        out[k] = goal
    return out


@kept(nogil=True, error_model="numpy")
def _slew_rows(u: FloatArray, count: int, most: FloatArray) -> None:
    """The same in place for rows of 16 lanes; row 0 is already limited."""
    for k in range(count):
        o = k * LANES
        for i in range(LANES):
            limited = u[o + i] + min(max(u[o + LANES + i] - u[o + i], -most[i]), most[i])
            u[o + LANES + i] = limited if most[i] < _NO_LIMIT else u[o + LANES + i]


@kept(nogil=True, error_model="numpy")
def _side_by_side(
    u: FloatArray, values: FloatArray, begin: IntArray, first: int, count: int, low: IntArray, high: IntArray
) -> None:
    """Rows of 16 values: lane i's from begin[i] + first on, kept within low[i] to high[i]."""
    for i in range(0, LANES, 4):  # four lanes in one pass: a row's cache line is then written to less often
        inside = True
        for lane in range(i, i + 4):
            at = begin[lane] + first
            inside = inside and low[lane] <= at and at + count <= high[lane] + 1
        if inside:
            a = values[begin[i] + first :]
            b = values[begin[i + 1] + first :]
            c = values[begin[i + 2] + first :]
            d = values[begin[i + 3] + first :]
            for k in range(count):
                o = k * LANES + i
                u[o], u[o + 1], u[o + 2], u[o + 3] = a[k], b[k], c[k], d[k]
        else:
            for lane in range(i, i + 4):
                for k in range(count):
                    u[k * LANES + lane] = values[min(max(begin[lane] + first + k, low[lane]), high[lane])]


@kept(nogil=True, error_model="numpy")
def _set_power(h: float, w: FloatArray, i: int, late: float, switches: FloatArray, powered_first: bool, k: int) -> int:
    """Set what depends on the power of lane i in step k; the first later step in which it may differ."""
    power = level = 1.0 if powered_first else 0.0
    until = np.iinfo(np.int64).max
    for turn in switches:
        # The torque flag travels the same way as the goals, so it is late by the same delay.
        edge = (turn + late) / h
        cell = int(np.floor(edge))
        if cell > k:
            until = min(until, cell)
            break
        turned = 1.0 - 2.0 * level
        level = 1.0 - level
        if cell == k:
            power += turned * (1.0 - (edge - cell))
            until = k + 1
        else:
            power += turned
    w[POWER + i] = power
    w[BACK + i] = power * w[BACK_ON + i]
    w[DAMPING + i] = w[DAMPING_OFF + i] + w[BACK + i]
    w[ADVANCE + i] = h / (w[MASS + i] + w[IMPLICIT + i] * w[DAMPING + i])
    w[HOLD + i] = w[CREEP + i] * (w[MASS + i] + w[SOLID + i] * w[DAMPING + i])
    return until


@kept(nogil=True, error_model="numpy")
def _scale_kick(w: FloatArray, share: float) -> None:
    """Make the next steps change speeds by a share of what they would; friction still stops within a step."""
    w[ADVANCE : ADVANCE + LANES] *= share
    w[HOLD : HOLD + LANES] /= share


@kept(nogil=True, error_model="numpy")
def simulate_blocks(
    blocks: IntArray,
    law: bool,
    effects: bool,
    h: float,
    numbers: FloatArray,
    q0: FloatArray,
    v0: FloatArray,
    offset: FloatArray,
    delay: FloatArray,
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
    step: IntArray,
    weight: FloatArray,
    sample_start: IntArray,
    out: FloatArray,
) -> None:
    """Simulate blocks of 16 lanes and write their readings at the measured times.

    The numbers `blocks` say which blocks this call does; `law` and `effects` whether any lane has friction
    beyond M1, and any effects; h is the step [s].

    Of each lane, (blocks, 16): its `numbers` (blocks, ROWS * 16), q0 [rad], v0 [rad/s], zero `offset` [rad], `delay`
    [s], and its `run` and `candidate` as indices; candidate -1 is a lane that only fills up.

    Of the runs, one after another: `command` with its lead, run r from command_start[r] on; `supply`, one for each
    step, from start[r] to start[r + 1]; `switches` of the torque flag [s], which is `powered_first`; and the measured
    times as positions `step` and `weight` on the grid, from sample_start[r] on.

    The result `out` are readings [rad], (candidates, samples); NaN where the simulation diverged.
    """
    goals = np.empty((_CHUNK + 1) * LANES)
    volts = np.ones(_CHUNK * LANES)
    angles = np.empty((_CHUNK + 1) * LANES)
    begin, low, high, begin_volts, low_volts, high_volts, until, sample = np.empty((8, LANES), np.int64)
    for block in blocks:
        w = numbers[block].copy()
        q, v, last = q0[block].copy(), v0[block].copy(), v0[block].copy()
        steps = 0
        slow = follows = False
        for i in range(LANES):
            r = run[block, i]
            steps = max(steps, start[r + 1] - start[r])
            low[i], high[i] = command_start[r], command_start[r + 1] - 1
            low_volts[i], high_volts[i] = start[r], start[r + 1] - 1
            begin_volts[i] = start[r]
            begin[i] = low[i] + lead[r] - int(np.floor(delay[block, i] / h))
            sample[i] = sample_start[r]
            until[i] = 0
            slow = slow or w[GOAL_STEP + i] < _NO_LIMIT
            follows = follows or w[FOLLOW + i] != 0.0
        _side_by_side(goals, command, begin, -1, 1, low, high)
        if slow:
            for i in range(LANES):
                goal = command[low[i]]
                if w[GOAL_STEP + i] < _NO_LIMIT:
                    for k in range(low[i], begin[i]):
                        goal += min(max(command[k] - goal, -w[GOAL_STEP + i]), w[GOAL_STEP + i])
                    goals[i] = goal
        first = 0
        while first < steps:
            stop = min(first + _CHUNK, steps)
            for i in range(LANES):
                if until[i] <= first:
                    r = run[block, i]
                    flags = switches[switch_start[r] : switch_start[r + 1]]
                    until[i] = _set_power(h, w, i, delay[block, i], flags, powered_first[r], first)
                stop = min(stop, until[i])
            half = first == 0 and w[AHEAD] != 0.0
            if half:
                # The start's speed is that of its own time, half a step before the first one's middle.
                stop = 1
                _scale_kick(w, 0.5)
            count = stop - first
            _side_by_side(goals[LANES:], command, begin, first, count, low, high)
            if slow:
                _slew_rows(goals, count, w[GOAL_STEP : GOAL_STEP + LANES])
            if follows:
                _side_by_side(volts, supply, begin_volts, first, count, low_volts, high_volts)
            angles[:LANES] = q
            if law and effects:
                _steps_full(h, count, w, q, v, last, goals, volts, angles)
            elif law:
                _steps_law(h, count, w, q, v, last, goals, volts, angles)
            elif effects:
                _steps_effects(h, count, w, q, v, last, goals, volts, angles)
            else:
                _steps_plain(h, count, w, q, v, last, goals, volts, angles)
            if half:
                _scale_kick(w, 2.0)
                last += last - v
            goals[:LANES] = goals[count * LANES : (count + 1) * LANES]
            for i in range(LANES):
                c = candidate[block, i]
                if c < 0:
                    continue
                j = sample[i]
                end = sample_start[run[block, i] + 1]
                while j < end and step[j] < stop:
                    o = (step[j] - first) * LANES + i
                    reading = fma(weight[j], angles[o + LANES] - angles[o], angles[o]) + offset[block, i]
                    out[c, j] = reading if abs(reading) < _BEYOND else np.nan
                    j += 1
                sample[i] = j
            first = stop

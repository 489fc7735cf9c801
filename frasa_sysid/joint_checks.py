"""What the joints of a log say about the log itself: signs, zeros, scales, rates, and channels that are missing.

A fit takes a log at its word; these checks do not. Each is about one recording and ends in a `Check`: a sentence with
what was found, what was expected and what to do, and whether the log serves nonetheless.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from frasa_sysid.errors import LogError
from frasa_sysid.holds import up_of
from frasa_sysid.inspection import gravity_torque, is_bench
from frasa_sysid.lag_channels import Pair, pairs
from frasa_sysid.recording import FloatArray, Recording

Level = Literal["refuse", "warn"]
FAST = 0.02  # [s] a sampling period up to which delays can be told
SLOW = 0.05  # [s] from which on a fit of delays is refused
ZERO = 0.3  # [rad] that a joint may be from its goal on average: gravity takes a soft joint about so far
SLOPE = (0.5, 1.6)  # of the measurement over the goal
YIELDS = 0.8  # of the measurement over the goal, below which a joint gives way to its load
FOLLOWS = 0.7  # correlation from which on a slope means something
MOVES = 0.02  # [rad], standard deviation, from which on a joint moves
LATEST = 0.4  # [s] that a joint may be behind its goal
SPEED_SLOPE = (0.7, 1.4)  # of a velocity over the derivative of the position
SPEED_FOLLOWS = 0.5
SPEED_SPAN = 0.01  # [s] to either side that the derivative of a position is taken over, one sample at least
FEWEST = 16  # readings that a joint is judged by; against its goal, those under power count
ENOUGH = 2**15  # samples of a joint; of more every second is looked at, or every third, ...
STEADY = np.radians(3.0)  # of a held trunk's tilt: beyond it zeros are off by as much as they are asked to be known
DEGREES = 180 / np.pi
TURNS_PER_MINUTE = 60 / (2 * np.pi)


@dataclass(frozen=True)
class Check:
    """One thing that looks wrong with a recording.

    Attributes:
        recording: its name.
        code: stable short name, such as `wrong_sign`.
        joint: which joint; empty where it is about the whole log.
        level: `refuse`: a fit would be misled, or cannot be made; `warn`: it can, with that in mind.
        message: a sentence.
    """

    recording: str
    code: str
    joint: str
    level: Level
    message: str


def checks(recording: Recording) -> list[Check]:
    """Everything that looks wrong with a recording's joints; empty where nothing does, or there are none."""
    if "position" not in recording.signals:
        return [_no_positions(recording)]
    if recording.linear:
        return []
    found = [*_rate(recording), *_goal(recording), *_held(recording)]
    for name, judge in (("goal", _against_goal), ("velocity", _against_slope)):
        if name in recording.signals:
            found += _joints(recording, name, judge)
    return found


Judge = Callable[[Recording, Pair], Iterable[Check]]


def _joints(recording: Recording, name: str, judge: Judge) -> list[Check]:
    try:
        # The goal is what a position is held against, and the position what a velocity is held against.
        asked = pairs(recording, *(("position", name) if name == "goal" else (name, "position")))
    except LogError as error:
        return [Check(recording.name, "no_pair", "", "warn", f"{name} and position cannot be compared: {error}")]
    return [check for pair in asked for check in judge(recording, pair)]


def _no_positions(recording: Recording) -> Check:
    if "gyro" in recording.signals or "orientation" in recording.signals:
        text = "an IMU and no joint positions: delays between IMU channels can be told ('lag'), nothing can be fitted"
        return Check(recording.name, "no_joints", "", "refuse", text)
    there = ", ".join(sorted(recording.signals)) or "nothing"
    remedy = "record /joint_states (or add a 'position' entry to the map)"
    text = f"no positions, only {there}: nothing can be fitted; {remedy}"
    return Check(recording.name, "no_positions", "", "refuse", text)


def _rate(recording: Recording) -> list[Check]:
    t = recording.signal("position").t
    if t.size < 3:
        return [Check(recording.name, "too_short", "", "refuse", f"{t.size} positions: record for 10 s or longer")]
    period = float(np.median(np.diff(t)))
    if period <= FAST * 1.1:
        return []
    text = (
        f"{1 / period:.3g} Hz: a delay is known to about half a sample period at best, {1e3 * period / 2:.0f} ms: "
        "record at 50 Hz or more"
    )
    return [Check(recording.name, "slow_rate", "", "refuse" if period >= SLOW * 1.1 else "warn", text)]


def _goal(recording: Recording) -> list[Check]:
    if recording.rig.control != "position":
        return []
    if "goal" not in recording.signals:
        text = "no goal: command delay, gain and friction need the commanded positions; record /joint_command"
        return [Check(recording.name, "no_goal", "", "refuse", text)]
    told, measured = set(recording.signals["goal"].columns), recording.signals["position"].columns
    lacking = [joint for joint in measured if told and joint not in told]
    if lacking:
        text = f"no goal for {', '.join(lacking)}: nothing can be fitted of them"
        return [Check(recording.name, "no_goal", "", "warn", text)]
    return []


def _held(recording: Recording) -> list[Check]:
    """A trunk that is said to be held, and was turned meanwhile: a fit takes gravity to be constant in it."""
    turned = recording.signals.get("orientation")
    if recording.rig.base != "fixed" or turned is None or turned.t.size < 3:
        return []
    up = up_of(turned.y)  # a turn about the vertical changes no load
    middle = np.median(up, axis=0)
    away = np.arccos(np.clip(up @ middle / np.linalg.norm(middle), -1.0, 1.0))
    most = float(np.percentile(away, 99))
    if most <= STEADY:
        return []
    when = turned.t[int(np.argmax(away))] - turned.t[0]
    text = (
        f"the trunk counts as held and was tilted by {np.rad2deg(most):.0f} deg (around {when:.1f} s): clamp it, and "
        "record each way to hold it as a log of its own"
    )
    return [Check(recording.name, "trunk_moved", "", "warn", text)]


def _against_goal(recording: Recording, pair: Pair) -> list[Check]:
    joint = pair.joint or "the joint"
    goal, on = pair.against, _powered(recording, pair)
    t, y = pair.of.signal.t[on], pair.of.y[on]
    if t.size < FEWEST:
        return []
    some_t, some_y = _thinned(t, y)
    shift, r, slope, offset = _best_fit(some_t, some_y, goal.signal.t, goal.y)
    told = f"it was told {_degrees(goal.y)} and went {_degrees(y)}"
    if r < -FOLLOWS and min(goal.y.std(), y.std()) > MOVES:
        text = f"sign of {joint} looks wrong: {told} deg (correlation {r:.2f}): turn the sign of one of them"
        return [Check(recording.name, "wrong_sign", pair.joint, "refuse", text)]
    found = []
    middle = float(np.median(np.interp(some_t - shift, goal.signal.t, goal.y)))
    if abs(offset) > ZERO and _may_hang(recording, middle, offset) and (_loaded(recording) or _yields(r, slope)):
        text = (
            f"{joint} hangs below its goal: {told} deg, {np.rad2deg(offset):+.0f} deg on average: little strength at "
            "this gain, or a wrong zero"
        )
        found.append(Check(recording.name, "hangs_below", pair.joint, "warn", text))
    elif abs(offset) > ZERO:
        text = f"zero of {joint} looks wrong: {told} deg, {np.rad2deg(offset):+.0f} deg on average: check its mapping"
        found.append(Check(recording.name, "wrong_zero", pair.joint, "refuse", text))
    moved = goal.y.std() > MOVES
    if moved and r > FOLLOWS and not SLOPE[0] < slope < SLOPE[1]:
        text = f"{joint} moves {slope:.2f} times as far as it is told: {told} deg: a wrong unit or gear, or no strength"
        found.append(Check(recording.name, "wrong_scale", pair.joint, "warn", text))
    if moved and abs(r) <= FOLLOWS:
        text = (
            f"{joint} does not follow its goal within {LATEST:g} s (correlation {r:.2f}): {told} deg: "
            "is it the right column, and was the torque on?"
        )
        found.append(Check(recording.name, "does_not_follow", pair.joint, "warn", text))
    return found


def _may_hang(recording: Recording, goal: float, offset: float) -> bool:
    """Whether a bench's arm is where its weight would draw it: from its goal towards the zero, and hardly beyond."""
    held = {"gyro", "orientation"} & set(recording.signals) or recording.rig.base is not None
    return is_bench(recording) and not held and goal * offset < 0 and abs(offset) < abs(goal) + ZERO


def _loaded(recording: Recording) -> bool:
    return (gravity_torque(recording) or 0.0) > 0.0


def _yields(r: float, slope: float) -> bool:
    """Whether a joint goes the way that it is told, and far less far."""
    return r > FOLLOWS and 0.0 < slope < YIELDS


def _powered(recording: Recording, pair: Pair) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Which positions were read while the joint's torque was on: one that falls freely follows no goal."""
    t = pair.of.signal.t
    enable = recording.signals.get("torque_enable")
    if enable is None or (enable.columns and pair.joint not in enable.columns):
        return np.ones(t.size, dtype=bool)
    flag = enable.y[:, enable.columns.index(pair.joint)] if enable.columns else enable.y
    return np.asarray(flag[np.maximum(np.searchsorted(enable.t, t, side="right") - 1, 0)] > 0.5)


def _thinned(*arrays: FloatArray) -> list[FloatArray]:
    """Arrays of one length, by as many of their elements as are enough."""
    return [one[:: -(-one.size // ENOUGH)] for one in arrays]


def _best_fit(t: FloatArray, y: FloatArray, goal_t: FloatArray, goal: FloatArray) -> tuple[float, float, float, float]:
    """Shift [s], correlation and slope where goal and measurement go together best, and mean offset [rad]."""
    best = (0.0, 0.0, 0.0)
    for shift in np.linspace(0.0, LATEST, 41):
        x = np.interp(t - shift, goal_t, goal)
        if x.std() > 0.0 and y.std() > 0.0:
            r = float(np.corrcoef(x, y)[0, 1])
            if abs(r) > abs(best[1]):
                best = (float(shift), r, r * float(y.std() / x.std()))
    offset = float(np.median(y - np.interp(t - best[0], goal_t, goal)))
    return *best, offset


def _against_slope(recording: Recording, pair: Pair) -> list[Check]:
    position, velocity = pair.against, pair.of
    # Two joints that lie still, or a position with few samples, say nothing about a velocity.
    if position.signal.t.size < FEWEST or position.y.std() < MOVES:
        return []
    best_r, best_slope = 0.0, 0.0
    t, q = position.signal.t, position.y
    # At a kilohertz one count of an encoder from one sample to the next is a speed of its own.
    k = min(max(1, round(SPEED_SPAN / float(np.median(np.diff(t))))), (t.size - 1) // 4)
    middle, speed = (t[2 * k :] + t[: -2 * k]) / 2, (q[2 * k :] - q[: -2 * k]) / (t[2 * k :] - t[: -2 * k])
    told_t, told = _thinned(velocity.signal.t, velocity.y)
    for shift in np.linspace(-LATEST / 4, LATEST / 2, 61):
        x = np.interp(told_t - shift, middle, speed)
        if x.std() > 0.0 and told.std() > 0.0:
            r = float(np.corrcoef(x, told)[0, 1])
            if abs(r) > abs(best_r):
                best_r, best_slope = r, r * float(told.std() / x.std())
    return _judge_slope(recording, pair, best_r, best_slope)


def _judge_slope(recording: Recording, pair: Pair, r: float, slope: float) -> list[Check]:
    joint = pair.joint or "the joint"
    if abs(r) < SPEED_FOLLOWS:
        text = f"velocity of {joint} does not look like the derivative of its position (correlation {r:.2f})"
        return [Check(recording.name, "velocity_unlike", pair.joint, "warn", text)]
    if slope < 0:
        text = f"velocity of {joint} has the wrong sign: {slope:.2f} times the derivative of its position"
        return [Check(recording.name, "velocity_sign", pair.joint, "refuse", text)]
    if SPEED_SLOPE[0] < slope < SPEED_SLOPE[1]:
        return []
    units = {"deg/s": DEGREES, "revolutions a minute": TURNS_PER_MINUTE, "revolutions a second": 1 / (2 * np.pi)}
    likely = [name for name, factor in units.items() if 0.8 < slope / factor < 1.25]
    why = f"is it in {likely[0]}?" if likely else "a wrong unit, or filtered"
    text = f"velocity of {joint} is {slope:.3g} times the derivative of its position, expected 1: {why}"
    return [Check(recording.name, "velocity_scale", pair.joint, "refuse" if likely else "warn", text)]


def _degrees(y: FloatArray) -> str:
    low, high = np.rad2deg([y.min(), y.max()])
    return f"{low:.0f}..{high:.0f}"

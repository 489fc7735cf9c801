"""What logs of a whole robot can tell, before any fit: one small rule a group of numbers, each with its reason.

The advice is in the words of the fit (`robot_fit.RECORD`); the rules are coarse on purpose.
"""

from collections.abc import Sequence

import numpy as np

from frasa_sysid.finding import Finding, Verdict
from frasa_sysid.holds import up_of
from frasa_sysid.recording import Recording
from frasa_sysid.robot_fit import RECORD
from frasa_sysid.robot_rig import SLOWEST, is_robot

_SLOW = 0.015  # [s] between samples, beyond which a delay of milliseconds is seen badly
_QUICK = 1.0  # [rad/s] of a goal or joint
_MOVES = 0.1  # [rad] that a joint travels
_APART = 45.0  # [deg] between the ways to hold a trunk, from which on gravity turns other joints
_TURNS = 0.2  # [rad/s] root mean square rate of a trunk that tells the age of its IMU


def robot_findings(recordings: Sequence[Recording]) -> list[Finding]:
    """All verdicts for the recordings of one robot, most needed first; none without a recording of a robot."""
    every = [one for one in recordings if is_robot(one)]
    robots = [one for one in every if _period(one, "position") <= SLOWEST]
    if not robots:
        reason = "positions every {:.0f} ms; no servo's motion is seen at that rate"
        slow = min((_period(one, "position") for one in every), default=0.0)
        return [Finding("anything", "no", reason.format(slow * 1e3), "joints at 50 Hz or more")] if every else []
    return [_command(robots), _velocity(robots), *_imu(robots), _zeros(robots), _scales(robots), _trunk(robots)]


def _command(robots: Sequence[Recording]) -> Finding:
    name, record = "command delay", RECORD["command.delay"]
    driven = [one for one in robots if "goal" in one.signals]
    if not driven:
        return Finding(name, "no", "no goals in the log", record)
    period, speed = min(_period(one, "position") for one in driven), max(_goal_speed(one) for one in driven)
    enough = period <= _SLOW and speed >= _QUICK
    reason = (
        f"goals move at up to {speed:.1f} rad/s, positions every {period * 1e3:.0f} ms; only its sum with the age of "
        "positions is told"
    )
    return Finding(name, "yes" if enough else "weak", reason, "" if enough else record)


def _velocity(robots: Sequence[Recording]) -> Finding:
    name, record = "delay of velocities", RECORD["sensor.velocity_delay"]
    known = [one for one in robots if "velocity" in one.signals]
    if not known:
        return Finding(name, "no", "no joint velocities in the log", record)
    period, speed = min(_period(one, "velocity") for one in known), max(_speed(one) for one in known)
    enough = period <= _SLOW and speed >= _QUICK
    reason = f"joints turn at up to {speed:.1f} rad/s, velocities every {period * 1e3:.0f} ms"
    return Finding(name, "yes" if enough else "weak", reason, "" if enough else record)


def _imu(robots: Sequence[Recording]) -> list[Finding]:
    return [_of_imu(robots, channel, name) for channel, name in
            (("gyro", "delay of the gyro"), ("orientation", "delay of the orientation"))]  # fmt: skip


def _of_imu(robots: Sequence[Recording], channel: str, name: str) -> Finding:
    record = RECORD[f"sensor.{channel}_delay"]
    if all(one.rig.base == "fixed" for one in robots):
        return Finding(name, "no", "the trunk was held: its IMU does not move", record)
    free = [one for one in robots if one.rig.base != "fixed" and {"gyro", "orientation"} <= set(one.signals)]
    if not free:
        return Finding(name, "no", "gyro and orientation are needed on the ground, and a log lacks one", record)
    rate = max(float(np.sqrt(np.var(one.signals["gyro"].y, axis=0).sum())) for one in free)
    said = all(one.rig.base for one in free)
    verdict: Verdict = "yes" if rate >= _TURNS and said else "weak"
    reason = f"the trunk turns at {rate:.2f} rad/s (root mean square)"
    reason += "" if said else "; a log does not say whether it was held"
    return Finding(name, verdict, reason, "" if verdict == "yes" else record)


def _zeros(robots: Sequence[Recording]) -> Finding:
    on_ground = any(one.rig.base == "floating" and "orientation" in one.signals for one in robots)
    if on_ground:
        return Finding("joint zeros", "yes", "the robot stood, with its tilt measured")
    ways, apart = _ways(robots)
    if apart > _APART:
        reason = (
            f"held {ways} ways, up to {apart:.0f} deg apart; a joint whose load is balanced on its axis stays unknown"
        )
        return Finding("joint zeros", "yes", reason)
    reason = "gravity hardly turns yaw joints and feet of a robot that is held one way" + _held_or_unsaid(robots)
    return Finding("joint zeros", "weak", reason, RECORD["zero"])


def _ways(robots: Sequence[Recording]) -> tuple[int, float]:
    """Logs of a held trunk with its orientation, and the most that two of them are apart [deg]."""
    ups = [
        up_of(one.signals["orientation"].y).mean(axis=0)
        for one in robots
        if one.rig.base == "fixed" and "orientation" in one.signals
    ]
    if len(ups) < 2:
        return len(ups), 0.0
    directions = np.stack([up / np.linalg.norm(up) for up in ups])
    return len(ups), float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))


def _scales(robots: Sequence[Recording]) -> Finding:
    name, record = "scales of gain, damping and friction", RECORD["gain_scale"]
    travel = np.max([np.ptp(one.signals["position"].y, axis=0) for one in _alike(robots)], axis=0)
    moving, count = int((travel > _MOVES).sum()), travel.size
    verdict: Verdict = "no" if moving == 0 else "yes" if moving > count // 2 else "weak"
    reason = f"{moving} of {count} joints travel more than {_MOVES:g} rad"
    return Finding(name, verdict, reason, "" if verdict == "yes" else record)


def _trunk(robots: Sequence[Recording]) -> Finding:
    name = "mass and centre of the trunk (--free trunk)"
    if any(one.rig.base == "floating" for one in robots):
        return Finding(name, "yes", "the robot stood on the ground")
    return Finding(name, "no", f"a held trunk weighs nothing{_held_or_unsaid(robots)}", RECORD["mass_scale"])


def _held_or_unsaid(robots: Sequence[Recording]) -> str:
    return "" if all(one.rig.base for one in robots) else "; a log does not say whether it was"


def _alike(robots: Sequence[Recording]) -> list[Recording]:
    """Those with as many joints as the first."""
    count = len(robots[0].signals["position"].columns)
    return [one for one in robots if len(one.signals["position"].columns) == count]


def _period(one: Recording, name: str) -> float:
    t = one.signals[name].t
    return float(np.median(np.diff(t))) if t.size > 1 else float("inf")


def _goal_speed(one: Recording) -> float:
    goal = one.signals["goal"]
    if goal.t.size < 2:
        return 0.0
    columns = goal.y.reshape(goal.t.size, -1)
    return float(np.percentile(np.abs(np.diff(columns, axis=0) / np.diff(goal.t)[:, None]).max(axis=1), 99))


def _speed(one: Recording) -> float:
    return float(np.percentile(np.abs(one.signals["velocity"].y), 99.9))

"""Excitations, one a hold, that are long enough for what they are to tell, with what they will and will not tell.

Pieces: amplitudes within limits (`excitation_sizes`), predicted intervals (`excitation_information`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_hung import design
from frasa_sysid.excitation_information import PRIOR, Information, information, parameters_of_held, share_of
from frasa_sysid.excitation_sizes import fitted_sizes
from frasa_sysid.excitation_trial import Trial
from frasa_sysid.holds import UPRIGHT, part_seconds
from frasa_sysid.robot_body import Joints

LONGEST = 120.0  # [s]
# Half widths of a 95 % interval that are asked for, in the parameters' units.
WANTED: Mapping[str, float] = {
    "gain_scale": 0.05,
    "damping_scale": 0.05,
    "friction_scale": 0.1,
    "delay": 0.001,
    "velocity_delay": 0.001,
    "zero": float(np.radians(0.2)),
}
UNITS: Mapping[str, tuple[float, str]] = {
    "gain_scale": (1e2, "%"),
    "damping_scale": (1e2, "%"),
    "friction_scale": (1e2, "%"),
    "delay": (1e3, "ms"),
    "velocity_delay": (1e3, "ms"),
    "zero": (float(np.degrees(1.0)), "deg"),
}
NO_INFORMATION = {
    "sensor.position_delay": "only as a sum with the command delay, which <servo>.delay stands for here",
    "sensor.gyro_delay": "the trunk is held still; record a floating base too",
    "sensor.orientation_delay": "the trunk is held still; record a floating base too",
    "trunk.mass": "the hand holds it; record a floating base too",
}
Verdict = Literal["good", "weak", "not excited"]


@dataclass(frozen=True)
class Prediction:
    """What is expected of one parameter.

    Attributes:
        name: of the parameter.
        half_width: of its 95 % interval, in its unit.
        wanted: half width that is asked for.
        verdict: `good`, `weak` (wider than asked for), or `not excited` (hardly narrower than before any log).
        part: which part tells most of it, and in which hold.
    """

    name: str
    half_width: float
    wanted: float
    verdict: Verdict
    part: str


@dataclass(frozen=True)
class Plan:
    """Excitations and what they promise together.

    Attributes:
        excitations: goals, one set a hold.
        trials: torques and speeds of each on the nominal model.
        predictions: one for each parameter, from the logs of all holds.
        grown_from: duration that was tried first [s]; None if it was long enough.
    """

    excitations: tuple[Excitation, ...]
    trials: tuple[Trial, ...]
    predictions: tuple[Prediction, ...]
    grown_from: float | None


def chosen(joints: Joints, asked: Sequence[str]) -> tuple[str, ...]:
    """Parameters by name, or by field for all servos or joints; all of them when none is asked for.

    Raises:
        UsageError: a name that no held robot's log can tell, with the reason.
    """
    known = parameters_of_held(joints)
    found: list[str] = []
    for word in asked:
        if word in NO_INFORMATION:
            raise UsageError(f"{word}: a robot held by the trunk does not tell it: {NO_INFORMATION[word]}")
        matching = [name for name in known if word in (name, name.rpartition(".")[2])]
        if not matching:
            fields = ", ".join(WANTED)
            raise UsageError(f"unknown parameter '{word}': expected {fields}, or one of them as in {known[0]}")
        found += matching
    return tuple(dict.fromkeys(found)) or known


def plan(
    path: Path,
    joints: Joints,
    moving: Sequence[str],
    parameters: Sequence[str],
    seconds: float,
    holds: Sequence[str] = (UPRIGHT,),
    firmware_gain: float | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Plan:
    """Design excitations; make them longer where that brings a parameter within what is wanted.

    Args:
        path: nominal model.
        joints: of the model.
        moving: joints that may move.
        parameters: that must be told.
        seconds: duration to try first, of all holds together.
        holds: how the trunk is held, one log after the other.
        firmware_gain: P of the servos meanwhile; by default the model's own.
        progress: called with the share done.
    """
    first = _plan(path, joints, moving, seconds, holds, firmware_gain, progress)
    growth = max((_growth(one) for one in first.predictions if one.name in parameters), default=1.0)
    longer = min(seconds * growth, LONGEST)
    if longer < 1.05 * seconds:
        return first
    second = _plan(path, joints, moving, float(np.ceil(longer)), holds, firmware_gain, progress)
    return replace(second, grown_from=seconds)


def _growth(one: Prediction) -> float:
    """How much longer the log must be; 1 when long enough, or when no reasonable length would do."""
    factor = (one.half_width / one.wanted) ** 2
    return factor if 1.0 < factor <= 4.0 else 1.0


def _plan(
    path: Path,
    joints: Joints,
    moving: Sequence[str],
    seconds: float,
    holds: Sequence[str],
    firmware_gain: float | None,
    progress: Callable[[float], None],
) -> Plan:
    each, trying = part_seconds(seconds, holds), share_of(progress, 0, 2)
    excitations, trials = [], []
    for i, hold in enumerate(holds):
        sizes, trial = fitted_sizes(path, joints, each, share_of(trying, i, len(holds)), moving, hold, firmware_gain)
        excitations.append(design(joints, sizes, each, hold=hold, firmware_gain=firmware_gain))
        trials.append(trial)
    told = information(path, joints, excitations, share_of(progress, 1, 2))
    return Plan(tuple(excitations), tuple(trials), _predictions(told, excitations), None)


def _predictions(told: Information, excitations: Sequence[Excitation]) -> tuple[Prediction, ...]:
    parts = [f"{one.hold}: {part.name}" for one in excitations for part in one.parts]
    found = []
    for name, sd, share in zip(told.names, told.sd, told.shares.T, strict=True):
        field = name.rpartition(".")[2]
        half, wanted = 1.96 * float(sd), WANTED[field]
        blind = sd > 0.5 * PRIOR[field]
        verdict: Verdict = "not excited" if blind else "good" if half <= wanted else "weak"
        part = "-" if blind else parts[int(np.argmax(share))]
        found.append(Prediction(name, half, wanted, verdict, part))
    return tuple(found)

"""Excitations in files: MCAP (goals on /joint_command) and CSV (time [s], one column a joint [rad])."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration.files import write_atomic
from frasa_sysid.errors import LogError
from frasa_sysid.excitation import Excitation, Part
from frasa_sysid.holds import HOLDS, UPRIGHT
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Recording, RigFacts, Signal
from frasa_sysid.robot_truth import Base
from frasa_sysid.writer import write_mcap


def write_excitation(path: Path, excitation: Excitation, base: Base, made: Mapping[str, Any] | None = None) -> None:
    """Write an MCAP file of goals, one message every period; `made` is as for `write_mcap`.

    Raises:
        OSError: the file cannot be written.
    """
    goal = Signal("goal", "rad", excitation.t, excitation.goals, excitation.joints)
    extra = {
        "note": "goals to send to a robot, made by frasa-sysid excite; no robot was recorded",
        "hold": excitation.hold,
        "parts": [[part.name, part.start, part.end, part.purpose] for part in excitation.parts],
    }
    facts = RigFacts(
        firmware_gain=excitation.firmware_gain, trajectory="+".join(part.name for part in excitation.parts), base=base
    )
    goals = Recording(path.name, {"goal": goal}, facts, "simulated", path.name, "", "header", extra=extra)
    write_mcap(path, [goals], made=made)


def write_csv(path: Path, excitation: Excitation) -> None:
    """Write the same as text.

    Raises:
        OSError: the file cannot be written.
    """
    text = io.StringIO()
    header = ",".join(["time", *excitation.joints])
    table = np.column_stack([excitation.t, excitation.goals])
    np.savetxt(text, table, fmt="%.6f", delimiter=",", header=header, comments="")
    write_atomic(path, text.getvalue())


def read_excitation(path: Path) -> Excitation:
    """The goals of a file that `write_excitation` wrote, or of any log of a robot.

    Raises:
        LogError: not one recording with goals of several joints.
    """
    recordings = read_log(path, "auto")
    if len(recordings) != 1:
        raise LogError(f"{path}: expected one recording with goals, found {len(recordings)}")
    goal = recordings[0].signal("goal")
    if not goal.columns:
        raise LogError(f"{path}: its goals are of a single joint, expected a robot's")
    start = float(goal.t[0])
    parts = recordings[0].extra.get("parts") or [["goals", 0.0, float(goal.t[-1]) - start, "as in the file"]]
    try:
        named = tuple(Part(str(name), float(low), float(high), str(text)) for name, low, high, text in parts)
    except (TypeError, ValueError) as error:
        raise LogError(f"{path}: its list of parts cannot be understood: {error}") from error
    hold = str(recordings[0].extra.get("hold", UPRIGHT))
    if hold not in HOLDS:
        raise LogError(f"{path}: recorded for the hold {hold!r}; expected one of {', '.join(HOLDS)}")
    return Excitation(
        goal.columns, np.array(goal.t) - start, np.array(goal.y), named, hold, recordings[0].rig.firmware_gain
    )

"""Does the published robot do what the fit saw? Both simulated on a few pieces of the logs that were fitted.

The published model is simulated by the numbers read back from its own file, the fit by its own on the
frozen bench fits: two ways to the same motion that share the physics only.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from frasa_sysid.calibration import load_model
from frasa_sysid.claims import settle
from frasa_sysid.errors import QualityError
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_candidate import Candidate, candidate_of
from frasa_sysid.robot_compare import Contender, compare_runs, of_model
from frasa_sysid.robot_errors import Compared
from frasa_sysid.robot_fit import RobotFit, frozen_model
from frasa_sysid.robot_numbers import COMMAND_DELAY, makes
from frasa_sysid.robot_rig import RobotRun
from frasa_sysid.robot_simulator import Piece, split_pieces
from frasa_sysid.stored_fit import StoredFit
from frasa_sysid.stored_robot_fit import StoredRobotFit

TOLERANCE = 1e-4  # [rad] mean difference of joint positions
_EACH = 2  # pieces of a run; all share their numbers, so that more would say the same


def check_published_robot(
    published: Path,
    found: RobotFit,
    robot: StoredRobotFit,
    fits: Sequence[StoredFit],
    nominal: Path,
    threads: int | None = None,
) -> tuple[float, int]:
    """Mean difference of joint positions between the published model and the fit [rad], and pieces looked at.

    What the logs did not speak of, and publishing left as the bench fits say, is so on both sides.

    Args:
        published: the model file.
        found: the fit.
        robot: the same as it is stored.
        fits: bench fits that were published with it.
        nominal: the model that both started from.
        threads: by default one per core.

    Raises:
        QualityError: the difference is more than 0.1 mrad.
    """
    with tempfile.TemporaryDirectory() as folder:
        frozen = frozen_model(nominal, fits, Path(folder))
        fitted = Contender("fit", frozen, _as_published(found, robot, fits, frozen))
        seen = compare_runs(fitted, found.problem.runs, _few, threads)
        told = compare_runs(of_model("model", published), found.problem.runs, _few, threads)
    apart = np.concatenate([_positions(a) - _positions(b) for a, b in zip(seen, told, strict=True)])
    mean, count = float(np.mean(np.abs(apart))), sum(int(one.samples.piece.max()) + 1 for one in seen)
    if not mean <= TOLERANCE:
        raise QualityError(
            f"the published model replays the robot's logs {mean * 1e3:.3f} mrad on average away from the fit; "
            f"allowed are {TOLERANCE * 1e3:g} mrad. MuJoCo takes a delay below its step, "
            f"{found.timestep * 1e3:g} ms, for a whole one: if the cause is that, declare a "
            "--position-delay that leaves none so short"
        )
    return mean, count


def _as_published(found: RobotFit, robot: StoredRobotFit, fits: Sequence[StoredFit], frozen: Path) -> Candidate:
    """The fit, with what publishing leaves to the bench fits where the fit began."""
    kept = set(settle(fits, robot).kept)
    left = {free.name for free in found.problem.free if kept & set(makes(free.name, robot.published))}
    x = np.array(
        [free.start if free.name in left else value
         for free, value in zip(found.problem.free, found.settled.x, strict=True)]
    )  # fmt: skip
    one = found.problem.candidate(x)
    delays = candidate_of(load_model(frozen)).command_delays
    return replace(one, command_delays=delays) if COMMAND_DELAY in left else one


def _few(run: RobotRun, timestep: float) -> list[Piece]:
    """Pieces spread over a run."""
    pieces = split_pieces(run, timestep, 0.0)[0]
    return [pieces[i] for i in sorted({(2 * k + 1) * len(pieces) // (2 * _EACH) for k in range(_EACH)})]


def _positions(one: Compared) -> FloatArray:
    groups = [i for i, name in enumerate(one.layout.names) if name.startswith("position ")]
    return one.residuals[np.isin(one.layout.column, groups)]

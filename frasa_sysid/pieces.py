"""A bench run cut into pieces that start from measured states, and which pieces are of one log."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import START_SAMPLES, BenchRun

ONE_LOG = (
    "All pieces are of one log, so they were left out one by one; they share what is wrong in it, and the intervals "
    "are too narrow by that. Record a second log."
)


def in_pieces(runs: Sequence[BenchRun], seconds: float, timestep: float, first_log: int = 0) -> list[BenchRun]:
    """Whole runs cut into pieces that know their log; see `segments`.

    Args:
        runs: whole recordings.
        seconds: length of a piece [s], about.
        timestep: of the grid [s].
        first_log: number of the first one's log.
    """
    logs = enumerate(runs, first_log)
    return [replace(piece, log=log) for log, run in logs for piece in segments(run, seconds, timestep)]


def by_log(runs: Sequence[BenchRun]) -> list[list[int]]:
    """Which runs are of one log: indices, the logs in the order of their first run."""
    found: dict[int, list[int]] = {}
    for i, run in enumerate(runs):
        found.setdefault(run.log if run.log >= 0 else -1 - i, []).append(i)
    return list(found.values())


def independent(runs: Sequence[BenchRun]) -> list[list[int]]:
    """Which runs are left out or drawn together: those of one log, or each piece alone where there is only one log."""
    logs = by_log(runs)
    return logs if len(logs) > 1 else [[i] for i in range(len(runs))]


def count_of(runs: Sequence[BenchRun]) -> str:
    """How many logs, and how many pieces of them, in words."""
    logs = len(by_log(runs))
    words = f"{logs} run" if logs == 1 else f"{logs} runs"
    return words if logs == len(runs) else f"{words} in {len(runs)} pieces"


def one_log_in_pieces(runs: Sequence[BenchRun]) -> bool:
    """Whether there is no more than one log, so that its pieces stand for logs."""
    return len(runs) > 1 and len(by_log(runs)) == 1


def segments(run: BenchRun, seconds: float, timestep: float, lead: float = 0.1) -> list[BenchRun]:
    """A run cut into pieces that start from measured states: multiple shooting for what diverges.

    Args:
        run: a whole recording.
        seconds: length of a piece [s], about: all pieces of a run are equally long.
        timestep: of the grid [s].
        lead: commands kept before each start [s], for those that are still under way.
    """
    count = max(round(run.t[-1] / seconds), 1)
    edges = [int(np.searchsorted(run.t, i * run.t[-1] / count)) for i in range(count)] + [run.t.size - 1]
    pieces = [_piece(run, i, a, b, timestep, lead) for i, (a, b) in enumerate(pairwise(edges))]
    return [piece for piece in pieces if piece.t.size >= 3]


def _piece(run: BenchRun, index: int, first: int, last: int, timestep: float, lead: float) -> BenchRun:
    """Samples `first` to `last` as a run of its own; its grid starts at its first sample."""
    cell = int(run.step[first])
    shift = float(run.t[first]) - cell * timestep  # the piece's grid is the run's, moved by less than a step
    t = run.t[first : last + 1] - run.t[first]
    steps = int(np.ceil(t[-1] / timestep)) + 1
    before = min(round(lead / timestep), cell)
    share = shift / timestep
    padded = np.append(run.command, [run.command[-1], run.command[-1]])
    at = run.lead + cell - before + np.arange(before + steps)
    at = np.minimum(at, padded.size - 2)
    cells = np.minimum(np.floor(t / timestep), steps - 1)
    turns = run.switches - run.t[first]
    # A turn is late by the command delay as well: one just before the start may still be under way.
    early = int(np.count_nonzero(turns <= -before * timestep))
    # The segment's own first sample carries an encoder step of noise: its neighbours share it out.
    around = slice(max(first - START_SAMPLES // 2, 0), first + START_SAMPLES // 2 + 1)
    q0, dq0 = _local_state(run.t[around] - run.t[first], run.y[around])
    return replace(
        run,
        name=f"{run.name}@{index}",
        command=(1.0 - share) * padded[at] + share * padded[at + 1],
        lead=before,
        supply=run.supply[np.minimum(cell + np.arange(steps), run.supply.size - 1)],
        switches=turns[early:],
        powered_first=run.powered_first ^ bool(early % 2),
        q0=run.q0 if first == 0 else q0,
        dq0=run.dq0 if first == 0 else dq0,
        t=t,
        y=run.y[first : last + 1],
        step=cells,
        weight=t / timestep - cells,
        free_start=True,
    )


def _local_state(t: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Angle [rad] and speed [rad/s] at t = 0 from a parabola through the samples around it."""
    fitted = np.polynomial.Polynomial.fit(t, y, min(2, t.size - 1))
    return float(fitted(0.0)), float(fitted.deriv()(0.0))

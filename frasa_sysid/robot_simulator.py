"""Pieces of robot runs, simulated for many candidates by `mujoco.rollout` in its own threads.

A piece starts from the measured state, before the part that counts: what was wrong with the start has
died out by then, since position servos pull to where they are told. The command delay is that of
MuJoCo's own history (linear between the commands of two steps), done on the commands, so that states
stay small; delays here are physical, those of the model differ by half a step (`robot_fit`).
"""

import copy
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import TracebackType

import mujoco
import numpy as np
from mujoco import rollout

from frasa_sysid.calibration import load_model, trunk_of
from frasa_sysid.errors import LogError
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_body import bare
from frasa_sysid.robot_candidate import Candidate, Writer
from frasa_sysid.robot_rig import Base, RobotRun
from frasa_sysid.robot_settle import Settler
from frasa_sysid.robot_start import gravity_of, put_down, start_states

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
PIECE: dict[Base, float] = {"fixed": 2.0, "floating": 1.0}  # [s] compared; on the ground small errors grow
WARM: dict[Base, float] = {"fixed": 0.3, "floating": 0.1}  # [s] before, for the start's errors to die out
_SHORTEST = 0.2  # [s] of a piece
_JOBS = 64  # simulations in one call


@dataclass(frozen=True)
class Piece:
    """A part of a run.

    Attributes:
        run: whose.
        first: physics step at which the simulation starts.
        begin, end: steps between which it is compared.
    """

    run: RobotRun
    first: int
    begin: int
    end: int


def split_pieces(run: RobotRun, timestep: float, hold_out: float) -> tuple[list[Piece], list[Piece]]:
    """Pieces of a run to fit, and those of its last share that are held out.

    Raises:
        LogError: the run is too short for a piece.
    """
    pieces = pieces_of(run, timestep, PIECE[run.base], WARM[run.base])
    if pieces[0].end - pieces[0].begin < _SHORTEST / timestep:
        raise LogError(f"{run.name}: {run.steps * timestep:.2f} s; expected {WARM[run.base] + _SHORTEST:g} s or more")
    count = len(pieces) - round(hold_out * len(pieces))
    return pieces[:count], pieces[count:]


def pieces_of(run: RobotRun, timestep: float, seconds: float, warm: float) -> list[Piece]:
    """A run cut into pieces that are compared for some seconds each, after a warm-up [s]."""
    before = round(warm / timestep)
    count = max(round((run.steps - before) * timestep / seconds), 1)
    edges = np.linspace(before, run.steps - 1, count + 1).round().astype(int)
    return [Piece(run, int(a) - before, int(a), int(b)) for a, b in pairwise(edges)]


class RobotSimulator:
    """Simulates pieces of one robot's runs of one kind of base; use as a context manager, it owns threads.

    Args:
        model_path: the robot, frozen fits applied.
        base: `fixed`: the trunk stays where it is, away from the floor; or `floating`.
        threads: by default one per core.
    """

    def __init__(self, model_path: Path, base: Base, threads: int | None = None) -> None:
        self.base = base
        self.model = bare_model(model_path, base)
        self.trunk = trunk_of(self.model)
        self.writer = Writer(self.model)
        count = threads or len(os.sched_getaffinity(0))
        self._data = [mujoco.MjData(self.model) for _ in range(count)]
        self._rollout = rollout.Rollout(nthread=count)
        self._pool = [copy.copy(self.model) for _ in range(_JOBS)]
        self._settler = Settler(self.model, self.trunk, _JOBS) if base == "floating" else None

    def __enter__(self) -> "RobotSimulator":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._rollout.close()

    @property
    def timestep(self) -> float:
        """Physics step [s]."""
        return float(self.model.opt.timestep)

    def simulate(
        self, pieces: Sequence[Piece], candidates: Sequence[Candidate], ages: Candidate
    ) -> Iterator[tuple[int, int, FloatArray]]:
        """States of every piece for every candidate.

        Args:
            pieces: p of them.
            candidates: m of them.
            ages: whose ages of channels the measured states are taken with.

        Yields:
            Candidate, piece, and states (steps + 1, nq + nv), the start first; NaN once it diverged.
            Candidates that differ in ages only are one robot, simulated once and read several times.
        """
        robots: dict[str, list[int]] = {}
        for c, one in enumerate(candidates):
            robots.setdefault(repr(replace(one, ages={})), []).append(c)
        same = {members[0]: members for members in robots.values()}
        starts = [start_states(self.model, self.trunk, piece.run, piece.first, ages.ages) for piece in pieces]
        gravities = {piece.run.name: gravity_of(piece.run, self.model) for piece in pieces}
        pairs = [(c, p) for c in same for p in range(len(pieces))]
        pairs.sort(key=lambda pair: pieces[pair[1]].end - pieces[pair[1]].first)
        for i in range(0, len(pairs), _JOBS):
            batch = pairs[i : i + _JOBS]
            for first, p, states in self._batch(pieces, candidates, starts, gravities, batch):
                yield from ((c, p, states) for c in same[first])

    def _batch(
        self,
        pieces: Sequence[Piece],
        candidates: Sequence[Candidate],
        starts: Sequence[FloatArray],
        gravities: Mapping[str, FloatArray],
        batch: Sequence[tuple[int, int]],
    ) -> Iterator[tuple[int, int, FloatArray]]:
        steps = max(pieces[p].end - pieces[p].first for _, p in batch)
        commands = np.empty((len(batch), steps, self.model.nu))
        for model, row, (c, p) in zip(self._pool, commands, batch, strict=False):
            piece, one = pieces[p], candidates[c]
            for servo, actuators in self.writer.servos.items():
                delay = one.command_delays.get(servo, one.command_delay)
                # The torque of a step makes the speed of its middle, so it acts half a step early.
                late = delay / self.timestep + 0.5
                row[:, actuators] = delayed(piece.run.goal[:, actuators], piece.first, steps, late)
            supply = float(piece.run.supply[piece.first : piece.end + 1].mean())
            self.writer.write(model, one, supply, piece.run.firmware_gain)
            model.opt.gravity[:] = gravities[piece.run.name]
        state = np.zeros((len(batch), mujoco.mj_stateSize(self.model, _STATE)))
        state[:, 1 : 1 + self.model.nq + self.model.nv] = self._placed(candidates, starts, batch)
        models = self._pool[: len(batch)]
        paths, _ = self._rollout.rollout(models, self._data, state, commands)
        for (c, p), begin, path in zip(batch, state, paths, strict=True):
            count = pieces[p].end - pieces[p].first
            whole = np.vstack([begin, path[:count]])[:, : 1 + self.model.nq + self.model.nv]
            # MuJoCo resets a simulation that blew up, clock and all.
            expected = np.arange(count + 1) * self.timestep
            whole[np.abs(whole[:, 0] - expected) > 0.5 * self.timestep] = np.nan
            yield c, p, whole[:, 1:]

    def _placed(
        self, candidates: Sequence[Candidate], starts: Sequence[FloatArray], batch: Sequence[tuple[int, int]]
    ) -> FloatArray:
        """States to start from (jobs, nq + nv), on the ground each robot standing with its own zeros and trunk."""
        found = np.array([starts[p] for _, p in batch])
        if self._settler is None:
            return found
        nq = self.model.nq
        for model, row, (c, _) in zip(self._settler.statues, found, batch, strict=False):
            self.writer.write(model, candidates[c], self.writer.stated_supply, None)
            row[:nq] = put_down(model, self._data[0], self.trunk, row[:nq])
        return self._settler.settle(self._rollout, self._data, found[:, :nq], found[:, nq:])


def delayed(goal: FloatArray, first: int, steps: int, late: float) -> FloatArray:
    """Commands that act from step `first` on, `late` steps after they were given, shape (steps, J)."""
    whole = int(np.floor(late))
    part = late - whole
    at = np.arange(first, first + steps) - whole
    last = len(goal) - 1
    return np.asarray((1.0 - part) * goal[np.clip(at, 0, last)] + part * goal[np.clip(at - 1, 0, last)])


def bare_model(path: Path, base: Base) -> mujoco.MjModel:
    """The robot as it is simulated here, friction laws on; see `robot_body.bare`."""
    load_model(path)  # one clear line for what cannot be compiled; installs the friction law
    return bare(path, held=base == "fixed")

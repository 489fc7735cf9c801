"""Simulated minus measured, channel by channel, each in its own noise unit.

The noise unit of a column is what is left of it after the fit (robust), no less than its reading's step:
a robot's velocities are a hundred times noisier than its positions, and neither is told beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frasa_sysid.inspection import quantum
from frasa_sysid.recording import FloatArray, Recording
from frasa_sysid.robot_candidate import Candidate
from frasa_sysid.robot_rig import Channel
from frasa_sysid.robot_simulator import Piece, RobotSimulator

CORRELATION_TIME = 0.05  # [s] within which residuals of one column count as one sample
FASTEST = 200.0  # Hz; of a channel read faster every second sample is compared, or every third, ...: a tenth of
# the correlation time is close enough, and memory and time are what a kilohertz would cost
CLUSTER = 1.0  # [s]; residuals of one joint that are closer are not taken as independent evidence
# [s] for which an attitude filter's error lasts (a guess; noise units follow what is left): left in, it would hide the
# age of an orientation in a slow error that any quick motion tells apart.
MEMORY = {"orientation": 0.5}
DIVERGED = 10.0  # residual of a simulation that blew up, in the unit of its channel
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """Where the R residuals of a set of pieces stand.

    Attributes:
        column: noise group of each residual (channel and joint or axis), shape (R,).
        cluster: which second of which joint, shape (R,).
        names: of the noise groups, such as `position left_knee`.
        floors: smallest noise unit of each group.
        thinning: samples of each group within the correlation time.
        before: the residual one sample earlier in the same piece and group, -1 for none or no memory, shape (R,).
        memory: correlation with that one, shape (R,).
    """

    column: IntArray
    cluster: IntArray
    names: tuple[str, ...]
    floors: FloatArray
    thinning: FloatArray
    before: IntArray
    memory: FloatArray


@dataclass(frozen=True)
class Samples:
    """What the R residuals of a set of pieces are of.

    Attributes:
        t: stamps from the run's start [s], shape (R,).
        y: measured, tilt in place of an orientation, shape (R,).
        piece: which piece, shape (R,).
        run: which run of `names`, shape (R,).
        names: of the runs.
    """

    t: FloatArray
    y: FloatArray
    piece: IntArray
    run: IntArray
    names: tuple[str, ...]


def stride_of(t: FloatArray) -> int:
    """Of how many samples one is compared.

    Args:
        t: their times [s], shape (T,).
    """
    return max(1, round(1.0 / (FASTEST * float(np.median(np.diff(t)))))) if t.size > 1 else 1


def residual_count(recording: Recording, base: str | None = None) -> int:
    """How many residuals a recording gives at most.

    Args:
        recording: of a robot.
        base: where the log does not say.
    """
    names = ["position", "velocity"]
    names += [] if (base or recording.rig.base) == "fixed" else ["gyro", "orientation"]
    signals = [recording.signals[name] for name in names if name in recording.signals]
    return sum(one.y.size // stride_of(one.t) for one in signals)


class Comparison:
    """Residuals of pieces of runs of one kind of base.

    Args:
        simulator: simulates them.
        pieces: to compare on.
    """

    def __init__(self, simulator: RobotSimulator, pieces: Sequence[Piece]) -> None:
        self.simulator, self.pieces = simulator, list(pieces)
        self._address = simulator.model.jnt_qposadr[simulator.model.actuator_trnid[:, 0]]
        dof = simulator.model.jnt_dofadr[simulator.model.actuator_trnid[:, 0]]
        self._speed = simulator.model.nq + dof
        root = int(simulator.model.body_jntadr[simulator.trunk])
        if simulator.base == "floating":
            self._turn = simulator.model.jnt_qposadr[root] + np.arange(3, 7)
            self._rate = simulator.model.nq + simulator.model.jnt_dofadr[root] + np.arange(3, 6)
        self._windows = [self._window(piece) for piece in self.pieces]
        self._sizes = [sum(rows.size * width for _, rows, width in window) for window in self._windows]
        self.layout = self._lay_out()

    def _channels(self, piece: Piece) -> list[str]:
        names = ["position", "velocity"]
        names += ["gyro", "orientation"] if piece.run.base == "floating" else []
        return [name for name in names if name in piece.run.channels]

    def _window(self, piece: Piece) -> list[tuple[str, IntArray, int]]:
        """Channels, their samples within the piece, and how many residuals each sample gives."""
        step = self.simulator.timestep
        found = []
        for name in self._channels(piece):
            channel = piece.run.channels[name]
            rows = np.flatnonzero((channel.t >= piece.begin * step) & (channel.t < piece.end * step))
            rows = rows[:: stride_of(channel.t)]
            found.append((name, rows, 2 if name == "orientation" else channel.y.shape[1]))
        return found

    def _lay_out(self) -> Layout:
        names: dict[str, int] = {}
        clusters: dict[tuple[str, str, int], int] = {}
        columns, owners, befores, memories, count = [], [], [], [], 0
        floors: dict[int, float] = {}
        rates: dict[int, float] = {}
        for piece, window in zip(self.pieces, self._windows, strict=True):
            for name, rows, width in window:
                channel = piece.run.channels[name]
                labels = _labels(piece, name, channel, width)
                groups = [names.setdefault(f"{name} {label}", len(names)) for label in labels]
                for i, group in enumerate(groups):
                    floors[group] = _floor(channel, name, i)
                    rates[group] = _thinning(channel, name)
                seconds = (channel.t[rows] // CLUSTER).astype(int)
                keys = [[(piece.run.name, label, second) for label in labels] for second in seconds]
                owners.append([clusters.setdefault(key, len(clusters)) for row in keys for key in row])
                columns.append(np.tile(groups, rows.size))
                before, memory = _memory(channel.t[rows], width, MEMORY.get(name))
                befores.append(np.where(before >= 0, before + count, -1))
                memories.append(memory)
                count += memory.size
        order = range(len(names))
        return Layout(
            np.concatenate(columns).astype(np.int64),
            np.concatenate([np.array(one, np.int64) for one in owners]),
            tuple(names),
            np.array([floors[i] for i in order]),
            np.array([rates[i] for i in order]),
            np.concatenate(befores),
            np.concatenate(memories),
        )

    def residuals(self, candidates: Sequence[Candidate], centre: Candidate) -> FloatArray:
        """Simulated minus measured of m candidates, shape (m, R); a diverged piece counts as far away.

        Args:
            candidates: m of them.
            centre: whose ages of channels the pieces' starts are taken with.
        """
        starts = np.concatenate([[0], np.cumsum(self._sizes)])
        found = np.empty((len(candidates), int(starts[-1])))
        for c, p, states in self.simulator.simulate(self.pieces, candidates, centre):
            found[c, starts[p] : starts[p + 1]] = self._piece(p, states, candidates[c])
        return found

    def samples(self) -> Samples:
        """Times and measured values of the residuals, in their order."""
        times, values, names = [], [], tuple(dict.fromkeys(piece.run.name for piece in self.pieces))
        for piece, window in zip(self.pieces, self._windows, strict=True):
            for name, rows, width in window:
                channel = piece.run.channels[name]
                times.append(np.repeat(channel.t[rows], width))
                values.append(self._measured(name, channel, rows).ravel())
        owner = [names.index(piece.run.name) for piece in self.pieces]
        return Samples(
            np.concatenate(times),
            np.concatenate(values),
            np.repeat(np.arange(len(self.pieces)), self._sizes),
            np.repeat(np.array(owner, np.int64), self._sizes),
            names,
        )

    def _piece(self, p: int, states: FloatArray, one: Candidate) -> FloatArray:
        piece, parts = self.pieces[p], []
        for name, rows, _ in self._windows[p]:
            channel = piece.run.channels[name]
            times = channel.t[rows] - one.ages.get(name, 0.0) - piece.first * self.simulator.timestep
            parts.append((self._reading(name, states, times, channel) - self._measured(name, channel, rows)).ravel())
        return np.nan_to_num(np.concatenate(parts), nan=DIVERGED)

    def _reading(self, name: str, states: FloatArray, times: FloatArray, channel: Channel) -> FloatArray:
        if channel.joints.size:
            columns = (self._address if name == "position" else self._speed)[channel.joints]
        else:
            columns = self._rate if name == "gyro" else self._turn
        # Speeds are half a step older than the angles beside them (semi-implicit Euler).
        grid = times / self.simulator.timestep + (0.5 if name in ("velocity", "gyro") else 0.0)
        low = np.clip(np.floor(grid).astype(int), 0, len(states) - 2)
        part = (grid - low)[:, None]
        values = (1.0 - part) * states[low][:, columns] + part * states[low + 1][:, columns]
        return tilt(values) if name == "orientation" else np.asarray(values, np.float64)

    def _measured(self, name: str, channel: Channel, rows: IntArray) -> FloatArray:
        return tilt(channel.y[rows]) if name == "orientation" else np.asarray(channel.y[rows])


def tilt(quaternions: FloatArray) -> FloatArray:
    """Roll and pitch [rad] of quaternions w x y z, (T, 4) to (T, 2); where gravity is, whatever the heading."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return np.column_stack([roll, pitch])


def whitened(residuals: FloatArray, layout: Layout) -> FloatArray:
    """Residuals (..., R) of the same size, less what their channel's memory carries on from the sample before."""
    found = np.array(residuals)
    late = np.flatnonzero(layout.before >= 0)
    memory = layout.memory[late]
    found[..., late] -= memory * residuals[..., layout.before[late]]
    found[..., late] /= np.sqrt(1.0 - memory**2)
    return found


def noise_units(residuals: FloatArray, layout: Layout) -> FloatArray:
    """Robust size of each noise group's residuals, no less than its floor, shape (groups,)."""
    sizes = np.array([1.4826 * np.median(np.abs(residuals[layout.column == i])) for i in range(len(layout.names))])
    return np.asarray(np.maximum(sizes, layout.floors))


def _thinning(channel: Channel, name: str) -> float:
    period = stride_of(channel.t) * float(np.median(np.diff(channel.t)))
    return 1.0 if name in MEMORY else max(CORRELATION_TIME / period, 1.0)


def _memory(t: FloatArray, width: int, lasting: float | None) -> tuple[IntArray, FloatArray]:
    """Which residual comes before each of a window's and how much of it is left, for T samples of some width."""
    before, memory = np.full(t.size * width, -1, np.int64), np.zeros(t.size * width)
    if lasting is not None:
        before[width:] = np.arange((t.size - 1) * width)
        memory[width:] = np.repeat(np.exp(-np.diff(t) / lasting), width)
    return before, memory


def _labels(piece: Piece, name: str, channel: Channel, width: int) -> list[str]:
    if channel.joints.size:
        return [piece.run.joints[i] for i in channel.joints]
    return [f"{name}{i}" for i in range(width)]


def _floor(channel: Channel, name: str, i: int) -> float:
    """A third of a reading's step (that of uniform rounding), or a guess that no sensor of a robot beats."""
    least = {"position": 2e-4, "velocity": 5e-3, "gyro": 2e-3, "orientation": 5e-4}[name]
    if name == "orientation":
        return least
    step = quantum(channel.y[:, i])
    return max(least, 0.29 * step if step else 0.0)

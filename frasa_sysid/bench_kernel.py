"""Many candidates on many bench runs through the compiled kernel, in threads that hold no Python lock.

A `BenchKernel` is bound to its runs: their commands are laid out once, an evaluation then only
fills in numbers. Results do not depend on the number of threads: every lane is on its own.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid import kernel as k
from frasa_sysid.calibration import stepping
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import LOG2_LOG2_E
from frasa_sysid.calibration.kept_compiled import kept
from frasa_sysid.cost import robust_costs, rooted_residuals
from frasa_sysid.errors import ModelError
from frasa_sysid.kernel import LANES, ROWS, IntArray, simulate_blocks
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import drive_gain
from frasa_sysid.servo_values import COLUMN, FIELDS, NO_LIMIT

_PUNCH_WIDTH = 2.0 * np.pi / 4096  # [rad] one count: what the firmware can see as an error at all
_PARTS = 2  # pieces of work for each thread, for an even finish
_RECORD = np.dtype([(name, np.float64) for name in FIELDS])
_LAW = [COLUMN[name] for name in FRICTION_FIELDS[1:] if name not in ("stribeck_speed", "stribeck_exponent")]
_NEUTRAL = {
    "sag": 0.0,
    "follow": 0.0,
    "punch": 0.0,
    "dead_zone": 0.0,
    "collapse_to": 1.0,
    "bias": 0.0,
    "loop_lag": 0.0,
    "drag": 0.0,
}
_EFFECTS, _NO_EFFECTS = [COLUMN[name] for name in _NEUTRAL], np.array(list(_NEUTRAL.values()))
_UNLIMITED = 1e6  # [N m] torque limit of volts and forces, which have none


@dataclass(frozen=True)
class KernelOptions:
    """What the kernel takes from the bench model.

    Attributes:
        timestep: [s].
        creep: b of the friction constraint's reference acceleration [1/s].
        implicit: share of a step by which damping looks ahead: 1 as MuJoCo does by default, 0.5 for second order
            (trapezoidal stepping); friction then stops with the inertia of the step.
        early: share of a step by which a command acts before its time: a step's torque sets the speed of
            the step's middle. MuJoCo's own delay takes no account of it, so by default neither does this.
    """

    timestep: float
    creep: float
    implicit: float = 1.0
    early: float = 0.0


def kernel_options(model: mujoco.MjModel, timestep: float | None = None) -> KernelOptions:
    """Options of a one-joint bench model, if its equations are those of the kernel.

    Args:
        model: the compiled bench model.
        timestep: another step [s] than the model's, with friction that stops at once.

    Raises:
        ModelError: another integrator or solver option than the kernel's closed form holds for.
    """
    options = model.opt
    step = timestep or float(options.timestep)
    wrong = []
    if options.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        wrong.append("integrator is not Euler")
    trapezoidal = stepping.stepping_of(model) == stepping.TRAPEZOIDAL
    others = options.disableflags & ~int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    if others:
        wrong.append(f"disable flags {others} are set")
    if options.noslip_iterations < 1:
        wrong.append("noslip_iterations is 0, expected at least 1")
    time_constant, _ = model.dof_solref[0]
    if time_constant <= 0.0:
        wrong.append("solreffriction is in the direct format")
    if wrong:
        raise ModelError(f"the bench model does not step the kernel's equations: {'; '.join(wrong)}")
    width = float(model.dof_solimp[0, 1])
    if timestep is not None:
        # A step of one's own asks for physics, not for MuJoCo's: dry friction then stops the joint within
        # a step, and the trapezoidal rule for damping keeps the numbers from depending on the step.
        return KernelOptions(step, 1.0 / step, 0.5, 0.5)
    # MuJoCo keeps the time constant at two steps or more (refsafe).
    creep = 2.0 / (width * max(float(time_constant), 2.0 * step))
    return KernelOptions(step, creep, 0.5 if trapezoidal else 1.0)


class BenchKernel:
    """Simulates a set of bench runs.

    Args:
        runs: n prepared recordings, on the grid of `options.timestep`.
        options: see `kernel_options`.
        volt_scale: torque per volt [N m/V] for each N m/rad of kp (voltage benches).
        supply: at which kp is stated [V].
        pool: threads, shared between kernels.
        threads: how many of them.
    """

    def __init__(
        self,
        runs: Sequence[BenchRun],
        options: KernelOptions,
        volt_scale: float,
        supply: float,
        pool: ThreadPoolExecutor,
        threads: int,
    ) -> None:
        self.runs = list(runs)
        self.options = options
        self._pool, self._threads = pool, threads
        self._rigs = _rigs(runs, volt_scale, supply)
        self._start = _starts([run.steps for run in runs])
        self._samples = _starts([run.t.size for run in runs])
        self._fixed = (
            np.concatenate([run.command for run in runs]),
            _starts([run.command.size for run in runs]),
            np.array([run.lead for run in runs], np.int64),
            np.concatenate([run.supply for run in runs]),
            self._start,
            np.concatenate([run.switches for run in runs]),
            _starts([run.switches.size for run in runs]),
            np.array([run.powered_first for run in runs]),
            np.concatenate([run.step for run in runs]).astype(np.int64),
            np.concatenate([run.weight for run in runs]),
            self._samples,
        )
        self._y = np.concatenate([run.y for run in runs])

    @property
    def steps(self) -> int:
        """Physics steps of one candidate on all runs."""
        return int(self._start[-1])

    @property
    def size(self) -> int:
        """Measured samples of all runs, T."""
        return int(self._samples[-1])

    def readings(
        self, candidates: FloatArray, offsets: FloatArray | None = None, starts: FloatArray | None = None
    ) -> FloatArray:
        """Encoder readings [rad] of m candidates at the measured times of all runs, shape (m, T).

        Args:
            candidates: numbers in the order of `servo_values.FIELDS`, shape (m, fields).
            offsets: zero offset of each candidate's runs [rad], shape (m, n), beside the candidate's own.
            starts: what to add to angle and speed at each run's start, shape (m, n, 2).
        """
        m, n = len(candidates), len(self.runs)
        candidates = np.ascontiguousarray(candidates, np.float64)
        out = np.full((m, self.size), np.nan)
        if m == 0:
            return out
        lanes = self._lanes(m)
        blocks = -(-lanes.size // LANES)
        shape = (blocks, LANES)
        fill = np.full(blocks * LANES - lanes.size, lanes[-1])
        owner = np.concatenate([lanes % m, np.full(fill.size, -1)]).reshape(shape)
        pairs = np.concatenate([lanes, fill]).reshape(shape)
        w = np.empty((blocks, ROWS * LANES))
        q0, v0, offset, delay = np.empty((4, *shape))
        _fill_lanes(
            candidates.view(_RECORD)[:, 0],
            np.zeros((m, n)) if offsets is None else np.ascontiguousarray(offsets),
            np.zeros((m, n, 2)) if starts is None else np.ascontiguousarray(starts),
            pairs,
            self._rigs,
            self.options.timestep,
            self.options.creep,
            self.options.implicit * self.options.timestep,
            self.options.early,
            w,
            q0,
            v0,
            offset,
            delay,
        )
        law = bool(candidates[:, _LAW].any())
        effects = bool((candidates[:, _EFFECTS] != _NO_EFFECTS).any())
        arguments = (law, effects, self.options.timestep, w, q0, v0, offset, delay, pairs // m, owner, *self._fixed)
        self._share(blocks, lambda part: simulate_blocks(part, *arguments, out))
        return out

    def costs(self, candidates: FloatArray, offsets: FloatArray | None = None) -> FloatArray:
        """Robust cost of each candidate [rad], shape (m,), always finite."""
        readings = self.readings(candidates, offsets)
        costs = np.empty(len(candidates))
        self._share(len(candidates), lambda part: robust_costs(part, readings, self._y, self._samples, costs))
        return costs

    def rooted(
        self, candidates: FloatArray, offsets: FloatArray | None = None, starts: FloatArray | None = None
    ) -> FloatArray:
        """Vectors whose sum of squares is the robust cost (times twice the width), shape (m, T)."""
        readings = self.readings(candidates, offsets, starts)
        self._share(len(candidates), lambda part: rooted_residuals(part, readings, self._y, self._samples))
        return readings

    def split(self, row: FloatArray) -> list[FloatArray]:
        """One candidate's row of samples as an array for each run."""
        return np.split(row, self._samples[1:-1])

    def _lanes(self, m: int) -> IntArray:
        """Order of the pairs, run * m + candidate: long runs first, so that a block's lanes end together."""
        order = np.argsort(-np.diff(self._start), kind="stable")
        return np.asarray((order[:, None] * m + np.arange(m)).ravel(), np.int64)

    def _share(self, count: int, work: Callable[[IntArray], object]) -> None:
        """Do `count` pieces of work in the threads."""
        if count == 0:
            return
        if self._threads == 1 or count == 1:
            work(np.arange(count))
            return
        parts = min(count, _PARTS * self._threads)
        list(self._pool.map(work, [np.arange(i, count, parts) for i in range(parts)]))


@kept(nogil=True, error_model="numpy")
def _fill_lanes(
    candidates: Any,  # noqa: ANN401 (records have no type)
    offsets: FloatArray,
    starts: FloatArray,
    pairs: IntArray,
    rigs: Any,  # noqa: ANN401
    h: float,
    creep: float,
    ahead: float,
    early: float,
    w: FloatArray,
    q0: FloatArray,
    v0: FloatArray,
    offset: FloatArray,
    delay: FloatArray,
) -> None:
    """Write every lane's numbers, in the rows that the kernel reads, from its candidate and its run.

    Records of m `candidates` and of n `rigs` (`_rigs`), `offsets` and `starts` as in `BenchKernel.readings`, pairs
    run * m + candidate of each lane (blocks, 16), step h [s], `creep` [1/s] and how far damping looks
    `ahead` [s] and which share of a step commands act `early` give w (blocks, ROWS * 16), q0 [rad],
    v0 [rad/s], `offset` [rad] and `delay` [s] (blocks, 16).
    """
    m = len(candidates)
    for block in range(len(pairs)):
        for i in range(LANES):
            r, c = divmod(pairs[block, i], m)
            x, rig, lane = candidates[c], rigs[r], w[block, i:]
            zero = x.offset + offsets[c, r]
            offset[block, i], delay[block, i] = zero, x.delay + early * h
            q0[block, i], v0[block, i] = rig.q0 - zero + starts[c, r, 0], rig.dq0 + starts[c, r, 1]
            # Volts and torques meet no position error: nothing to track, to shift, to widen or to hold back.
            tracks = 1.0 - rig.absolute
            rest = 1.0 + x.rest * (rig.rest - 1.0)
            limit = x.forcerange * rig.force_scale * rest if tracks else _UNLIMITED
            stall = limit if tracks else rig.full * x.kp
            lane[k.GAIN], lane[k.LIMIT], lane[k.TRACK] = rig.gain * (x.kp if rig.has_kp else 1.0) * rest, limit, tracks
            lane[k.PART] = delay[block, i] / h - np.floor(delay[block, i] / h)
            lane[k.KEPT], lane[k.SHIFT] = 1.0 - lane[k.PART], -zero * tracks
            lane[k.GOAL_STEP] = x.goal_speed * h if x.goal_speed < 0.1 * NO_LIMIT else np.inf
            lane[k.MASS] = rig.inertia + x.armature
            lane[k.GRAVITY], lane[k.CREEP], lane[k.COULOMB] = -rig.gravity, creep, x.frictionloss
            lane[k.DAMPING_OFF], lane[k.BACK_ON] = x.damping_off, x.damping - x.damping_off
            lane[k.STRIBECK], lane[k.LOAD_M], lane[k.LOAD_E] = x.stribeck, x.load_motor, x.load_external
            lane[k.STATIC_M], lane[k.STATIC_E] = x.load_motor_stribeck, x.load_external_stribeck
            lane[k.QUAD_M], lane[k.QUAD_E], lane[k.EXPONENT] = x.quad_motor, x.quad_external, x.stribeck_exponent
            lane[k.FADE_SHIFT] = LOG2_LOG2_E - x.stribeck_exponent * np.log2(x.stribeck_speed)
            lane[k.SAG], lane[k.BACK_EMF] = x.sag / max(stall, 1e-9) ** 2, lane[k.BACK_ON]
            lane[k.FOLLOW], lane[k.BIAS], lane[k.STEEP] = x.follow, x.bias, 1.0 / _PUNCH_WIDTH
            lane[k.IMPLICIT], lane[k.SOLID], lane[k.AHEAD] = ahead, ahead if ahead < h else 0.0, early
            lane[k.DRAG] = x.drag
            lane[k.LAG] = x.loop_lag * tracks
            lane[k.PUNCH], lane[k.DEAD] = x.punch * tracks, x.dead_zone * tracks
            lane[k.COLLAPSE_AT], lane[k.COLLAPSE_TO] = x.collapse_at if tracks else np.inf, x.collapse_to


def _rigs(runs: Sequence[BenchRun], volt_scale: float, supply: float) -> npt.NDArray[np.void]:
    """What is constant in each run, as records: torque per command for each N m/rad of kp, at full supply, ..."""
    names = ("absolute", "has_kp", "gain", "force_scale", "full", "inertia", "gravity", "q0", "dq0", "rest")
    rows = []
    for run in runs:
        gain = drive_gain(1.0, run, volt_scale)
        command = (run.absolute, run.control != "force", gain, run.force_scale, supply * gain)
        rows.append((*command, run.inertia, run.gravity_torque, run.q0, run.dq0, run.rest))
    return np.array(rows, [(name, np.float64) for name in names])


def _starts(sizes: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

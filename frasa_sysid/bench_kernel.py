"""Many candidates on many bench runs through the compiled kernel, in threads that hold no Python lock.

A `BenchKernel` is bound to its runs: their commands are laid out once, an evaluation then only
fills in numbers. Results do not depend on the number of threads: every lane is on its own.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType

import mujoco
import numpy as np

from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.cost import robust_costs, rooted_residuals
from frasa_sysid.errors import ModelError
from frasa_sysid.kernel import LANES, ROWS, IntArray, simulate_blocks
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import drive_gain
from frasa_sysid.servo_values import COLUMN

_PUNCH_WIDTH = 2.0 * np.pi / 4096  # [rad] one count: what the firmware can see as an error at all
_LONGEST = 0.1  # share of all threads' work that one task may have, for an even finish
_UNLIMITED = 1e6  # [N m] torque limit of volts and forces, which have none


@dataclass(frozen=True)
class KernelOptions:
    """What the kernel takes from the bench model.

    Attributes:
        timestep: [s].
        creep: b of the friction constraint's reference acceleration [1/s].
    """

    timestep: float
    creep: float


def kernel_options(model: mujoco.MjModel, timestep: float | None = None) -> KernelOptions:
    """Options of a one-joint bench model, if its equations are those of the kernel.

    Args:
        model: the compiled bench model.
        timestep: another step [s] than the model's.

    Raises:
        ModelError: another integrator or solver option than the kernel's closed form holds for.
    """
    options = model.opt
    step = timestep or float(options.timestep)
    wrong = []
    if options.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        wrong.append("integrator is not Euler")
    if options.disableflags:
        wrong.append(f"disable flags {options.disableflags} are set")
    if options.noslip_iterations < 1:
        wrong.append("noslip_iterations is 0, expected at least 1")
    time_constant, _ = model.dof_solref[0]
    if time_constant <= 0.0:
        wrong.append("solreffriction is in the direct format")
    if wrong:
        raise ModelError(f"the bench model does not step the kernel's equations: {'; '.join(wrong)}")
    width = float(model.dof_solimp[0, 1])
    # MuJoCo keeps the time constant at two steps or more (refsafe).
    return KernelOptions(step, 2.0 / (width * max(float(time_constant), 2.0 * step)))


class BenchKernel:
    """Simulates a set of bench runs; use as a context manager, it owns threads.

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
        self._absolute = np.array([run.absolute for run in runs])
        self._gain = np.array([drive_gain(1.0, run, volt_scale) for run in runs])
        self._force = np.array([run.force_scale for run in runs])
        self._free_gain = np.array([run.control != "force" for run in runs])
        self._reference = supply * self._gain  # torque at full supply of voltage-driven runs, for each N m/rad of kp
        self._inertia = np.array([run.inertia for run in runs])
        self._gravity = np.array([run.gravity_torque for run in runs])
        self._q0 = np.array([run.q0 for run in runs])
        self._dq0 = np.array([run.dq0 for run in runs])
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
            self._absolute,
            np.concatenate([run.step for run in runs]).astype(np.int64),
            np.concatenate([run.weight for run in runs]),
            self._samples,
        )
        self._y = np.concatenate([run.y for run in runs])

    def __enter__(self) -> "BenchKernel":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is held; the pool belongs to whoever made it."""

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
        out = np.full((m, self.size), np.nan)
        if m == 0:
            return out
        lanes = self._lanes(m)
        candidate, run = lanes % m, lanes // m
        filled = -(-lanes.size // LANES) * LANES
        candidate = np.concatenate([candidate, np.repeat(candidate[-1:], filled - lanes.size)])
        run = np.concatenate([run, np.repeat(run[-1:], filled - lanes.size)])
        value = candidates[candidate].T
        offset = value[COLUMN["offset"]] + (offsets[candidate, run] if offsets is not None else 0.0)
        moved = starts[candidate, run] if starts is not None else np.zeros((filled, 2))
        blocks = filled // LANES
        shape = (blocks, LANES)
        owner = candidate.astype(np.int64)
        owner[lanes.size :] = -1
        arguments = (
            self.options.timestep,
            self._numbers(value, run).reshape(ROWS, blocks, LANES).transpose(1, 0, 2).reshape(blocks, ROWS * LANES),
            (self._q0[run] - offset + moved[:, 0]).reshape(shape),
            (self._dq0[run] + moved[:, 1]).reshape(shape),
            offset.reshape(shape),
            value[COLUMN["delay"]].reshape(shape),
            value[COLUMN["goal_speed"]].reshape(shape),
            value[COLUMN["follow"]].reshape(shape),
            run.astype(np.int64).reshape(shape),
            owner.reshape(shape),
            *self._fixed,
            out,
        )
        arguments = tuple(np.ascontiguousarray(one) if isinstance(one, np.ndarray) else one for one in arguments)
        self._share(blocks, lambda part: simulate_blocks(part, *arguments))
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

    def _numbers(self, value: FloatArray, run: IntArray) -> FloatArray:
        """The rows that the kernel reads, shape (ROWS, lanes)."""

        def of(name: str) -> FloatArray:
            return value[COLUMN[name]]

        absolute = self._absolute[run]
        gain = np.where(self._free_gain[run], of("kp"), 1.0) * self._gain[run]
        limit = np.where(absolute, _UNLIMITED, of("forcerange") * self._force[run])
        stall = np.where(absolute, self._reference[run] * of("kp"), limit)
        w = np.empty((ROWS, run.size))
        w[0], w[1], w[2] = gain, limit, self._gravity[run]
        w[3], w[4] = of("damping_off"), of("damping") - of("damping_off")
        w[5], w[6] = self._inertia[run] + of("armature"), self.options.creep
        w[7] = of("frictionloss")
        for row, name in enumerate(FRICTION_FIELDS[1:], start=8):
            w[row] = of(name)
        w[17] = of("sag") / np.maximum(stall, 1e-9) ** 2
        w[18], w[19], w[20] = of("punch"), 1.0 / _PUNCH_WIDTH, of("dead_zone")
        w[21], w[22] = np.where(absolute, 1e12, of("collapse_at")), of("collapse_to")
        w[18] = np.where(absolute, 0.0, w[18])
        w[20] = np.where(absolute, 0.0, w[20])
        w[23], w[24] = np.where(absolute, 0.0, 1.0), of("bias")
        return w

    def _share(self, count: int, work: Callable[[IntArray], object]) -> None:
        """Do `count` pieces of work in the threads."""
        if count == 0:
            return
        if self._threads == 1 or count == 1:
            work(np.arange(count))
            return
        parts = min(count, max(self._threads, round(self._threads / _LONGEST / 5)))
        list(self._pool.map(work, [np.arange(i, count, parts) for i in range(parts)]))


def _starts(sizes: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)



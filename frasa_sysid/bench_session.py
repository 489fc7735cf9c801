"""One bench with its equations and threads: what a fit simulates with, and MuJoCo itself to check it by."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

from frasa_sysid.bench_kernel import BenchKernel, KernelOptions, kernel_options
from frasa_sysid.calibration import load_model
from frasa_sysid.calibration.stepping import EULER, TRAPEZOIDAL
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.servo import Servo


class BenchSession:
    """Makes kernels for sets of runs; use as a context manager, it owns threads.

    Args:
        model_path: `robot_model/bench_pendulum.xml`.
        servo: with supply and gain at which kp is stated.
        threads: worker threads; by default one per core.
        timestep: a step of its own [s] in place of the model's.

    Attributes:
        options: of the kernel.
        publishable: whether the kernel steps what MuJoCo does, so that MuJoCo can replay the fit.
    """

    def __init__(
        self, model_path: Path, servo: Servo, threads: int | None = None, timestep: float | None = None
    ) -> None:
        self.model_path, self.servo = model_path, servo
        self.threads = threads or len(os.sched_getaffinity(0))
        model = load_model(model_path)
        self.options: KernelOptions = kernel_options(model, timestep)
        # A step of one's own means other equations, also where the step happens to be the model's.
        self.publishable = timestep is None
        self._pool = ThreadPoolExecutor(self.threads)

    def __enter__(self) -> "BenchSession":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to make its own; one thread there, as there are many of them."""
        kept = ("model_path", "servo", "options", "publishable")
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.threads = 1
        self._pool = ThreadPoolExecutor(1)

    @property
    def stepping(self) -> str:
        """How damping and friction are stepped, see `calibration.stepping`."""
        return TRAPEZOIDAL if self.options.implicit < 1.0 else EULER

    @property
    def volt_scale(self) -> float:
        """Torque per volt [N m/V] for each N m/rad of kp."""
        return 1.0 / (self.servo.error_gain * self.servo.firmware_gain * self.servo.supply_voltage)

    @cached_property
    def delay_range(self) -> tuple[float, float]:
        """Shortest and longest command delay that the bench model tells apart [s]; see `BenchSimulator`."""
        with self.mujoco() as simulator:
            shortest, longest = simulator.delay_range
        # With a step of its own the kernel is not held to what MuJoCo can tell apart.
        return (shortest if self.publishable else 0.0), longest

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the compiled model, and the kernel's options: what is simulated, whatever file it came from."""
        with self.mujoco() as simulator:
            return f"{simulator.fingerprint} {self.options!r}"

    def kernel(self, runs: Sequence[BenchRun]) -> BenchKernel:
        """The compiled simulation of some runs."""
        return BenchKernel(runs, self.options, self.volt_scale, self.servo.supply_voltage, self._pool, self.threads)

    def mujoco(self, law: bool = False) -> BenchSimulator:
        """The same bench through MuJoCo; `law` for friction beyond M1, evaluated at every step by a callback."""
        return BenchSimulator(self.model_path, self.volt_scale, self.threads, law)

    def split(self, kernel: BenchKernel, candidates: FloatArray) -> list[list[FloatArray]]:
        """Readings of each candidate as an array for each run [rad]."""
        return [kernel.split(row) for row in kernel.readings(candidates)]

"""The bench in MuJoCo itself, by `mujoco.rollout` on its own threads: `frasa_sysid.rollout.BenchSimulator`."""

from collections.abc import Callable, Sequence

from frasa_sysid.cost import misfit
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import BenchSimulator, ServoValues
from peers import Bench, Measured, timed

Simulate = Callable[[Sequence[BenchRun], Sequence[ServoValues]], list[list[FloatArray]]]


def simulator(bench: Bench, threads: int) -> BenchSimulator:
    """A simulator to use as a context manager."""
    servo = bench.servo
    stated = servo.error_gain * servo.firmware_gain * servo.supply_voltage
    return BenchSimulator(bench.model_path, 1.0 / stated, threads)


def measure(bench: Bench, threads: int) -> Measured:
    """Time the rollout of the nominal servo on all logs."""
    values = ServoValues(**bench.nominal)
    with simulator(bench, threads) as one:

        def evaluate() -> float:
            return misfit(bench.runs, one.simulate(bench.runs, [values])[0]).mae_rad

        timing = timed(evaluate)

    def again() -> float:
        with simulator(bench, threads) as other:
            return misfit(bench.runs, other.simulate(bench.runs, [values])[0]).mae_rad

    return Measured(timing, sum(run.steps for run in bench.runs), bench.seconds, again)

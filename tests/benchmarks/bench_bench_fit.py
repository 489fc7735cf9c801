"""What one evaluation of a bench fit costs: ours, BAM's equations in numpy, MuJoCo and mujoco.sysid, on the same logs.

The logs are the 96 of an STS3215 among other people's logs (not part of this repository: give their folder, or put it
at ../shared/data); without them, the project's own simulated ones of the MX-106. Steps differ (BAM's are 5 ms, MuJoCo's
2 ms), so ratios compare the cost per second of log.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
from bench_real_servos import CASES, ROOT, run
from peers import Bench, Measured, bam_numpy, mujoco_rollout, mujoco_sysid, timed

from frasa_sysid.bench_kernel import BenchKernel
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.choice import choose
from frasa_sysid.cost import misfit
from frasa_sysid.fit import fit, ladder
from frasa_sysid.problem import FitProblem, state_problem, stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.rig import BenchRun, runs_of
from frasa_sysid.rollout import BenchSimulator
from frasa_sysid.servo_values import COLUMN, ServoValues
from frasa_sysid.spread import Spread

MODEL = ROOT / "robot_model" / "bench_pendulum.xml"
THREADS = (1, 2)
TOGETHER = 16  # candidates at once: about a generation of CMA-ES
LOGS = (1, 10, 96, 960)
# Numbers beyond the nominal M1 for the time of a law; any others would take as long.
LOADED = {"load_motor": 0.1, "load_external": 0.1, "load_motor_stribeck": 0.05, "load_external_stribeck": 0.05}
STRIBECK = {"stribeck": 0.05, "stribeck_speed": 1.5, "stribeck_exponent": 1.3}
LAW_VALUES: dict[str, dict[str, float]] = {
    "m1": {},
    "m4": {**STRIBECK, **LOADED},
    "m6": {**STRIBECK, **LOADED, "quad_motor": 0.01, "quad_external": 0.02},
}
Readings = list[list]  # [candidate][run] -> angles [rad] at the run's measured times
Simulate = Callable[[Sequence[BenchRun], Sequence[ServoValues]], Readings]
# Gives the simulation with so many threads, or None where it cannot use them.
Backend = Callable[[Bench, int], AbstractContextManager[Simulate | None]]


@contextmanager
def ours(bench: Bench, threads: int) -> Iterator[Simulate | None]:
    """The compiled kernel; a fit lays its logs out once, so here that is not part of an evaluation either."""
    kernels: dict[int, BenchKernel] = {}
    with BenchSession(bench.model_path, bench.servo, threads, bench.timestep) as session:

        def simulate(runs: Sequence[BenchRun], candidates: Sequence[ServoValues]) -> Readings:
            if id(runs) not in kernels:
                kernels[id(runs)] = session.kernel(runs)
            return session.split(kernels[id(runs)], np.array([values.array() for values in candidates]))

        yield simulate


def measure_ours(bench: Bench, law: str, threads: int, candidates: int) -> Measured:
    """Time our objective, the robust cost; servos differ, so that no two lanes do the same."""
    values = np.array([ServoValues(**{**bench.nominal, **LAW_VALUES[law]}).array()] * candidates)
    values[:, COLUMN["kp"]] *= np.linspace(1.0, 1.1, candidates)
    with BenchSession(bench.model_path, bench.servo, threads, bench.timestep) as session:
        kernel = session.kernel(bench.runs)
        timing = timed(lambda: kernel.costs(values)).per(candidates)
        error = misfit(bench.runs, kernel.split(kernel.readings(values)[0])).mae_rad
    return Measured(timing, kernel.steps, bench.seconds, lambda: error)


@contextmanager
def mujoco(bench: Bench, threads: int) -> Iterator[Simulate | None]:
    with mujoco_rollout.simulator(bench, threads) as one:
        yield one.simulate


@contextmanager
def numpy_bam(bench: Bench, threads: int) -> Iterator[Simulate | None]:
    prepared: dict[int, bam_numpy.BamLogs] = {}

    def simulate(runs: Sequence[BenchRun], candidates: Sequence[ServoValues]) -> Readings:
        if id(runs) not in prepared:
            prepared[id(runs)] = bam_numpy.resample(runs, bench.servo, bench.timestep)
        servos = [bam_numpy.stated(bench.servo, values) for values in candidates]
        angles = bam_numpy.simulate(prepared[id(runs)], servos, "m1")  # on its own 5 ms grid
        return [list(one.T) for one in angles]

    # One thread: numpy's loops hold the interpreter.
    yield simulate if threads == 1 else None


def load(data: Path) -> tuple[str, Bench]:
    case = next(case for case in CASES if case.folder == "sts3215")
    sources = [str(path) for path in sorted((data / case.folder).glob(case.pattern))]
    if not sources:
        return "bench_logs/mx106.mcap", bench_of("mx106", [ROOT / "bench_logs" / "mx106.mcap"])
    with tempfile.TemporaryDirectory() as folder:
        extra = [str(data / word) if word.endswith(".csv") else word for word in case.extra]
        run("import", *sources, "--format", case.form, "--out", folder, *extra)
        return "sts3215", bench_of("sts3215", sorted(Path(folder).glob("*.mcap")))


def bench_of(name: str, paths: Sequence[Path]) -> Bench:
    servo, nominal = stated_servo(name, ROOT / "robot_model" / "nominal.xml")
    with BenchSimulator(MODEL, 1.0, 1) as simulator:
        timestep = simulator.timestep
    runs = runs_of([recording for path in paths for recording in read_log(path)], servo, timestep)
    return Bench(tuple(runs), servo, nominal, timestep, MODEL)


def peers(bench: Bench) -> Iterator[tuple[str, Measured]]:
    for law in LAW_VALUES:
        for threads in THREADS:
            for candidates in (1, TOGETHER):
                yield label(f"ours, {law}", threads, candidates), measure_ours(bench, law, threads, candidates)
    for law in LAWS:
        yield label(f"BAM in numpy, {law}", 1, 1), bam_numpy.measure(bench, law)
    for law in ("m1", "m4"):
        yield label(f"BAM in numpy, {law}", 1, TOGETHER), bam_numpy.measure(bench, law, TOGETHER)
    for threads in THREADS:
        yield label("MuJoCo rollout, m1", threads, 1), mujoco_rollout.measure(bench, threads)
    if mujoco_sysid.MISSING:
        return
    columns = 9  # of its finite differences: all it ever runs together
    for threads in THREADS:
        for candidates in (1, columns):
            yield label("mujoco.sysid, m1", threads, candidates), mujoco_sysid.measure(bench, threads, candidates)


def label(name: str, threads: int, candidates: int) -> str:
    return f"{name:<22}{threads:>5}{candidates:>6}"


def costs(bench: Bench) -> None:
    rows = list(peers(bench))
    reference = rows[0][1].timing.fastest / rows[0][1].seconds
    print(f"\n{'one evaluation':<22}{'thr.':>5}{'cand.':>6}{'log-steps':>11}{'fastest':>11}{'median':>11}"
          f"{'log-step':>11}{'s of log':>11}{'ratio':>9}{'MAE':>12}")  # fmt: skip
    for name, one in rows:
        time, each = one.timing, one.timing.fastest / one.seconds
        print(f"{name}{one.log_steps:>11}{time.fastest * 1e3:>8.2f} ms{time.median * 1e3:>8.2f} ms"
              f"{time.fastest / one.log_steps * 1e9:>8.1f} ns{each * 1e6:>8.2f} us{each / reference:>9.2f}"
              f"{one.evaluate() * 1e3:>7.2f} mrad", flush=True)  # fmt: skip
    print("Times of one candidate on all logs; ratio of time per second of log, to the first row.")
    if mujoco_sysid.MISSING:
        print(f"mujoco.sysid is skipped: {mujoco_sysid.MISSING}")


def fits(bench: Bench) -> None:
    print(f"\n{'fit of the M1 numbers by mujoco.sysid':<40}{'evaluations':>12}{'time':>9}{'nominal':>14}{'fitted':>14}")
    if mujoco_sysid.MISSING:
        print(f"skipped: {mujoco_sysid.MISSING}")
        return
    for name, (optimizer, settings) in mujoco_sysid.SETTINGS.items():
        done = mujoco_sysid.fit(bench, max(THREADS), optimizer, settings)
        print(f"{name:<40}{done.evaluations:>12}{done.seconds:>7.0f} s{done.nominal_mae * 1e3:>9.2f} mrad"
              f"{done.mae * 1e3:>9.2f} mrad")  # fmt: skip
        print("   " + ", ".join(f"{key} {value:.4g}" for key, value in done.values.items()), flush=True)


def our_fits(bench: Bench) -> None:
    """Time to our converged fits, and to the choice among all six laws by held-out runs."""
    print(f"\n{'our fits, ' + str(max(THREADS)) + ' threads':<40}{'evaluations':>12}{'time':>9}{'fitted':>14}")
    quiet = lambda *_: None  # noqa: E731
    with BenchSession(bench.model_path, bench.servo, max(THREADS)) as session:
        limits = session.delay_range

        def stated(law: str) -> FitProblem:
            return state_problem(bench.servo, bench.nominal, bench.runs, (), limits, "none", 0, law)

        for law in ("m1", "m4", "m6"):
            started = time.perf_counter()
            done = fit(stated(law), session, {})
            print(f"{law + ', 3 searches, evidence':<40}{done.evaluations:>12}{time.perf_counter() - started:>7.1f} s"
                  f"{done.fitted.mae_rad * 1e3:>9.2f} mrad", flush=True)  # fmt: skip
        started = time.perf_counter()
        found = ladder(stated("m1"), session, LAWS, None, None, quiet)
        used = sum(solved.evaluations for _, solved in found.values())
        print(f"{'all six laws':<40}{used:>12}{time.perf_counter() - started:>7.1f} s", flush=True)
        started = time.perf_counter()
        chosen = choose(stated("m1"), session, LAWS, (), Spread(), quiet)
        print(f"{'all six laws, held-out folds, choice':<40}{'':>12}{time.perf_counter() - started:>7.1f} s"
              f"  takes {chosen.problem.law}", flush=True)  # fmt: skip


def scaling(bench: Bench) -> None:
    backends: dict[str, Backend] = {"ours": ours, "BAM in numpy": numpy_bam, "MuJoCo rollout": mujoco}
    values = [ServoValues(**bench.nominal)]
    print(f"\n{'cost of one candidate':<22}{'thr.':>5}" + "".join(f"{f'{count} logs':>27}" for count in LOGS))
    for name, backend in backends.items():
        for threads in THREADS:
            cells = []
            for count in LOGS:
                runs = tuple(bench.runs[i % len(bench.runs)] for i in range(count))
                with backend(bench, threads) as simulate:
                    if simulate is None:
                        continue
                    cost = timed(lambda: simulate(runs, values), least=3 if count < 960 else 1).fastest  # noqa: B023
                each = cost / sum(float(one.t[-1]) for one in runs)
                cells.append(f"{cost * 1e3:>9.2f} ms{each * 1e6:>9.2f} us/s")
            if cells:
                print(f"{name:<22}{threads:>5}" + "".join(f"{cell:>27}" for cell in cells), flush=True)
    print("The fastest of a few; us/s is microseconds per second of log. Logs beyond those there are repeat.")


def main() -> int:
    parser = argparse.ArgumentParser(description="Cost of one evaluation of a bench fit, ours against others.")
    parser.add_argument("data", nargs="?", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--no-fit", action="store_true", help="leave out the minutes that mujoco.sysid fits")
    given = parser.parse_args()
    name, bench = load(given.data)
    print(f"{name}: {len(bench.runs)} logs, {bench.seconds:.0f} s of log; {os.cpu_count()} cores, "
          f"load before the start {os.getloadavg()[0]:.1f}")  # fmt: skip
    costs(bench)
    our_fits(bench)
    scaling(bench)
    if not given.no_fit:
        fits(bench)
    return 0


if __name__ == "__main__":
    sys.exit(main())

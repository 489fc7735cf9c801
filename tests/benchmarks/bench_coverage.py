"""Known truth: 100 simulated benches with random servos, loads, jitter, quantization, delay and sag.

    python tests/benchmarks/bench_coverage.py [BENCHES] [JOBS] [--json FILE]

Each bench is simulated by `frasa_sysid.simulate` (5 kHz physics, 1 kHz firmware, equations of its own)
and fitted by the compiled kernel at a step of 0.25 ms. Printed, over all benches: the error of every
identified parameter, how often 95 % intervals hold the truth (also of those known roughly), the delay's
error, and, on benches that were made poor on purpose (no torque-off run, or one gain, one load and slow
motion only), whether what cannot be known is called so.
"""

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np

from frasa_sysid import simulate
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.friction import LAWS, Friction
from frasa_sysid.evidence import IDENTIFIED, ROUGH
from frasa_sysid.fit import fit
from frasa_sysid.problem import state_problem
from frasa_sysid.rig import runs_of
from frasa_sysid.servo import PUBLISHED_M4, Servo, servo
from frasa_sysid.simulate import simulate_bench
from frasa_sysid.simulated_bench import Bench

MODEL = Path(__file__).parents[2] / "robot_model" / "bench_pendulum.xml"
STEP = 0.00025  # [s] of the fit
LOADS = (
    "load_motor", "load_external", "load_motor_stribeck", "load_external_stribeck", "quad_motor", "quad_external"
)  # fmt: skip
TOLERANCE = {"delay": 0.1, "offset": 1.0}  # [ms], [mrad]; 3 % for all others
POOR = {"no_torque_off": ("lift_and_drop",), "slow_only": ("lift_and_drop", "sin_time_square", "sin_sin")}


def random_bench(seed: int) -> tuple[Servo, Bench, str]:
    """A servo within 30 % of a published one, with a law of its own, on a random bench."""
    rng = np.random.default_rng((seed, 2024))
    law = LAWS[seed % len(LAWS)]
    near = lambda value, spread=0.3: float(value * np.exp(rng.uniform(-spread, spread)))  # noqa: E731
    base = PUBLISHED_M4[("mx106", "mx64")[(seed // len(LAWS)) % 2]]
    viscous, coulomb = near(0.03, 0.7), near(0.07, 0.5)
    extra = {}
    if law not in ("m1", "m3"):
        extra |= {"stribeck": near(0.06, 0.5), "stribeck_speed": near(1.0, 0.5), "stribeck_exponent": near(1.3, 0.2)}
    if law not in ("m1", "m2"):
        share = near(0.08, 0.5)
        extra |= {"load_motor": share, "load_external": near(0.08, 0.5) if law in ("m5", "m6") else share}
    if law in ("m4", "m5", "m6"):
        share = near(0.12, 0.5)
        apart = law in ("m5", "m6")
        extra |= {"load_motor_stribeck": share, "load_external_stribeck": near(0.12, 0.5) if apart else share}
    if law == "m6":
        limit = base.force_limit()
        extra |= {"quad_motor": near(0.1 / limit, 0.5), "quad_external": near(0.1 / limit, 0.5)}
    one = replace(
        base,
        kt=near(base.kt),
        R=near(base.R),
        armature=near(base.armature),
        friction=Friction(viscous, coulomb, **extra),
    )
    scale = one.force_limit() / base.force_limit()
    bench = Bench(
        loads=tuple((near(mass * scale, 0.2), length) for mass, length in ((0.5, 0.12), (1.0, 0.15), (1.6, 0.15))),
        gains=(8.0, 16.0, 32.0),
        arm_mass=0.036,
        supply_voltage=15.0,
        supply_resistance=float(rng.uniform(0.05, 0.4)),
        command_delay=float(rng.uniform(0.003, 0.02)),
        zero_offset=float(rng.uniform(-0.03, 0.03)),
        seed=seed,
    )
    return one, bench, law


def firmware_wait(bench: Bench) -> float:
    """Mean time [s] from a command's arrival to the firmware's next tick, over the commands of the bench."""
    period = simulate.FIRMWARE_STEPS * simulate.PHYSICS_DT
    arrivals = np.concatenate(simulate._read_times(bench, 36)) + bench.command_delay
    return float(np.mean(np.ceil(arrivals / period - 1e-6) * period - arrivals))


def truth(one: Servo, bench: Bench) -> dict[str, float]:
    """True values by the fit's parameter names."""
    name, friction = one.name, one.friction
    found = {
        "kp": one.kp(),
        "forcerange": one.force_limit(),
        "damping": one.damping(),
        "damping_off": friction.viscous,
        "frictionloss": friction.coulomb,
        "armature": one.armature,
        # The torque of a step sets the speed of the step's middle, so it acts half a step early.
        "delay": bench.command_delay + firmware_wait(bench) - simulate.PHYSICS_DT / 2.0,
        "stribeck": friction.stribeck,
        "stribeck_speed": friction.stribeck_speed,
        "stribeck_exponent": friction.stribeck_exponent,
        **{field: getattr(friction, field) for field in LOADS},
    }
    return {f"{name}.{field}": value for field, value in found.items()} | {"bench.offset": bench.zero_offset}


def study(seed: int, poor: str | None) -> dict[str, object]:
    """One bench simulated and fitted: value, interval, verdict and truth of every parameter."""
    # Four times finer than for the stored logs: the truth should not have a step either.
    simulate.PHYSICS_DT, simulate.FIRMWARE_STEPS = 5e-5, 20
    one, bench, law = random_bench(seed)
    recordings = simulate_bench(one, bench, f"bench{seed}")
    if poor is not None:
        recordings = [record for record in recordings if record.rig.trajectory not in POOR[poor]]
    if poor == "slow_only":
        recordings = [r for r in recordings if r.rig.firmware_gain == 32.0 and r.rig.mass == recordings[0].rig.mass]
    known = replace(servo(one.name), supply_voltage=15.0, firmware_gain=12.0)
    law_zero = {name: 0.0 for name in ("stribeck", *LOADS)}
    nominal = {
        "kp": known.kp(), "forcerange": known.force_limit(), "damping": known.damping(), "delay": 0.0, "offset": 0.0,
        "frictionloss": known.friction.coulomb, "armature": known.armature, "damping_off": known.friction.viscous,
        **law_zero,
    }  # fmt: skip
    with BenchSession(MODEL, known, 1, STEP) as session:
        runs = runs_of(recordings, known, STEP)
        problem = state_problem(known, nominal, runs, (), (0.0, 0.04), "none", seed, law, ("sag", "loop"))
        result = fit(problem, session, {}, restarts=2)
    true = truth(one, bench)
    rows = [
        {"name": e.name.partition(".")[2], "value": e.value, "low": e.low, "high": e.high, "verdict": e.verdict,
         "true": true[e.name]}
        for e in result.evidence.estimates
        if e.name in true
    ]  # fmt: skip
    return {"seed": seed, "law": law, "poor": poor, "mae_mrad": result.fitted.mae_rad * 1e3, "parameters": rows}


def show(studies: list[dict[str, object]]) -> None:
    """Print what came out, parameter by parameter."""
    rows = defaultdict(list)
    for one in studies:
        for row in one["parameters"]:
            rows[row["name"]].append(row)
    print(f"{len(studies)} benches, mean error {np.mean([one['mae_mrad'] for one in studies]):.2f} mrad")
    print(f"{'parameter':22s} identified  roughly  median error  95 % of errors  worst   coverage of 95 % intervals")
    inside = total = beyond = count = 0
    for name, found in rows.items():
        good = [row for row in found if row["verdict"] == IDENTIFIED]
        scale = 1e-3 if name in ("delay", "offset") else None
        errors = np.array([abs(row["value"] - row["true"]) / (scale or max(abs(row["true"]), 1e-12)) for row in good])
        known = [row for row in found if row["verdict"] in (IDENTIFIED, ROUGH)]
        held = [row["low"] <= row["true"] <= row["high"] for row in known]
        inside, total = inside + sum(held), total + len(held)
        unit = "ms/mrad" if scale else "%"
        factor = 1.0 if scale else 100.0
        beyond += int(np.sum(errors > TOLERANCE.get(name, 0.03)))
        count += len(good)
        q = np.quantile(errors * factor, (0.5, 0.95, 1.0)) if good else np.full(3, np.nan)
        share = 100.0 * float(np.mean(held)) if held else float("nan")
        print(
            f"{name:22s} {len(good):4d} of {len(found):3d}  {len(known) - len(good):7d}  {q[0]:8.3f} {unit:8s} "
            f"{q[1]:8.3f}  {q[2]:8.3f}   {share:5.1f} %"
        )
    print(f"identified: {beyond} of {count} are off by more than 3 %, or 0.1 ms (delay) or 1 mrad (offset)")
    print(f"all that are known: {inside} of {total} intervals hold the truth, {100 * inside / total:.1f} %")


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("benches", nargs="?", type=int, default=100)
    parser.add_argument("jobs", nargs="?", type=int, default=2)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    work = joblib.Parallel(n_jobs=args.jobs, verbose=1)
    studies = work(joblib.delayed(study)(seed, None) for seed in range(args.benches))
    for law in LAWS:
        print(f"\n== {law}")
        show([one for one in studies if one["law"] == law])
    print("\n== all")
    show(studies)
    poor = work(joblib.delayed(study)(seed, kind) for kind in POOR for seed in range(max(args.benches // 10, 2)))
    for kind in POOR:
        verdicts = defaultdict(list)
        for one in poor:
            for row in one["parameters"] if one["poor"] == kind else ():
                wrong = not row["low"] <= row["true"] <= row["high"]
                verdicts[row["name"]].append((row["verdict"].split(" with ")[0], wrong))
        print(f"\n== {kind}: verdicts, and how many intervals miss the truth")
        for name, found in verdicts.items():
            counts = {verdict: sum(v == verdict for v, _ in found) for verdict in sorted({v for v, _ in found})}
            missed = sum(w for v, w in found if v in (IDENTIFIED, ROUGH))
            print(f"{name:22s} {counts}, known and wrong: {missed}")
    if args.json:
        args.json.write_text(json.dumps({"studies": studies, "poor": poor}, indent=1))


if __name__ == "__main__":
    main()

"""Real logs, every friction law, held out by rig, gain and trajectory: errors in mrad with 95 % intervals.

    python tests/benchmarks/bench_real_laws.py DATA [CASE ...]

DATA is the folder of real logs; sets that are not there are skipped with a word. Effects are those that
`--effects auto` takes on these logs (or, where too few runs are there to choose, those named here).
Every number is of a fit that never saw the held-out runs; the interval is that of the mean over them.
"""

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from frasa_sysid.bench import Bench
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.cost import Misfit
from frasa_sysid.fit import ladder, misfits
from frasa_sysid.hold_out import split
from frasa_sysid.problem import state_problem, stated_servo
from frasa_sysid.readers import read_log

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Case:
    """A set of logs and what is held out of it."""

    folder: str
    form: str
    servo: str
    rules: tuple[str, ...]
    effects: tuple[str, ...] = ()
    source: str = "."
    first: float | None = None
    facts: tuple[tuple[str, float], ...] = ()


CASES = {
    "sts3215": Case("sts3215", "bam", "sts3215", ("mass=0.969", "kp=24", "trajectory=sin_sin"), ("profile",)),
    "sts3215_none": Case("sts3215", "bam", "sts3215", ("mass=0.969",)),
    "xl330": Case("xl330", "bam", "xl330", ("kp=400", "trajectory=sin_sin"), ("sag", "supply")),
    "xl330_none": Case("xl330", "bam", "xl330", ("kp=400",)),
    "sts3250": Case("sts3250_bam", "bam", "sts3250", ("trajectory=sin_sin", "trajectory=up_and_down")),
    "dynaban": Case("mx64_dynaban", "dynaban", "mx64", ("none", "trajectory=steps"), ("drag",), "completeTest.gz"),
    "dynaban_150ms": Case(
        "mx64_dynaban", "dynaban", "mx64", ("none", "trajectory=steps"), ("drag",), "completeTest.gz", 0.15
    ),
    "jandi": Case("mx106_jandi", "jandi", "mx106", ("trajectory=triangle",)),
    "miuzei": Case(
        "servo_miuzei",
        "miuzei",
        "miuzei",
        ("trajectory=prbs",),
        (),
        "response.json.gz",
        None,
        (("mass", 0.3), ("length", 0.1), ("supply_voltage", 6.0)),
    ),
}


def main() -> None:
    """Print a table for each case."""
    data = Path(sys.argv[1])
    for name in sys.argv[2:] or CASES:
        case = CASES[name]
        if not (data / case.folder).is_dir():
            print(f"{name}: no folder {case.folder}, skipped")
            continue
        with tempfile.TemporaryDirectory() as scratch:
            logs = Path(scratch)
            source = data / case.folder
            sources = sorted(source.iterdir()) if case.form == "jandi" else [source / case.source]
            subprocess.run(
                [sys.executable, "-m", "frasa_sysid.cli", "import", *map(str, sources), "--format", case.form,
                 "--out", str(logs)],
                check=True, capture_output=True, cwd=ROOT,
            )  # fmt: skip
            recordings = [one for path in sorted(logs.glob("*.mcap")) for one in read_log(path, "auto")]
        facts = dict(case.facts)
        recordings = [
            replace(one, rig=replace(one.rig, **{k: v for k, v in facts.items() if getattr(one.rig, k) is None}))
            for one in recordings
            if one.signal("position").t.size > 20
        ]
        for rule in case.rules:
            one_table(name, case, rule, recordings)


def one_table(name: str, case: Case, rule: str, recordings: list) -> None:
    """Fit all six laws without the held-out runs and print what they do on them."""
    servo, nominal = stated_servo(case.servo, ROOT / "robot_model" / "nominal.xml")
    train, held_out = split(recordings, rule)
    bench = Bench(servo, nominal, train, held_out)
    with bench.session(ROOT / "robot_model" / "bench_pendulum.xml", None) as session:
        runs, out = bench.runs(session, case.first)
        problem = state_problem(servo, nominal, runs, out, session.delay_range, rule, 0, "m1", case.effects)
        started = time.perf_counter()
        found = ladder(problem, session, LAWS, None, None, lambda *_: None)
        seconds = time.perf_counter() - started
        first = f", first {case.first} s" if case.first else ""
        effects = ", ".join(case.effects) or "no effect"
        print(f"\n{name}: {len(runs)} runs, {len(out)} held out by {rule}{first}, with {effects}; "
              f"six laws in {seconds:.1f} s")  # fmt: skip
        nominal_fit = misfits(problem, session.kernel(runs), [None])[0]
        print(f"  nominal: train {nominal_fit.mae_rad * 1e3:.2f} (rms {nominal_fit.rmse_rad * 1e3:.2f})", end="")
        print(f", held out {mean(misfits(problem, session.kernel(out), [None])[0])}" if out else "")
        for law, (one, solved) in found.items():
            values = one.from_unit(solved.x)
            fitted = misfits(one, session.kernel(runs), [values])[0]
            text = f"  {law}: train {fitted.mae_rad * 1e3:6.2f} (rms {fitted.rmse_rad * 1e3:6.2f})"
            if out:
                held = misfits(one, session.kernel(out), [values])[0]
                text += f", held out {mean(held)} (rms {held.rmse_rad * 1e3:.2f})"
            print(text)
        sys.stdout.flush()


def mean(errors: Misfit) -> str:
    """Mean absolute error over runs with the 95 % interval of that mean [mrad]."""
    runs = np.array(list(errors.by_run.values())) * 1e3
    if len(runs) < 2:
        return f"{runs.mean():.2f} (one run)"
    half = stats.t.ppf(0.975, len(runs) - 1) * runs.std(ddof=1) / np.sqrt(len(runs))
    return f"{runs.mean():.2f} +- {half:.2f}"


if __name__ == "__main__":
    main()

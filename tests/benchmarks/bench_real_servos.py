"""Fits of real servos, with logs held out: nominal against fitted, through the command line a user types.

    python tests/benchmarks/bench_real_servos.py [DATA [OPTION ...]]

The logs are other people's (see the catalogue beside them) and are not part of this repository: give their folder,
or put it at ../shared/data. Options go to every `frasa-sysid fit`, such as `--friction auto --jobs 4`.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared" / "data"
OPTIONS = sys.argv[2:]


@dataclass(frozen=True)
class Case:
    """A set of logs, how it is imported and what is held out."""

    folder: str
    pattern: str
    form: str
    extra: tuple[str, ...]
    rules: tuple[str, ...]
    options: tuple[str, ...] = ()


RIGS = ("--rig-table", "sts3215/bench_configs.csv")
CASES = (
    Case("sts3215", "*.json.gz", "bam", RIGS, ("none", "kp=24", "mass=0.969")),
    Case("xl330", "*.json.gz", "bam", (), ("none", "kp=400")),
    Case("sts3250_bam", "*.json.gz", "bam", (), ("none", "trajectory=sin_sin")),
    Case("mx64_dynaban", "completeTest.gz", "dynaban", ("--servo", "mx64"), ("none", "trajectory=steps")),
)


def run(*words: str) -> str:
    program = Path(sys.executable).with_name("frasa-sysid")
    done = subprocess.run([program, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"frasa-sysid {' '.join(words)} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def main() -> int:
    if not DATA.is_dir():
        print(f"skipped: no logs at {DATA}")
        return 0
    heads = ("nominal", "fitted", "nominal", "fitted", "time")
    print(f"{'logs':<14}{'held out':<22}{'train':>6}{'held':>6}" + "".join(f"{head:>10}" for head in heads) + "  model")
    print(f"{'':<48}{'train [mrad]':>20}{'held out [mrad]':>20}")
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            logs = Path(folder) / case.folder
            sources = [str(path) for path in sorted((DATA / case.folder).glob(case.pattern))]
            extra = [str(DATA / word) if word.endswith(".csv") else word for word in case.extra]
            run("import", *sources, "--format", case.form, "--out", str(logs), *extra)
            for rule in case.rules:
                out = str(Path(folder) / "fit.json")
                words = ["--hold-out", rule, "--out", out, "--no-report", "--json", *case.options, *OPTIONS]
                report(case.folder, rule, json.loads(run("fit", str(logs), *words)))
    return 0


def report(name: str, rule: str, data: dict) -> None:
    errors = data["misfit"]
    cells = [errors[key]["mae_rad"] for key in ("nominal", "fitted", "held_out_nominal", "held_out")]
    text = ["-" if cell is None else f"{cell * 1e3:.2f}" for cell in cells]
    runs = data["runs"]
    numbers = "".join(f"{cell:>10}" for cell in text)
    counts = f"{runs['train']:>6}{runs['held_out']:>6}"
    model = " + ".join((data["friction"], *data["effects"]))
    print(f"{name:<14}{rule:<22}{counts}{numbers}{data['seconds']:>9.1f}s  {model}", flush=True)


if __name__ == "__main__":
    sys.exit(main())

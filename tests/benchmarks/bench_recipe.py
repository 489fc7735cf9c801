"""What makes the robot stand sooner: variants of the recipe, several seeds each, wall clock and work side by side.

    python tests/benchmarks/bench_recipe.py train OUT [--only NAME ...] [--seeds 5] [--minutes 30] [--steps N]
    python tests/benchmarks/bench_recipe.py report OUT [--earlier recipe.csv] [--write tests/benchmarks/results]

`train` runs one `frasa-rl sweep` a variant into OUT/NAME, each agent until 90 % of the held-out falls end standing in
two evaluations or its minutes or steps are over; called again it goes on where it was. `report` reads every run folder
below OUT/NAME, whoever made it, and of an earlier recipe.csv the runs that OUT does not have, prints the table, and
with `--write` leaves recipe.csv (all evaluations of all runs) and recipe.png, or what `--name` says. Steps and updates
to a success do not depend on the machine; minutes are those of the run, and only comparable between runs that had the
machine to themselves, or shared it in the same way: see how they were made.
"""

import argparse
import csv
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from frasa_rl.sweep_table import spread
from frasa_rl.tables import EVALUATIONS, PROGRESS

BASE = {
    "updates_per_step": "0.5", "batch": "128", "actor": "128,128", "critic": "128,128", "n_step": "3",
    "discount": "0.97", "entropy": "0.1", "target_entropy": "-1.6", "average": "4000", "end_gyro": "15",
    "near_target_share": "0.2", "near_target_push": "0.45",
    "falling_share": "0.45", "gathering": "1.5", "approach": "4.5", "noise_correlation": "0.7",
    "weight_norm": "false", "envs": "64", "learning_starts": "5000", "physics": "fast",
}  # fmt: skip
VARIANTS: dict[str, dict[str, str]] = {
    "base": {},
    "white-noise": {"noise_correlation": "0"},
    "slower-noise": {"noise_correlation": "0.85"},
    "discount-99": {"discount": "0.99"},
    "discount-95": {"discount": "0.95"},
    "both-as-published": {"discount": "0.99", "noise_correlation": "0"},
    "no-gathering": {"gathering": "0"},
    "no-approach": {"approach": "0"},
    "published-reward": {"gathering": "0", "approach": "0"},
    "no-falling": {"falling_share": "0"},
    "no-push": {"near_target_push": "0"},
    "spin-5": {"end_gyro": "5"},
    "no-average": {"average": "0"},
    "n-step-1": {"n_step": "1"},
    "n-step-5": {"n_step": "5"},
    "entropy-1": {"target_entropy": "-1"},
    "n-step-1-entropy-1": {"n_step": "1", "target_entropy": "-1"},
    "updates-quarter": {"updates_per_step": "0.25"},
    "updates-1": {"updates_per_step": "1"},
    "batch-256": {"batch": "256"},
    "wide-critic": {"critic": "256,256"},
    "weight-norm": {"weight_norm": "true"},
    "sac": {"algorithm": "sac"},
}
SHARES = (0.5, 0.9)
SHOWN = (200, 6)  # thousand transitions and minutes; runs beside other work took longer


@dataclass(frozen=True)
class Run:
    """A run: its evaluations as columns, and its updates at each."""

    seed: int
    columns: dict[str, np.ndarray]
    updates: np.ndarray

    @property
    def success(self) -> np.ndarray:
        return (self.columns["success_prone"] + self.columns["success_supine"]) / 2.0

    def first(self, share: float) -> tuple[float, float, float]:
        """Steps, updates and minutes of the first evaluation with that success; infinite without one."""
        reached = np.flatnonzero(self.success >= share - 1e-9)
        if not len(reached):
            return np.inf, np.inf, np.inf
        at = reached[0]
        return float(self.columns["steps"][at]), float(self.updates[at]), float(self.columns["minutes"][at])


def read(folder: Path) -> Run:
    """A run folder."""
    said = yaml.safe_load((folder / "run.yaml").read_text(encoding="utf-8"))["settings"]
    tried = np.array(EVALUATIONS.read(folder)).reshape(-1, len(EVALUATIONS.columns))
    went = np.array(PROGRESS.read(folder)).reshape(-1, len(PROGRESS.columns))
    columns = dict(zip(EVALUATIONS.columns, tried.T, strict=True))
    updates = np.interp(columns["steps"], went[:, 0], went[:, PROGRESS.columns.index("updates")])
    return Run(int(said["seed"]), columns, updates)


def earlier(path: Path) -> dict[str, list[Run]]:
    """The runs of a recipe.csv, by variant."""
    runs: dict[tuple[str, int], list[dict[str, str]]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            runs.setdefault((row["variant"], int(row["seed"])), []).append(row)
    found: dict[str, list[Run]] = {}
    for (name, seed), rows in runs.items():
        columns = {one: np.array([float(row[one]) for row in rows]) for one in EVALUATIONS.columns if one in rows[0]}
        found.setdefault(name, []).append(Run(seed, columns, np.array([float(row["updates"]) for row in rows])))
    return found


def variants(out: Path, before: Path | None = None) -> dict[str, list[Run]]:
    """All runs below a folder by folder name, and what only an earlier table has; the base first."""
    found: dict[str, list[Run]] = {}
    for said in sorted(out.glob("*/*/run.yaml")):
        if (said.parent / EVALUATIONS.file).is_file():
            found.setdefault(said.parent.parent.name, []).append(read(said.parent))
    for name, runs in (earlier(before) if before else {}).items():
        there = found.setdefault(name, [])
        there += [run for run in runs if run.seed not in {one.seed for one in there}]
        there.sort(key=lambda one: one.seed)
    return dict(sorted(found.items(), key=lambda one: (one[0] != "base", one[0])))


def train(out: Path, names: Iterable[str], seeds: int, ends: list[str], jobs: int, evaluate_steps: int) -> None:
    """A sweep each, one after the other."""
    for name in names:
        there = (out / name / "sweep.json").is_file()
        sets = [part for item in {**BASE, **VARIANTS[name]}.items() for part in ("--set", "=".join(item))]
        fresh = ["--out", str(out / name), *sets, "--evaluate-steps", str(evaluate_steps)]
        where = ["--resume", str(out / name)] if there else fresh
        command = [sys.executable, "-m", "frasa_rl.cli", "sweep", "--seeds", str(seeds), "--jobs", str(jobs)]
        subprocess.run([*command, *where, *ends], check=True)


def differs(name: str) -> str:
    """In which settings a variant differs from the base."""
    return ", ".join(" ".join(one) for one in VARIANTS.get(name, {}).items()) or "-"


def report(found: dict[str, list[Run]]) -> None:
    """Print the table: medians over seeds, of those that never got there infinite, and the spread of the steps."""
    print(f"{'':24} {'there':>7} {'steps [k] to 50, 90 %':>22} {'least..most':>13}", end=" ")
    print(f"{'updates [k]':>16} {'minutes':>14}  differs from the base in")
    for name, runs in found.items():
        firsts = np.array([[run.first(share) for share in SHARES] for run in runs])  # runs, shares, kinds
        steps, updates, minutes = np.median(firsts, axis=0).T / [[1e3], [1e3], [1.0]]
        reached = firsts[:, -1, 0] / 1e3
        there = f"{np.isfinite(reached).sum()} of {len(runs)}"
        print(f"{name:24} {there:>7} {steps[0]:11.0f} {steps[1]:10.0f}", end=" ")
        print(f"{f'{reached.min():.0f}..{reached.max():.0f}':>13} {updates[0]:8.0f} {updates[1]:7.0f}", end=" ")
        print(f"{minutes[0]:7.1f} {minutes[1]:6.1f}  {differs(name)}")


def write(found: dict[str, list[Run]], out: Path, name: str) -> None:
    """A table of all evaluations, and its picture."""
    with (out / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        names = [one for one in EVALUATIONS.columns if one != "best"]
        rows.writerow(["variant", "seed", "updates", *names])
        for variant, runs in found.items():
            for run in runs:
                each = zip(run.updates, *(run.columns[one] for one in names), strict=True)
                rows.writerows([variant, run.seed, *(f"{one:.6g}" for one in row)] for row in each)
    draw(found, out / f"{name}.png")


def draw(found: dict[str, list[Run]], path: Path) -> None:
    """Success on held-out falls against steps and minutes: a row a variant, each seed thin and the median thick."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.2 + 1.5 * len(found)), layout="constrained")
    axes = figure.subplots(len(found), 2, sharex="col", sharey=True, squeeze=False)
    for row, (name, runs) in zip(axes, found.items(), strict=True):
        for one, against, scale, most in zip(row, ("steps", "minutes"), (1e-3, 1.0), SHOWN, strict=True):
            # Before the first evaluation stands what an untrained policy has, so that all curves begin together.
            curves = [
                (np.append(0.0, run.columns[against] * scale), np.append(0.0, 100.0 * run.success)) for run in runs
            ]
            end = max(x[-1] for x, _ in curves)
            for x, y in curves:
                one.plot(x, y, color="tab:orange", lw=0.7, alpha=0.6)
            # A run that ended early had success: it counts on with what it had.
            middle = spread([(np.append(x, end), np.append(y, y[-1])) for x, y in curves])
            one.plot(middle.x, middle.levels[2], color="tab:blue", lw=1.8)
            one.set_xlim(0, most)
            one.grid(alpha=0.3)
        row[0].set_ylabel(name, fontsize=8)
    axes[0, 0].set_title("held-out falls that end standing [%]", fontsize=9)
    axes[-1, 0].set_xlabel("transitions [thousands]")
    axes[-1, 1].set_xlabel("training time [min]")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("train", "report"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=tuple(VARIANTS), default=tuple(VARIANTS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--steps", type=int, help="transitions a run ends at (default: only the minutes count)")
    parser.add_argument("--evaluate-steps", type=int, default=25_000, help="transitions between evaluations")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--earlier", type=Path, help="a recipe.csv whose runs count where OUT has none")
    parser.add_argument("--write", type=Path, help="folder for recipe.csv and recipe.png")
    parser.add_argument("--name", default="recipe", help="of what --write leaves")
    given = parser.parse_args()
    if given.what == "train":
        ends = ["--minutes", f"{given.minutes:g}", "--until-success", str(SHARES[-1])]
        ends += ["--steps", str(given.steps)] if given.steps else []
        train(given.out, given.only, given.seeds, ends, given.jobs, given.evaluate_steps)
    found = variants(given.out, given.earlier)
    if not found:
        sys.exit(f"{given.out}: no run folders with evaluations in folders below it")
    report(found)
    if given.write:
        write(found, given.write, given.name)


if __name__ == "__main__":
    main()

"""Damaged and hostile input against every reader: all is read with its losses counted, or refused in one line.

    python tests/benchmarks/bench_fuzz.py [--inputs 300] [--seed 1] [--commands 10] [--format NAME ...] [--only NUMBER]

Each format is read in a process of its own, with at most 2 GiB beyond what it has after its imports, a watchdog of 10 s
and an audit hook that notes code, processes, sockets, pickles and files outside the input's folder. What fails is
kept with its number; `--format NAME --only NUMBER` reads it again.
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(1, str(Path(__file__).resolve().parents[2]))

from fuzzing import commands
from fuzzing.campaign import BAD, Tally, run, table
from fuzzing.commands import COMMANDS
from fuzzing.targets import targets

import frasa_rl  # noqa: F401 (before numpy, whose threads it keeps to one)


def main() -> int:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=300, help="damaged inputs of a format of share 1")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--format", nargs="+", choices=list(targets()), default=list(targets()))
    parser.add_argument("--commands", type=int, default=0, help="inputs that each command line gets too")
    parser.add_argument("--only", help="number of a single input")
    parser.add_argument("--kept", type=Path, default=Path("fuzz-failures"), help="folder for inputs that failed")
    args = parser.parse_args()
    begun = time.perf_counter()
    tallies: dict[str, Tally] = {}
    for form in args.format:
        count = round(args.inputs * targets()[form].share)
        tallies[form] = tally = run(form, count, args.seed, args.kept, args.only)
        print(f"{form}: {dict(tally.count)}", file=sys.stderr, flush=True)
        for outcome, number, detail in tally.failures[:40]:
            last = detail.strip().splitlines()[-1] if detail.strip() else ""
            print(f"  {outcome} {number}: {last[:200]}", file=sys.stderr, flush=True)
    print(table(tallies, time.perf_counter() - begun, args.seed), flush=True)
    wrong = any(tally.count[one] for tally in tallies.values() for one in BAD)
    return int(_commands(args.commands, args.seed) or wrong)


def _commands(count: int, seed: int) -> bool:
    """The same through the command lines: whether any ended otherwise than it should."""
    every = []
    for name in COMMANDS if count else ():
        counts, lines = commands.run(name, count, seed)
        print(f"{name:22}" + "".join(f"{value:>6} {key}" for key, value in counts.items()), flush=True)
        every += lines
    print("\n".join(every))
    return bool(every)


if __name__ == "__main__":
    sys.exit(main())

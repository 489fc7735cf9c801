"""`frasa-sysid simulate`: a bench log from known parameters, with encoder, jitter, delay and sag."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import add_json_flag, say, sha256_of_file
from frasa_sysid.errors import UsageError
from frasa_sysid.servo import PUBLISHED_M4, servo
from frasa_sysid.simulate import BENCHES, bench_of, simulate_bench, truth_of
from frasa_sysid.writer import write_mcap

SCHEMA = "frasa.simulate/1"
_LONGEST_DELAY = 0.03  # [s] beyond it no servo bus is worth modelling


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `simulate` to the command line."""
    parser = subparsers.add_parser(
        "simulate",
        help="a bench log from known parameters",
        description="Simulate a pendulum bench of a servo with the load-dependent Stribeck law (M4) that Rhoban/bam "
        "published for it: several loads, gains and trajectories in one MCAP file, marked simulated, with its truth.",
    )
    parser.add_argument("--servo", required=True, choices=sorted(BENCHES), help="which servo's truth")
    parser.add_argument("--out", required=True, type=Path, metavar="LOG", help="MCAP file to write")
    parser.add_argument("--delay", type=float, metavar="S", help="command delay [s]; by default the bench's own")
    parser.add_argument("--position-age", type=float, metavar="S", help="of a position at its stamp [0 s]")
    parser.add_argument("--duty-age", type=float, metavar="S", help="log the duty too, read this late")
    parser.add_argument("--seed", type=int, help="of jitter and noise; by default the bench's own")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate and write.

    Raises:
        UsageError: a delay or an age outside 0 .. 30 ms, or a negative seed.
    """
    if args.delay is not None and not 0.0 <= args.delay <= _LONGEST_DELAY:
        raise UsageError(f"--delay {args.delay}: expected seconds, 0 to {_LONGEST_DELAY}")
    for name in ("position_age", "duty_age"):
        age = getattr(args, name)
        if age is not None and not 0.0 <= age <= _LONGEST_DELAY:
            raise UsageError(f"--{name.replace('_', '-')} {age}: expected seconds, 0 to {_LONGEST_DELAY}")
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed {args.seed}: expected 0 or more")
    truth = servo(args.servo, PUBLISHED_M4)
    bench = bench_of(args.servo, args.delay, args.seed)
    bench = replace(bench, position_age=args.position_age or 0.0, duty_age=args.duty_age)
    recordings = simulate_bench(truth, bench, args.out.name)
    write_mcap(args.out, recordings)
    say(f"{args.out}: {len(recordings)} simulated runs of {args.servo}, command delay {bench.command_delay * 1e3:g} ms")
    return {
        "schema": SCHEMA,
        "servo": args.servo,
        "runs": len(recordings),
        "truth": truth_of(truth, bench),
        "source": truth.source,
        "seed": bench.seed,
        "outputs": {"log": args.out, "sha256": sha256_of_file(args.out)},
    }

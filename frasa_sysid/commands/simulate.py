"""`frasa-sysid simulate`: a log with known truth, of a servo on a bench or of a whole robot."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import add_json_flag, say, sha256_of_file
from frasa_sysid.commands.simulate_robot import add_robot_arguments, run_robot
from frasa_sysid.errors import UsageError
from frasa_sysid.servo import find_table
from frasa_sysid.simulate import simulate_bench, truth_of
from frasa_sysid.simulated_bench import bench_of
from frasa_sysid.writer import write_mcap

SCHEMA = "frasa.simulate/1"
_LONGEST_DELAY = 0.03  # [s] beyond it no servo bus is worth modelling
_BENCH_ONLY = ("delay", "position_age", "duty_age")
_ROBOT_ONLY = ("base", "seconds", "excitation", "model", "roll", "pitch", "holds", "firmware_gain")


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `simulate` to the command line."""
    parser = subparsers.add_parser(
        "simulate",
        help="a log with known truth",
        description="Simulate a pendulum bench of a servo with the numbers of its table, a friction law beyond "
        "Coulomb-viscous where it has one (mx106, mx64: M4, as Rhoban/bam published it): several loads, gains and "
        "trajectories in one MCAP file, marked simulated, with its truth. "
        "Or, with --robot, a whole robot of such servos whose delays, joint zeros, scales and trunk are drawn at "
        "random from --seed.",
    )
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("--servo", metavar="NAME_OR_TABLE", help="a bench of this servo: see frasa-sysid servos")
    kind.add_argument("--robot", action="store_true", help="a whole robot")
    parser.add_argument("--out", required=True, type=Path, metavar="LOG", help="MCAP file to write")
    parser.add_argument("--seed", type=int, help="of jitter and noise, and of a robot's truth; by default its own")
    bench = parser.add_argument_group("of a bench")
    bench.add_argument("--delay", type=float, metavar="S", help="command delay [s]; by default the bench's own")
    bench.add_argument("--position-age", type=float, metavar="S", help="of a position at its stamp [0 s]")
    bench.add_argument("--duty-age", type=float, metavar="S", help="log the duty too, read this late")
    add_robot_arguments(parser.add_argument_group("of a robot"))
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate and write.

    Raises:
        UsageError: a delay or an age outside 0 .. 30 ms, a negative seed, an option of the other kind of log.
    """
    foreign = [name for name in (_BENCH_ONLY if args.robot else _ROBOT_ONLY) if getattr(args, name) is not None]
    if foreign:
        kind = "--servo" if args.robot else "--robot"
        raise UsageError(f"--{foreign[0].replace('_', '-')} belongs to {kind}")
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed {args.seed}: expected 0 or more")
    return {"schema": SCHEMA, **(run_robot(args) if args.robot else _run_bench(args))}


def _run_bench(args: argparse.Namespace) -> dict[str, Any]:
    for name in _BENCH_ONLY:
        age = getattr(args, name)
        if age is not None and not 0.0 <= age <= _LONGEST_DELAY:
            raise UsageError(f"--{name.replace('_', '-')} {age}: expected seconds, 0 to {_LONGEST_DELAY}")
    table = find_table(args.servo)
    if table.linear:
        raise UsageError(f"--servo {args.servo}: a linear axis swings no pendulum")
    truth = table.simulated or table.servo
    bench = bench_of(truth, args.delay, args.seed)
    bench = replace(bench, position_age=args.position_age or 0.0, duty_age=args.duty_age)
    recordings = simulate_bench(truth, bench, args.out.name)
    write_mcap(args.out, recordings, made={"command": "simulate", "servo": truth.name, "seed": bench.seed})
    say(f"{args.out}: {len(recordings)} simulated runs of {truth.name}, command delay {bench.command_delay * 1e3:g} ms")
    return {
        "servo": truth.name,
        "runs": len(recordings),
        "truth": truth_of(truth, bench),
        "source": truth.source,
        "seed": bench.seed,
        "outputs": {"log": args.out, "sha256": sha256_of_file(args.out)},
    }

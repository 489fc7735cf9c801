"""frasa-rl sweep."""

import argparse
import json
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from frasa_rl.commands.leave_page import leave_page
from frasa_rl.commands.rank import rank_words
from frasa_rl.commands.training import add_training, check_resumed, plan_from_arguments
from frasa_rl.model_path import NAMED, check_there
from frasa_rl.places import usual_jobs
from frasa_rl.settings import LAST_SEED
from frasa_rl.simulation import all_threads
from frasa_rl.stopping import Ends
from frasa_rl.sweep_files import LOG_FILE, RANK_FILE, SWEEP_FILE, Sweep, read_sweep
from frasa_rl.sweep_page import write_sweep_page
from frasa_rl.sweep_table import AGENTS, by_merit
from frasa_sysid.calibration import (
    FrasaError,
    InterruptedRunError,
    UsageError,
    add_json_flag,
    alone,
    plain,
    say,
    write_atomic,
)

_ADVISED = 3  # candidates in the advice to rank some
_MOST_AGENTS = 10_000


class AgentsError(FrasaError):
    """Some agents of a sweep failed; the others are there."""


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `sweep` to the command line."""
    parser = commands.add_parser("sweep", help="train many agents, a seed each, and rank the best")
    parser.add_argument("--seeds", type=int, metavar="N", help="how many agents; with --resume for more than there are")
    parser.add_argument("--first-seed", type=int, metavar="S", help="seed of the first, the others follow (default 0)")
    parser.add_argument(
        "--jobs", type=int, metavar="J", help="agents at a time here (default: one for each GPU, else for two cores)"
    )
    parser.add_argument("--cluster", metavar="ADDRESS", help="Dask scheduler to do them, such as tcp://host:8786")
    add_training(parser)
    parser.add_argument("--out", type=Path, help="folder of the run folders (default runs/sweep-<date>-<time>)")
    parser.add_argument(
        "--resume", type=Path, metavar="SWEEP", help="go on with a sweep: what is over stays, the rest goes on"
    )
    parser.add_argument(
        "--rank", type=int, default=0, metavar="K", help="put the best K through the protocol, minutes each (default 0)"
    )
    parser.add_argument("--no-report", action="store_true", help="leave out the HTML page in the folder")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    try:
        import frasa_rl.sweep  # noqa: F401 - what training needs is imported only where it is needed
    except ModuleNotFoundError as error:
        raise UsageError(f"training needs {error.name}: pip install 'frasa[train]'") from None

    _check(args)
    out = args.resume or args.out or Path("runs") / f"sweep-{datetime.now():%Y%m%d-%H%M%S}"
    if args.resume:
        check_resumed(args, "first_seed")
        read_sweep(out)  # says that there is none before a lock makes its folder
    with alone(out, folder=True):
        return _sweep(args, _resumed(args) if args.resume else _new(args, out))


def _sweep(args: argparse.Namespace, sweep: Sweep) -> dict[str, Any]:
    """The sweep, with nobody else writing the same folder."""
    from frasa_rl.sweep import run_sweep

    if args.rank and not sweep.run["settings"]["evaluate_steps"]:
        raise UsageError("--rank chooses by held-out falls: give --evaluate-steps more than 0")
    gpu = sweep.run["device"] != "cpu"
    jobs = args.jobs or (1 if args.cluster else usual_jobs(all_threads(), gpu=gpu))
    result = run_sweep(sweep, jobs, args.cluster)
    agents = result["agents"]
    best = by_merit([[one[name] for name in AGENTS.columns] for one in agents])
    _tell(sweep, agents, best)
    if any(one["state"] == "waiting" for one in agents):
        _leave_page(args, sweep, agents, None)
        raise InterruptedRunError(f"interrupted; saved in {sweep.out}, continue with --resume {sweep.out}")
    result["ranking"] = _ranked(sweep, best, args.rank)
    result["outputs"] = {"report": _leave_page(args, sweep, agents, result["ranking"])}
    _check_failures(sweep, agents)
    return result


def _check(args: argparse.Namespace) -> None:
    Ends(args.steps, args.minutes, args.until_success)
    if args.seeds is not None and not 1 <= args.seeds <= _MOST_AGENTS:
        raise UsageError(f"--seeds {args.seeds}: expected 1 .. {_MOST_AGENTS:,}")
    if args.first_seed is not None and not 0 <= args.first_seed <= LAST_SEED:
        raise UsageError(f"--first-seed {args.first_seed}: expected 0 .. {LAST_SEED}")
    _check_last_seed(args.first_seed or 0, args.seeds or 1)
    if args.jobs is not None and not 1 <= args.jobs <= _MOST_AGENTS:
        raise UsageError(f"--jobs {args.jobs}: expected 1 .. {_MOST_AGENTS:,}")
    if args.jobs is not None and args.cluster is not None:
        raise UsageError("--jobs is of this machine; of a cluster each worker's threads are as many agents")
    if args.rank < 0:
        raise UsageError(f"--rank {args.rank}: expected 0 or more")
    if any(one.partition("=")[0].strip() == "seed" for one in args.set or ()):
        raise UsageError("--set seed: the seeds of a sweep are --first-seed and those after it")


def _check_last_seed(first: int, count: int) -> None:
    last = first + count - 1
    if last > LAST_SEED:
        raise UsageError(f"--seeds {count}: the last seed would be {last}, expected at most {LAST_SEED}")


def _new(args: argparse.Namespace, out: Path) -> Sweep:
    """A sweep that begins.

    Raises:
        UsageError: no number of seeds, no end, or a folder that has a sweep already.
        ModelError: no model there.
    """
    from frasa_rl.plan import describe

    if args.seeds is None:
        raise UsageError("give --seeds, the number of agents")
    if (out / SWEEP_FILE).exists() and any(out.glob("seed-*")):  # one that a cluster refused has begun nothing
        raise UsageError(f"{out} already holds a sweep: choose another --out, or --resume {out}")
    first = args.first_seed or 0
    plan = plan_from_arguments(args, out)
    plan = replace(plan, settings=replace(plan.settings, seed=first))
    plan.check_ends()
    return Sweep(out, tuple(range(first, first + args.seeds)), describe(plan))


def _resumed(args: argparse.Namespace) -> Sweep:
    """A sweep that goes on, to other ends or with more agents where the arguments say so.

    Raises:
        UsageError: something is to be otherwise, or fewer agents than there are.
        InputError: no sweep there.
    """
    from frasa_rl.plan import plan_from

    sweep = read_sweep(args.resume).until(args.steps, args.minutes, args.until_success)
    plan = plan_from(sweep.run, sweep.out, str(sweep.out / SWEEP_FILE))
    plan.check_ends()
    if not args.model:
        check_there(plan.model)
    sweep = replace(sweep, run={**sweep.run, NAMED: str(args.model or plan.model)})
    if args.device:
        sweep = replace(sweep, run={**sweep.run, "device": args.device})
    if args.seeds is None:
        return sweep
    if args.seeds < len(sweep.seeds):
        raise UsageError(f"--seeds {args.seeds}: {sweep.out} has {len(sweep.seeds)} agents already")
    _check_last_seed(sweep.seeds[0], args.seeds)
    return replace(sweep, seeds=tuple(range(sweep.seeds[0], sweep.seeds[0] + args.seeds)))


def _tell(sweep: Sweep, agents: list[dict[str, Any]], best: list[int]) -> None:
    """The best few, and where everything is."""
    by_seed = {one["seed"]: one for one in agents}
    for seed in best[:_ADVISED]:
        one = by_seed[seed]
        say(
            f"{sweep.folder(seed)}: {100 * one['success_prone']:.0f} % of held-out falls prone, "
            f"{100 * one['success_supine']:.0f} % supine, at {one['best_steps']:,.0f} steps"
        )
    say(f"all agents in {sweep.out / AGENTS.file}")


def _ranked(sweep: Sweep, best: list[int], count: int) -> dict[str, Any] | None:
    """The best agents by the protocol, in rank.json; None where nobody asked for it."""
    words = [str(sweep.folder(seed)) for seed in best]
    if not count:
        if words:
            say(f"to rank the best by the protocol: frasa-rl rank {' '.join(words[:_ADVISED])}")
        return None
    if not words:
        say("nobody to rank: no agent was evaluated on held-out falls")
        return None
    ranking = rank_words(words[:count])
    write_atomic(sweep.out / RANK_FILE, json.dumps(plain(ranking), indent=2, allow_nan=False) + "\n")
    return ranking


def _leave_page(
    args: argparse.Namespace, sweep: Sweep, agents: list[dict[str, Any]], ranking: dict[str, Any] | None
) -> Path | None:
    return None if args.no_report else leave_page(partial(write_sweep_page, sweep, agents, ranking))


def _check_failures(sweep: Sweep, agents: list[dict[str, Any]]) -> None:
    failed = [one for one in agents if one["state"] == "failed"]
    if failed:
        said = "".join(f"\n  seed {one['seed']}: {one['why']}" for one in failed)
        raise AgentsError(
            f"{len(failed)} of {len(agents)} agents failed, see {LOG_FILE} in their folders; "
            f"try them again with --resume {sweep.out}{said}"
        )

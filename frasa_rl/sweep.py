"""Many agents that differ in nothing but their seeds: begun, gone on with, and what they came to together."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_rl.plan import plan_from
from frasa_rl.stopping import Interrupt
from frasa_rl.sweep_files import SCHEMA, STOP_FILE, SWEEP_FILE, Sweep
from frasa_rl.sweep_picture import draw_sweep
from frasa_rl.sweep_run import DONE, FAILED, WAITING, Order, Outcome, Workers, workers
from frasa_rl.sweep_table import AGENTS, agent_row
from frasa_rl.sweep_watch import Watch
from frasa_sysid.calibration import FrasaError, say


class SweepError(FrasaError):
    """Some agents of a sweep failed; the others are there."""


def run_sweep(sweep: Sweep, jobs: int, cluster: str | None = None) -> dict[str, Any]:
    """Train all agents that are not over, and write what they came to.

    Args:
        sweep: its agents; those that have begun go on.
        jobs: agents at a time on this machine.
        cluster: address of a Dask scheduler that has others do them; None for none.

    Returns:
        What `frasa-rl sweep --json` prints.

    Raises:
        UsageError: a cluster that cannot.
        SweepError: a cluster that was lost on the way.
    """
    if cluster:  # its workers have working folders of their own
        model = str(Path(sweep.run["model"]).absolute())
        sweep = replace(sweep, out=sweep.out.absolute(), run={**sweep.run, "model": model})
    (sweep.out / STOP_FILE).unlink(missing_ok=True)
    states = {seed: Outcome(seed, DONE if sweep.over(seed) else WAITING) for seed in sweep.seeds}
    _tables(sweep, states.values())
    waiting = [seed for seed, one in states.items() if one.state != DONE]
    with workers(jobs, cluster, sweep.out, sweep.run) as there:
        say(f"{len(waiting)} of {len(sweep.seeds)} agents to train in {sweep.out}, {there.count} at a time")
        _train(sweep, waiting, there, states)
    (sweep.out / STOP_FILE).unlink(missing_ok=True)
    runs = [sweep.folder(seed) for seed in sweep.seeds]
    picture = None
    with suppress(ModuleNotFoundError):  # it is drawn where matplotlib is installed
        picture = draw_sweep(sweep.out, runs, plan_from(sweep.run, sweep.out, str(sweep.out / SWEEP_FILE)).task)
    return {
        "schema": SCHEMA,
        "sweep": sweep.out,
        "table": sweep.out / AGENTS.file,
        "picture": picture,
        "agents": _told(sweep, states.values()),
    }


def _train(sweep: Sweep, waiting: list[int], there: Workers, states: dict[int, Outcome]) -> None:
    """Have agents trained, and note how each ended."""
    watch, interrupt = Watch(sweep, there.count), Interrupt()
    watch.over.update((seed, one.state) for seed, one in states.items() if one.state != WAITING)
    orders = [Order(seed, sweep.folder(seed), sweep.run_of(seed)) for seed in waiting]
    with interrupt.watch(), watch.going_on(interrupt):
        try:
            for one in there.run(orders):
                states[one.seed] = one
                _tables(sweep, states.values())
                if one.state != WAITING:
                    watch.over[one.seed] = one.state
                if one.state == FAILED:
                    watch.line.tell(f"seed {one.seed} failed: {one.why}")
        except FrasaError:
            raise
        except Exception as error:  # joblib and Dask have many
            if there.local:
                raise
            raise SweepError(f"the cluster was lost ({error!r}); continue with --resume {sweep.out}") from error
    watch.line.tell(watch.text())  # the last word, whenever the line was due


def _tables(sweep: Sweep, states: Iterable[Outcome]) -> None:
    states = list(states)
    AGENTS.write(sweep.out, [agent_row(one.seed, sweep.folder(one.seed)) for one in states])
    sweep.write(agents=[{"seed": one.seed, "state": one.state, "why": one.why or None} for one in states])


def _told(sweep: Sweep, states: Iterable[Outcome]) -> list[dict[str, Any]]:
    """A row of sweep.csv each, with its folder and how it ended, for --json."""
    return [
        {
            "run": sweep.folder(one.seed),
            "state": one.state,
            "why": one.why or None,
            **dict(zip(AGENTS.columns, agent_row(one.seed, sweep.folder(one.seed)), strict=True)),
            "seed": one.seed,  # the row has a float of it
        }
        for one in states
    ]

"""The folder of a sweep: what it trains, and a run folder for each seed.

OUT/sweep.json     what all agents have in common, seeds, versions, and how each of them ended
OUT/sweep.csv      one row an agent (`sweep_table`);  sweep.png: the spread of return and success
OUT/report.html   a page of it all
OUT/rank.json      the best of them by the paper's protocol, where that was asked for
OUT/seed-0007/     an ordinary run folder, with agent.log and, once it is over, result.json
OUT/stop           whoever makes this file ends the sweep, with everything saved
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import InputError, plain, write_atomic

SCHEMA = "frasa.sweep/1"
SWEEP_FILE, RANK_FILE, STOP_FILE = "sweep.json", "rank.json", "stop"
RESULT_FILE, LOG_FILE = "result.json", "agent.log"
_ENDS = ("steps", "minutes", "until_success")


@dataclass(frozen=True)
class Sweep:
    """Many agents that differ in nothing but their seeds.

    Attributes:
        out: the folder of all.
        seeds: one an agent.
        run: of the first agent, as `plan.describe` says it.
    """

    out: Path
    seeds: tuple[int, ...]
    run: dict[str, Any]

    def folder(self, seed: int) -> Path:
        """The run folder of an agent."""
        return self.out / f"seed-{seed:04d}"

    def run_of(self, seed: int) -> dict[str, Any]:
        """What an agent is to do, as `plan.describe` says it."""
        settings = {**self.run["settings"], "seed": seed}
        return {**self.run, "seeds": {**self.run["seeds"], "training": seed}, "settings": settings}

    def over(self, seed: int) -> bool:
        """Whether an agent has come to the sweep's end."""
        result = _read(self.folder(seed) / RESULT_FILE)
        return result is not None and result.get("ends") == ends_of(self.run)

    def until(self, steps: int | None, minutes: float | None, until_success: float | None) -> "Sweep":
        """The same sweep with other ends, where one is given."""
        ends = (steps, minutes, until_success)
        if all(one is None for one in ends):
            return self
        return replace(self, run={**self.run, **dict(zip(_ENDS, ends, strict=True))})

    def write(self, **more: Any) -> None:  # noqa: ANN401 - plain data
        """Write sweep.json, with what else is to be said."""
        said = {"schema": SCHEMA, "seeds": self.seeds, **more, "run": self.run}
        write_atomic(self.out / SWEEP_FILE, json.dumps(plain(said), indent=2, allow_nan=False) + "\n")


def read_sweep(out: Path) -> Sweep:
    """The sweep of a folder.

    Raises:
        InputError: there is none, or one that this version cannot read.
    """
    path = out / SWEEP_FILE
    said = _read(path)
    if said is None:
        raise InputError(f"no sweep at {path}: expected the folder of one")
    try:
        if said["schema"] != SCHEMA:
            raise ValueError(f"schema '{said['schema']}', expected '{SCHEMA}'")
        sweep = Sweep(out, tuple(int(one) for one in said["seeds"]), dict(said["run"]))
        sweep.run_of(0)
        ends_of(sweep.run)
        return sweep
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: missing or wrong field: {error!r}") from error


def ends_of(run: Mapping[str, Any]) -> dict[str, Any]:
    """When a run is over, of what `plan.describe` says."""
    return {name: run[name] for name in _ENDS}


def _read(path: Path) -> dict[str, Any] | None:
    """A JSON object; None where there is none, or a broken one."""
    try:
        said = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) else None

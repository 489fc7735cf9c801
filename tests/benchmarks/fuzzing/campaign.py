"""Inputs for every format, workers that read them, and what came of it."""

import json
import os
import random
import selectors
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzzing.case import Case, put
from fuzzing.hostile import hostile
from fuzzing.mutate import mutate
from fuzzing.targets import targets

LONGEST = 10.0  # [s]
MEMORY = 2048  # MiB beyond what a worker has after its imports and good inputs
BAD = ("unclear", "traceback", "hang", "died", "memory", "executed", "wrongly read")


@dataclass
class Tally:
    """What came of the inputs of a format."""

    count: Counter[str] = field(default_factory=Counter)
    losses: int = 0
    worst: float = 0.0
    peak: int = 0
    failures: list[tuple[str, str, str]] = field(default_factory=list)  # outcome, number, detail


class Worker:
    """A process that reads for one format; it is made anew after it hung or died."""

    def __init__(self, form: str, scratch: Path) -> None:
        self._form, self._scratch = form, scratch
        self._process: subprocess.Popen[str] | None = None

    def read(self, path: Path) -> dict[str, Any]:
        """What came of an input."""
        process = self._process or self._start()
        assert process.stdin is not None
        process.stdin.write(json.dumps({"path": str(path)}) + "\n")
        process.stdin.flush()
        line, begun, spent = "", time.monotonic(), _cpu(process.pid)
        while not line and process.poll() is None:
            line = self._line(process, LONGEST)
            # A machine that others use too must not make a hang of what waits: its own time counts, up to a limit.
            if _cpu(process.pid) - spent > LONGEST or time.monotonic() - begun > 6 * LONGEST:
                break
        if line:
            return dict(json.loads(line))
        hung = process.poll() is None
        process.kill()
        code = process.wait()
        self._process = None
        return {"outcome": "hang" if hung else "died", "detail": f"ended with {code}", "seconds": LONGEST * hung}

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _start(self) -> "subprocess.Popen[str]":
        here = Path(__file__).resolve()
        root, benchmarks = str(here.parents[3]), str(here.parents[1])
        env = {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{benchmarks}", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "fuzzing.worker", self._form, str(MEMORY), str(self._scratch)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**env, "OPENBLAS_NUM_THREADS": "1"}
        )
        if not self._line(self._process, 180.0):
            raise RuntimeError(f"the worker for {self._form} did not begin")
        return self._process

    @staticmethod
    def _line(process: "subprocess.Popen[str]", seconds: float) -> str:
        assert process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            return process.stdout.readline() if selector.select(seconds) else ""


def _cpu(process: int) -> float:
    """Time that a process has computed [s]; that of the children it waited for too."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(int(one) for one in fields[11:15]) / os.sysconf("SC_CLK_TCK")


def cases(form: str, count: int, seed: int) -> Iterator[tuple[str, Case]]:
    """The inputs of a format by number: first the hostile ones, made by hand, then damaged good ones."""
    yield from ((f"hostile-{one.note}", one) for one in hostile(form))
    seeds = targets()[form].seeds()
    for number in range(count):
        rng = random.Random(f"{seed} {form} {number}")
        yield str(number), mutate(rng.choice(seeds), seeds, rng)


def run(form: str, count: int, seed: int, kept: Path, only: str | None = None) -> Tally:
    """All inputs of a format.

    Args:
        form: its name.
        count: damaged inputs.
        seed: of the campaign.
        kept: folder for the inputs that failed.
        only: the number of a single input.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="frasa-fuzz-") as name:
        scratch = Path(name)
        worker = Worker(form, scratch)
        try:
            for number, case in cases(form, count, seed):
                if only is not None and number != only:
                    continue
                answer = worker.read(put(case, scratch / "in"))
                _note(tally, form, number, case, answer, kept)
        finally:
            worker.close()
    return tally


def _note(tally: Tally, form: str, number: str, case: Case, answer: dict[str, Any], kept: Path) -> None:
    outcome = str(answer["outcome"])
    if outcome == "read" and case.refuse:
        outcome = "wrongly read"
    if outcome in ("read", "refused") and answer.get("peak", 0) > MEMORY * 2**20:
        outcome = "memory"
    if outcome in ("read", "refused") and answer["seconds"] > LONGEST:
        outcome = "hang"
    tally.count["inputs"] += 1
    tally.count[outcome] += 1
    tally.losses += int(answer.get("losses", 0))
    tally.worst = max(tally.worst, float(answer.get("seconds", 0.0)))
    tally.peak = max(tally.peak, int(answer.get("peak", 0)))
    executed = answer.get("executed")
    if executed:
        tally.count["executed"] += 1
    if outcome in BAD or executed:
        detail = str(answer.get("detail", "")) + (f"\nexecuted: {executed}" if executed else "")
        tally.failures.append(("executed" if executed else outcome, number, detail))
        if len(tally.failures) <= 40:
            folder = kept / form.replace(" ", "_").replace("/", "_") / f"{number}".replace("/", "_").replace(" ", "_")
            put(case, folder)
            (folder / "what.txt").write_text(f"{outcome}\n{case.note}\n{detail}\n")


def table(tallies: dict[str, Tally], seconds: float, seed: int) -> str:
    """All formats side by side."""
    names = ("inputs", "read", "refused", "unclear", "traceback", "hang", "died", "memory", "executed", "wrongly read")
    head = (
        f"{'format':22}"
        + "".join(f"{one:>10}" for one in names[:-1])
        + f"{'wrong':>7}{'losses':>9}{'worst s':>9}{'MiB':>6}"
    )
    lines = [head]
    whole = Tally()
    for form, one in tallies.items():
        lines.append(_row(form, one, names))
        whole.count.update(one.count)
        whole.losses += one.losses
        whole.worst, whole.peak = max(whole.worst, one.worst), max(whole.peak, one.peak)
    lines += [_row("together", whole, names), f"seed {seed}, {seconds:.0f} s on one core, {time.strftime('%Y-%m-%d')}"]
    return "\n".join(lines)


def _row(form: str, one: Tally, names: tuple[str, ...]) -> str:
    counts = "".join(f"{one.count[name]:>10}" for name in names[:-1]) + f"{one.count[names[-1]]:>7}"
    return f"{form:22}{counts}{one.losses:>9}{one.worst:>9.2f}{one.peak / 2**20:>6.0f}"

"""The same inputs through the command lines as users have them: exit status 3 and one line on standard error.

Each command is a process of its own, with the same bounds as the workers.
"""

import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzzing.campaign import LONGEST, MEMORY, _cpu, cases
from fuzzing.case import Case, put
from fuzzing.seeds_texts import MAP
from fuzzing.targets_sysid import MODELS, ROOT

IMPORTS = 1536  # MiB of address space that a command has after its imports; torch takes three times as many
TORCH = 6144


@dataclass(frozen=True)
class Command:
    """A command line over an input.

    Attributes:
        form: whose inputs it gets.
        words: from the input's path and a folder for outputs.
        room: address space of its imports [MiB].
    """

    form: str
    words: Callable[[Path, Path], list[str]]
    room: int = IMPORTS


def _sysid(*words: str) -> list[str]:
    return ["-m", "frasa_sysid.cli", *words]


def _rl(*words: str) -> list[str]:
    return ["-m", "frasa_rl.cli", *words]


NOMINAL, BENCH = str(MODELS / "nominal.xml"), str(MODELS / "bench_pendulum.xml")
POLICY = str(MODELS / "policies" / "standup")
COMMANDS: dict[str, Command] = {
    "inspect": Command("mcap ros2", lambda path, _: _sysid("inspect", str(path))),
    "fit LOG": Command(
        "mcap ros2",
        lambda path, out: _sysid("fit", str(path), "--seed", "1", "--no-report", "--out", str(out / "fit.json")),
    ),
    "import bam": Command("bam", lambda path, out: _sysid("import", str(path), "--format", "bam", "--out", str(out))),
    "import jandi": Command(
        "jandi", lambda path, out: _sysid("import", str(path), "--format", "jandi", "--out", str(out))
    ),
    "import rosbag": Command(
        "rosbag .db3", lambda path, out: _sysid("import", str(path), "--format", "rosbag", "--out", str(out))
    ),
    "import csv --map": Command("csv", lambda path, out: _import_csv(path, out)),
    "import --map MAP": Command("map", lambda path, out: _import_map(path, out)),
    "publish FIT": Command(
        "fit", lambda path, out: _sysid("publish", str(path), "--model", NOMINAL, "--out", str(out / "c.xml"))
    ),
    "compare --model": Command(
        "model (MJCF)", lambda path, out: _sysid("compare", str(ROOT / "bench_logs/mx106.mcap"), "--model", str(path))
    ),
    "evaluate POLICY": Command(
        "run and policy",
        lambda path, out: _rl(
            "evaluate", str(path), "--trials", "1", "--protocol", "standup", "--no-report", "--out", str(out)
        ),
        TORCH,
    ),
    "evaluate KEYFRAMES": Command(
        "keyframes (YAML)",
        lambda path, out: _rl(
            "evaluate", str(path), "--trials", "1", "--protocol", "standup", "--no-report", "--out", str(out)
        ),
        TORCH,
    ),
    "evaluate --task": Command(
        "task (YAML)",
        lambda path, out: _rl(
            "evaluate", POLICY, "--task", str(path), "--trials", "1", "--protocol", "standup", "--no-report"
        ),
        TORCH,
    ),
    "train --resume": Command("run and policy", lambda path, _: _rl("train", "--resume", str(path)), TORCH),
}


def _import_csv(path: Path, out: Path) -> list[str]:
    (out / "map.toml").write_bytes(MAP)
    return _sysid("import", str(path), "--format", "csv", "--map", str(out / "map.toml"), "--out", str(out))


def _import_map(path: Path, out: Path) -> list[str]:
    (out / "a.csv").write_text("t,q_knee,cmd_knee,v\n" + "".join(f"{i / 100},1,2,3\n" for i in range(30)))
    return _sysid("import", str(out / "a.csv"), "--format", "csv", "--map", str(path), "--out", str(out))


def sample(name: str, count: int, seed: int) -> list[tuple[str, Case]]:
    """Some inputs of a command: hostile ones and damaged ones, half of each where there are so many."""
    every = list(cases(COMMANDS[name].form, 4 * count, seed))
    rng = random.Random(f"{seed} {name}")
    made = [one for one in every if one[0].startswith("hostile")]
    damaged = [one for one in every if not one[0].startswith("hostile")]
    some = rng.sample(made, min(count // 2, len(made)))
    return [*some, *rng.sample(damaged, count - len(some))]


def run(name: str, count: int, seed: int) -> tuple[dict[str, int], list[str]]:
    """Counts of what came of a command's inputs, and a line on each that did not end as it should."""
    counts = dict.fromkeys(("inputs", "exit 0", "exit 3", "exit 4", "wrong"), 0)
    lines = []
    for number, case in sample(name, count, seed):
        with tempfile.TemporaryDirectory(prefix="frasa-fuzz-") as folder:
            code, said = _call(name, case, Path(folder))
        counts["inputs"] += 1
        # One line says why; other lines say what was lost of what could be used.
        plain = [line for line in said.splitlines() if line.strip()]
        right = code in (0, 4) or (code == 3 and bool(plain) and plain[-1].startswith("frasa-"))
        if "Traceback" in said or not right:
            counts["wrong"] += 1
            lines.append(f"{name} {number}: exit {code}: {' | '.join(plain[-3:])[:400]}")
        else:
            counts[f"exit {code}"] += 1
    return counts, lines


def _call(name: str, case: Case, folder: Path) -> tuple[int, str]:
    command = COMMANDS[name]
    path, out = put(case, folder / "in"), folder / "out"
    out.mkdir()
    room = (command.room + MEMORY) * 2**20
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, *command.words(path, out)], cwd=out, env=env, text=True, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (room, room)),
    )  # fmt: skip
    begun = time.monotonic()
    while True:
        try:
            _, said = process.communicate(timeout=1.0)
            return process.returncode, said
        except subprocess.TimeoutExpired:
            # Imports and, where the input is good, what was asked for are part of it.
            if _cpu(process.pid) > 6 * LONGEST or time.monotonic() - begun > 30 * LONGEST:
                process.kill()
                return -9, process.communicate()[1] + f"\nhang after {time.monotonic() - begun:.0f} s"

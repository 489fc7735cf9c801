"""Kills a fit of a servo, a fit of a robot and a training by kill -9, again and again, and lets them go on.

After every kill each file on the disk is read; at the end the result is held against that of an unbroken run, byte by
byte but for what says a time. Half of the kills come at random moments, half the moment something is being written.
Each try is a process group of its own, forked from one that has imported everything, or with --spawn a new Python.

    python tests/benchmarks/bench_kills.py | tee tests/benchmarks/results/kills.txt
"""

import argparse
import csv
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import frasa_rl.cli
import frasa_rl.run_page
import frasa_rl.train
import frasa_sysid.cli

# isort: split
import numpy as np
import yaml
from whole_files import check

from frasa_sysid.calibration import run_command
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.writer import write_mcap

REPO = Path(__file__).parents[2]
LONGEST = 900.0  # [s] that a try may take: beyond, it hangs
TINY = (
    "envs=4", "pool=8", "batch=16", "actor=16,16", "critic=16,16", "learning_starts=40", "renorm_warmup=20",
    "evaluate_falls=1", "evaluate_physics=fast", "evaluate_steps=320", "checkpoint_steps=16", "updates_per_step=0.25",
    "rollout_steps=16", "end_gyro=5",
)  # fmt: skip
TIMES = ("minutes", "steps_per_s", "updates_per_s")  # columns that say a time
PARSERS = {"frasa-sysid": frasa_sysid.cli.build_parser, "frasa-rl": frasa_rl.cli.build_parser}


@dataclass(frozen=True)
class Work:
    """What is killed.

    Attributes:
        name: in the table.
        words: the command, in a folder of its own.
        again: the command after a kill.
        prepare: fills the folder.
        result: what must be as in an unbroken run, by name.
    """

    name: str
    words: Callable[[Path], list[str]]
    again: Callable[[Path], list[str]]
    prepare: Callable[[Path], None]
    result: Callable[[Path], dict[str, str]]


@dataclass
class Count:
    """What a campaign saw."""

    kills: int = 0
    writing: int = 0
    finished: int = 0
    files: int = 0
    leftovers: int = 0
    torn: int = 0
    equal: int = 0
    differ: list[str] = field(default_factory=list)
    unbroken_s: float = 0.0


def start(words: list[str], log: Path, spawn: bool) -> int:
    """Begin a command in a process group of its own: its pid."""
    if spawn:
        environment = {**os.environ, "PYTHONPATH": str(REPO)}
        command = [sys.executable, "-m", words[0].replace("-", "_") + ".cli", *words[1:]]
        with log.open("ab") as file:
            process = subprocess.Popen(command, env=environment, stdout=file, stderr=file, start_new_session=True)
        process.returncode = 0  # waited for by `ended`
        return process.pid
    child = os.fork()
    if child == 0:
        os.setsid()
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, 1)
        os.dup2(file, 2)
        code = 70
        try:
            code = run_command(PARSERS[words[0]](), words[1:])
        finally:
            os._exit(code)
    return child


def ended(child: int) -> int | None:
    """The exit status of a process that is over."""
    done, status = os.waitpid(child, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if done else None


def is_writing(folder: Path) -> bool:
    """Whether something is being written at this moment."""
    return any(one.name.endswith(".tmp") or one.name == "partial" for one in folder.rglob("*"))


def one_try(words: list[str], folder: Path, log: Path, kill: Callable[[float], bool], spawn: bool) -> int | None:
    """Run a command until it ends (its exit status) or is killed (None)."""
    child, begun = start(words, log, spawn), time.monotonic()
    while (code := ended(child)) is None:
        since = time.monotonic() - begun
        if kill(since):
            os.killpg(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            code = os.waitstatus_to_exitcode(status)
            return None if code == -signal.SIGKILL else code
        assert since < LONGEST, f"it hangs: {words}"
        time.sleep(0.0005)
    return code


def campaign(work: Work, kills: int, spawned: float, chance: np.random.Generator, base: Path) -> Count:
    """Kill a work so many times, each as far as it comes, and compare what it comes to in the end."""
    count, log = Count(), base / f"{work.name.replace(' ', '-')}.log"
    whole = base / "whole" / "run"
    work.prepare(whole)
    begun = time.monotonic()
    for _ in range(2):  # the first one fills caches; twice in a row gives the same
        shutil.rmtree(whole)
        work.prepare(whole)
        begun = time.monotonic()
        assert one_try(work.words(whole), whole, log, lambda _: False, spawn=False) == 0, log.read_text()[-2000:]
    count.unbroken_s = time.monotonic() - begun
    wanted = work.result(whole)
    number = 0
    while count.kills < kills:
        folder = base / f"try-{number}" / "run"
        number += 1
        work.prepare(folder)
        words = work.words(folder)
        while True:
            over = one_try(words, folder, log, moment(count, kills, folder, chance), chance.random() < spawned)
            if over is not None:
                assert over == 0, f"{words} ended with {over}:\n{log.read_text()[-2000:]}"
                break
            count.kills += 1
            files, left, torn = check(folder)
            count.files += files
            count.leftovers += left
            count.torn += torn
            words = work.again(folder)
        count.finished += 1
        found = work.result(folder)
        different = sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))
        count.equal += not different
        count.differ += [f"{folder}: {name}" for name in different]
        hidden = [one for one in folder.rglob(".*") if one.is_file()]
        count.differ += [f"{one} is left in the end" for one in hidden]
        if not different:
            shutil.rmtree(folder.parent)
        print(f"  {work.name}: {count.kills} kills, {count.finished} finished", file=sys.stderr, flush=True)
    return count


def moment(count: Count, kills: int, folder: Path, chance: np.random.Generator) -> Callable[[float], bool]:
    """When the next kill comes: at a random time, or soon after something begins to be written."""
    if count.kills >= kills:
        return lambda since: False
    at = chance.uniform(0.0, 1.1 * count.unbroken_s)
    if chance.random() < 0.5:
        return lambda since: since >= at
    later = chance.uniform(0.0, 0.003)

    def writes(since: float) -> bool:
        if since < 0.8 * at or not is_writing(folder):
            return False
        time.sleep(later)
        count.writing += 1
        return True

    return writes


def digest(data: bytes | str) -> str:
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()


def fit_result(folder: Path) -> dict[str, str]:
    """Every file of a fit; in the page, all but the seconds it took."""
    found = {}
    for path in sorted(one for one in folder.rglob("*") if one.is_file() and not one.name.startswith(".")):
        text = path.read_bytes()
        if path.suffix == ".html":
            text = re.sub(rb"[0-9.]+ s\b", b"", text)
        found[path.relative_to(folder).as_posix()] = digest(text)
    return found


def run_result(folder: Path) -> dict[str, str]:
    """Every file of a run but pictures, pages and TensorBoard; of tables and descriptions, all but times."""
    found = {}
    for name in ("weights.safetensors", "policy.onnx", "deploy.json"):
        found[f"policy/{name}"] = digest((folder / "policy" / name).read_bytes())
    found["latest/weights.safetensors"] = digest((folder / "latest" / "weights.safetensors").read_bytes())
    for name in ("run.yaml", "policy/run.yaml", "latest/run.yaml"):
        said = yaml.safe_load((folder / name).read_text())
        said.get("trained", {}).pop("minutes", None)
        found[name] = digest(json.dumps(said, sort_keys=True))
    for name in ("progress.csv", "evaluations.csv"):
        with (folder / name).open(newline="") as file:
            rows = [{key: one for key, one in row.items() if key not in TIMES} for row in csv.DictReader(file)]
        found[name] = digest(json.dumps(rows))
    (last,) = (folder / "checkpoints").iterdir()
    with np.load(last / "state.npz") as file:
        for name in file.files:
            if name not in ("progress.rows", "progress.elapsed_s", "evaluations.rows", "published.trained"):
                found[f"checkpoint {name}"] = digest(file[name].tobytes())
    with zipfile.ZipFile(last / "model.zip") as file:
        for name in ("policy.pth", "actor.optimizer.pth", "critic.optimizer.pth"):
            if name in file.namelist():
                found[f"checkpoint {name}"] = digest(file.read(name))
    return found


def cut(path: Path, out: Path) -> None:
    """A short log of a bench: two trajectories at two gains, 2.6 s each."""
    chosen = [
        one for one in read_log(path)
        if one.rig.mass == 0.31 and one.rig.firmware_gain != 16.0 and one.rig.trajectory in ("lift_and_drop", "sin_sin")
    ]  # fmt: skip
    short = []
    for one in chosen:
        signals = {k: Signal(k, s.unit, s.t[s.t < 2.6], s.y[s.t < 2.6]) for k, s in one.signals.items()}
        short.append(replace(one, signals=signals))
    write_mcap(out, short)


def models(folder: Path) -> None:
    """The nominal robot in a folder."""
    (folder / "robot_model").mkdir(parents=True)
    for path in (REPO / "robot_model").glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, folder / "robot_model")


def works(base: Path) -> list[Work]:
    """The four of them, on logs that are made here."""
    bench, robot = base / "bench.mcap", base / "robot.mcap"
    cut(REPO / "bench_logs" / "mx64.mcap", bench)
    held = ["simulate", "--robot", "--base", "fixed", "--seed", "3", "--seconds", "6", "--holds", "upright"]
    simulated = [*held, "--model", str(REPO / "robot_model" / "nominal.xml"), "--out", str(robot)]
    assert run_command(frasa_sysid.cli.build_parser(), simulated) == 0

    def fit(log: Path, *more: str) -> Callable[[Path], list[str]]:
        def words(folder: Path) -> list[str]:
            model = str(folder / "robot_model" / "nominal.xml")
            return ["frasa-sysid", "fit", str(log), "--model", model, "--publish", *more]

        return words

    of_bench = fit(bench, "--bootstrap", "20", "--no-report")
    with_page = fit(bench, "--friction", "m2", "--effects", "auto")
    of_robot = fit(robot, "--free", "delays", "--no-report")
    sets = [word for one in TINY for word in ("--set", one)]
    nominal = str(REPO / "robot_model" / "nominal.xml")

    def train(folder: Path) -> list[str]:
        more = ["--steps", "480", "--device", "cpu", "--physics", "fast", "--no-report", "--out", str(folder)]
        return ["frasa-rl", "train", "--model", nominal, *sets, *more]

    def train_on(folder: Path) -> list[str]:
        if not (folder / "run.yaml").exists():
            return train(folder)  # nothing was saved yet
        return ["frasa-rl", "train", "--resume", str(folder), "--no-report"]

    def empty(folder: Path) -> None:
        folder.mkdir(parents=True)

    return [
        Work("fit", of_bench, of_bench, models, fit_result),
        Work("fit, page", with_page, with_page, models, fit_result),
        Work("robot fit", of_robot, of_robot, models, fit_result),
        Work("training", train, train_on, empty, run_result),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fits", type=int, default=60)
    parser.add_argument("--pages", type=int, default=10, help="of fits with a choice, the law M2 and a page")
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--trainings", type=int, default=100)
    parser.add_argument("--spawn", type=float, default=0.1, help="share of the tries that are a new Python")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        base = Path(name)
        os.environ["FRASA_CACHE"] = str(base / "cache")
        print(f"kill -9, seed {args.seed}; {args.spawn:.0%} of the tries in a new Python, the others forked")
        print("work       unbroken   kills  in writing  ended  files read  not whole  leftovers  torn pairs  equal")
        many = (args.fits, args.pages, args.robots, args.trainings)
        for number, (work, kills) in enumerate(zip(works(base), many, strict=True)):
            if kills:
                chance = np.random.default_rng([args.seed, number])
                one = campaign(work, kills, args.spawn, chance, base / work.name.replace(" ", "-"))
                print(
                    f"{work.name:<10} {one.unbroken_s:6.1f} s  {one.kills:6d}  {one.writing:10d}  {one.finished:5d}"
                    f"  {one.files:10d}  {0:9d}  {one.leftovers:9d}  {one.torn:10d}  {one.equal} of {one.finished}",
                    flush=True,
                )
                for words in one.differ:
                    print(f"  DIFFERS {words}")
                assert not one.differ


if __name__ == "__main__":
    main()

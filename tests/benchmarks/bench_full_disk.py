"""Every command that writes, on a disk that is full and on one that fills on the way: a tmpfs, which needs root.

Each has to end with exit 1 and one line (what could not be written, why, what to do), with nothing half-written and
what was there as it was; and, once there is room, the same command (a run: --resume) has to come to its end.

    python tests/benchmarks/bench_full_disk.py [WORDS]        # only commands with one of these words
"""

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from whole_files import LEFTOVER, check

REPO = Path(__file__).parents[2]
SIZE = 24  # [MB]
TINY = (
    "envs=4", "pool=8", "batch=16", "actor=16,16", "critic=16,16", "learning_starts=40", "renorm_warmup=20",
    "evaluate_falls=1", "evaluate_physics=fast", "evaluate_steps=0", "checkpoint_steps=64", "updates_per_step=0.1",
    "end_gyro=5",
)  # fmt: skip
SETS = " ".join(f"--set {one}" for one in TINY)
POLICY, LOG = REPO / "robot_model/policies/standup", REPO / "bench_logs/mx64.mcap"
MODEL = REPO / "robot_model/nominal.xml"
# command, room that is left [KiB], command once there is room (the same where empty)
CASES = (
    (f"frasa-sysid fit {LOG} --model rm/nominal.xml --publish", 40, ""),
    ("frasa-sysid publish rm/fits/mx64.json --model rm/nominal.xml --as m1", 2, ""),
    (f"frasa-sysid import {LOG} --format mcap --out logs", 100, ""),
    ("frasa-sysid simulate --servo mx64 --out log.mcap", 100, ""),
    ("frasa-sysid excite --base floating --model rm/nominal.xml --out goals.mcap --csv --seconds 12", 60, ""),
    (f"frasa-sysid compare {LOG} --model rm/nominal.xml --fit rm/fits/mx64.json --report page.html", 40, ""),
    (f"frasa-rl train --model {MODEL} --device cpu {SETS} --steps 128 --out run", 250, "frasa-rl train --resume run"),
    (f"frasa-rl evaluate {POLICY} --model {MODEL} --allow-other-model --protocol standup --trials 1 --out e", 40, ""),
    (f"frasa-rl export {POLICY} --model {MODEL} --allow-other-model --out export", 200, ""),
    (f"frasa-rl sweep --seeds 2 --jobs 1 --model {MODEL} --device cpu {SETS} --steps 64 --out sweep", 250,
     "frasa-rl sweep --resume sweep --jobs 1"),
)  # fmt: skip


def run(command: str, folder: Path) -> tuple[int, str]:
    """A command of frasa in a folder: exit status and its last line for people."""
    program, *words = command.split()
    cache = {"FRASA_CACHE": str(folder.parent / "cache")}
    done = subprocess.run(
        [sys.executable, "-m", program.replace("-", "_") + ".cli", *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(REPO), **cache}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stderr.strip().rpartition("\n")[2]


def fill(folder: Path, left: int) -> Path:
    """Leave so many KiB: the file that takes the rest."""
    filler = folder / "filler"
    with suppress(OSError), filler.open("wb", buffering=0) as file:
        while file.write(b"\0" * 4096):
            pass
    os.truncate(filler, max(filler.stat().st_size - left * 1024, 0))
    return filler


def contents(folder: Path) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


def prepare(folder: Path) -> None:
    """A model, a fit and its publication."""
    (folder / "rm").mkdir(parents=True)
    for path in (REPO / "robot_model").glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, folder / "rm")
    words = "--model rm/nominal.xml --publish --no-report --seed 9"
    code, last = run(f"frasa-sysid fit {LOG} {words}", folder)
    assert code == 0, last


def tried(folder: Path, template: Path, command: str, left: int, again: str) -> str:
    """One case, in a copy of what was prepared: what the command said."""
    for old in folder.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    shutil.copytree(template, folder, dirs_exist_ok=True)
    before = contents(folder)
    filler = fill(folder, left)
    code, last = run(command, folder)
    filler.unlink()
    assert code == 1, (code, last)
    after = contents(folder)
    replaced = sorted(name for name in before if after.get(name) != before[name])
    made = sorted(name for name in after if name not in before and not name.endswith(".log"))
    check(folder)
    hidden = [name for name in after if LEFTOVER.match(Path(name).name)]
    assert not hidden, hidden
    began = not again or any((folder / one).exists() for one in ("run/run.yaml", "sweep/sweep.json"))
    code, said = run(again if again and began else command, folder)
    assert code == 0, said
    check(folder)
    kept = "all old files as they were" if not replaced else f"whole and new: {', '.join(replaced)}"
    more = f"; whole: {len(made)} more files" if made else ""
    return f"{last}\n      {kept}{more}; then {'resumed' if again and began else 'again'}: exit 0"


def main() -> None:
    if os.geteuid() != 0 or not shutil.which("mount"):
        print("not run: a disk of one's own (tmpfs) needs root; tests/*/test_full_disk.py need none")
        return
    with tempfile.TemporaryDirectory(prefix="full-") as name:
        folder = Path(name) / "disk"
        folder.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE}m", "tmpfs", str(folder)], check=True)
        template = Path(name) / "template"
        prepare(template)
        try:
            for command, left, again in CASES:
                if sys.argv[1:] and not any(f" {one} " in command for one in sys.argv[1:]):
                    continue
                short = " ".join(command.split()[:2])
                for room in (0, left) if " fit " in command or " train " in command else (left,):
                    said = tried(folder, template, command, room, again)
                    print(f"{short}, {room} KiB left\n      {said}", flush=True)
        finally:
            subprocess.run(["umount", str(folder)], check=True)


if __name__ == "__main__":
    main()

"""`make demo`: the whole chain through its own command lines, timed, with a page at the end.

Each step is the command a user would type; it is printed before it runs. The fits and the calibrated model go into the
demo's own folder, a copy of the robot's files: another processor's rounding moves the last digits of a fit, which makes
it another calibration, and the policy in the box belongs to the one in `robot_model/`.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from frasa_rl.demo_page import standing, write_page
from frasa_sysid.calibration import FrasaError, alone, run_command, say

SERVOS = ("mx106", "mx64")
ROBOT = Path("robot_model")
NOMINAL, CALIBRATED = "nominal.xml", "calibrated.xml"


class DemoError(FrasaError):
    """A step of the demo failed; its own message stands above."""


@dataclass
class Demo:
    """What the demo has done so far.

    Attributes:
        out: folder of the page and pictures.
        steps: title, command as typed, and seconds of each step.
        results: what each step printed with `--json`, by name.
    """

    out: Path
    steps: list[tuple[str, str, float]] = field(default_factory=list)
    results: dict[str, Any] = field(default_factory=dict)

    def run(self, title: str, name: str, program: str, *words: str) -> None:
        """Run a command of frasa and keep its JSON.

        Raises:
            DemoError: it ended with another status than 0.
        """
        command = " ".join((program, *words))
        say(f"\n=== {title}\n$ {command}")
        started = time.monotonic()
        # The command of this very environment, whatever else is on the path.
        script = Path(sys.executable).with_name(program)
        done = subprocess.run([script, *words, "--json"], stdout=subprocess.PIPE, check=False)
        seconds = time.monotonic() - started
        if done.returncode != 0:
            raise DemoError(f"'{command}' ended with exit status {done.returncode}")
        self.results[name] = json.loads(done.stdout)
        self.steps.append((title, command, seconds))
        say(f"    {seconds:.0f} s")


def copy_of_robot(to: Path) -> Path:
    """The robot's files without fits and without what was published from them, in a folder of their own."""
    shutil.rmtree(to, ignore_errors=True)
    to.mkdir(parents=True)
    generated = {CALIBRATED, "randomization.yaml"}
    for file in sorted([*ROBOT.glob("*.xml"), *ROBOT.glob("*.yaml")]):
        if file.name not in generated:
            shutil.copyfile(file, to / file.name)
    return to


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Run the chain and write the page.

    Raises:
        DemoError: a step failed.
    """
    with alone(args.out, folder=True):
        return _run_alone(args)


def _run_alone(args: argparse.Namespace) -> dict[str, Any]:
    """The chain, with nobody else writing the same folder."""
    demo = Demo(args.out)
    started = time.monotonic()
    training = args.out / "run"
    shutil.rmtree(training, ignore_errors=True)
    robot = copy_of_robot(args.out / ROBOT.name)
    model = robot / CALIBRATED
    for servo in SERVOS:
        log = f"bench_logs/{servo}.mcap"
        flags = ("--model", str(robot / NOMINAL), "--friction", "auto", "--publish")
        demo.run(f"Choose the {servo}'s friction law, fit and publish", servo, "frasa-sysid", "fit", log, *flags)
    budget = ("--minutes", f"{args.minutes:g}")
    demo.run(
        f"Train for {args.minutes:g} minutes", "train", "frasa-rl", "train",
        "--model", str(model), *budget, "--out", str(training),
    )  # fmt: skip
    trials = ("--trials", str(args.trials), "--push-trials", str(args.push_trials))
    demo.run("Evaluate", "evaluate", "frasa-rl", "evaluate", str(training), *trials,
             "--report", str(args.out / "evaluation.html"))  # fmt: skip
    demo.run("Evaluate doing nothing", "nothing", "frasa-rl", "evaluate", "nothing",
             "--model", str(model), *trials, "--no-report")  # fmt: skip
    film = args.out / "standup.webp"
    demo.run("Film a trial", "play", "frasa-rl", "play", str(training), "--video", str(film))
    page = write_page(args.out, demo.steps, demo.results, training, film, model)
    seconds = time.monotonic() - started
    say("\nHow long each part took:")
    for title, _, part in demo.steps:
        say(f"  {part:5.0f} s  {title}")
    say(f"  {seconds:5.0f} s  in all")
    say(f"Training: {standing(demo.results['train'])}.")
    say(f"Open {page}")
    return {"schema": "frasa.demo/1", "seconds": seconds, "steps": demo.steps, "outputs": {"page": page}}


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="frasa-demo", description="The whole chain, once, on the project's own logs.")
    parser.add_argument("--minutes", type=float, default=4.0, help="of training [%(default)s]")
    parser.add_argument("--trials", type=int, default=10, help="evaluation trials a side [%(default)s]")
    parser.add_argument("--push-trials", type=int, default=3, help="trials of each push [%(default)s]")
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for page and pictures [%(default)s]")
    parser.set_defaults(run=run)
    return run_command(parser)


if __name__ == "__main__":
    sys.exit(main())

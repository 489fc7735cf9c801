"""frasa-rl init."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration import UsageError, add_json_flag, say

SCHEMA = "frasa.init/1"
MODEL, TASK = "nominal.xml", "standup.yaml"
Subparsers = Any  # argparse keeps the type of its subparsers private


def add_command(commands: Subparsers) -> None:
    """Add `init` to the command line."""
    parser = commands.add_parser(
        "init",
        help="a robot of your own: a first task file and a model to fit and train, from its MJCF",
        description="Look at a humanoid's MuJoCo XML: its servos, mirrored joints, a pose it stands in, feet, sensors. "
        "Write a copy with servo classes and sensors, a task file, and a table of each servo; say what was found and "
        "added, and what only you can know.",
    )
    parser.add_argument("--model", type=Path, required=True, metavar="XML", help="the robot, with a floor")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write; must not hold a robot yet"
    )
    parser.add_argument(
        "--servo",
        action="append",
        default=[],
        metavar="NAME=JOINTS",
        help="which joints a servo turns: mx64='*ankle*,*knee*'; again for more [those with equal numbers are one]",
    )
    parser.add_argument("--supply-voltage", type=float, metavar="V", help="at which the model's gains hold [12]")
    parser.add_argument("--firmware-gain", type=float, metavar="P", help="of the servos, at which they do [1]")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    from frasa_rl.own_robot import own_robot  # lxml and simulation only where they are needed

    named = _named(args.servo)
    for word in ("supply_voltage", "firmware_gain"):
        value = getattr(args, word)
        if value is not None and not 0.0 < value < 1e5:
            raise UsageError(f"--{word.replace('_', '-')} {value:g}: expected a number above 0")
    present = [path for name in (MODEL, TASK) if (path := args.out / name).exists()]
    if present:
        raise UsageError(f"{', '.join(map(str, present))} is there already: choose another --out, or remove it")
    found = own_robot(args.model, named, args.supply_voltage, args.firmware_gain)
    for line in found.lines:
        say(line)
    paths = found.write(args.out / MODEL, args.out / TASK)
    say(f"\nwritten: {', '.join(str(path) for path in paths)}")
    model, task = args.out / MODEL, args.out / TASK
    say(f"next: frasa-rl train --model {model} --task {task} --minutes 5 --out runs/{args.out.name}")
    return {
        "schema": SCHEMA,
        "trunk": found.task.names.trunk,
        "joints": [vars(replace(one)) for one in found.task.joints],
        "servos": found.servo_of,
        "stance": found.stance.origin,
        "target_pitch_deg": found.task.target_pitch_deg,
        "added": list(found.added),
        "questions": list(found.questions),
        "outputs": {"model": model, "task": task, "servos": [path for path in paths if path.suffix == ".toml"]},
    }


def _named(words: list[str]) -> dict[str, str]:
    """Servo by pattern of joint names."""
    named: dict[str, str] = {}
    for word in words:
        name, equals, patterns = word.partition("=")
        several = [one.strip() for one in patterns.split(",") if one.strip()]
        if not equals or not several:
            raise UsageError(f"--servo {word}: expected NAME=JOINTS, such as mx64='*ankle*,*knee*'")
        named.update(dict.fromkeys(several, name.strip()))
    return named

"""`frasa-sysid excite`: joint trajectories to record on a robot, and what each part is for."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from frasa_sysid.calibration import add_json_flag, say, sha256_of_file
from frasa_sysid.commands.progress import shown_share
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_file import write_csv, write_excitation
from frasa_sysid.excitation_hung import SHORTEST
from frasa_sysid.excitation_plan import LONGEST, NO_INFORMATION, UNITS, Plan, Prediction, chosen, plan
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.robot_body import Joints, joints_of

SCHEMA = "frasa.excite/1"
MODEL = Path("robot_model/nominal.xml")
COLOURS = {"good": "green", "weak": "yellow", "not excited": "red"}


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `excite` to the command line."""
    parser = subparsers.add_parser(
        "excite",
        help="joint trajectories to record on a robot",
        description="Write goals to send to a robot whose trunk is held (or that stands), within its joint, speed and "
        "torque limits and clear of itself on the nominal model, and predict how well a log of them tells each "
        "parameter.",
    )
    parser.add_argument("--model", type=Path, default=MODEL, metavar="XML", help=f"nominal model [{MODEL}]")
    parser.add_argument("--base", choices=("fixed", "floating"), default="fixed", help="trunk held [fixed] or standing")
    parser.add_argument("--joints", nargs="+", default=[], metavar="NAME", help="joints that move [all]")
    parser.add_argument("--parameters", nargs="+", default=[], metavar="NAME", help="what must be told [all]")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S", help="to begin with [30]")
    parser.add_argument("--out", required=True, type=Path, metavar="TRAJ", help="MCAP file to write")
    parser.add_argument("--csv", type=Path, nargs="?", const=True, metavar="FILE", help="and as text [TRAJ.csv]")
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Design, show and write.

    Raises:
        UsageError: joints, parameters or a duration that make no sense.
    """
    if not SHORTEST <= args.seconds <= LONGEST:
        raise UsageError(f"--seconds {args.seconds:g}: expected {SHORTEST:g} to {LONGEST:g}")
    joints = joints_of(args.model)
    planned = None if args.base == "floating" else _planned(args, joints)
    excitation = _standing(args, joints) if planned is None else planned.excitation
    outputs = _write(args, excitation)
    console = Console(stderr=True, highlight=False)
    _show_parts(console, excitation)
    if planned is not None:
        _show_plan(console, planned)
    say(f"{args.out}: {excitation.seconds:g} s of goals for {len(excitation.joints)} joints ({args.base} base)")
    return {
        "schema": SCHEMA,
        "base": args.base,
        "seconds": excitation.seconds,
        "parts": [vars(part) for part in excitation.parts],
        "parameters": {} if planned is None else {one.name: _described(one) for one in planned.predictions},
        "untold": NO_INFORMATION if args.base == "fixed" else {},
        "joints": {} if planned is None else _limits(planned),
        "outputs": outputs,
    }


def _planned(args: argparse.Namespace, joints: Joints) -> Plan:
    unknown = sorted(set(args.joints) - set(joints.names))
    if unknown:
        raise UsageError(f"--joints {' '.join(unknown)}: the model has {', '.join(joints.names)}")
    parameters = chosen(joints, args.parameters)
    with shown_share("excitation") as progress:
        return plan(args.model, joints, args.joints or joints.names, parameters, args.seconds, progress)


def _standing(args: argparse.Namespace, joints: Joints) -> Excitation:
    if args.joints or args.parameters:
        raise UsageError("--joints and --parameters need --base fixed; a standing robot moves as a whole")
    return standing(joints, args.seconds)


def _write(args: argparse.Namespace, excitation: Excitation) -> dict[str, Any]:
    write_excitation(args.out, excitation, args.base)
    outputs = {"trajectory": args.out, "sha256": sha256_of_file(args.out)}
    if args.csv:
        text = args.out.with_suffix(".csv") if args.csv is True else args.csv
        write_csv(text, excitation)
        outputs["csv"] = text
    return outputs


def _described(one: Prediction) -> dict[str, Any]:
    return {"half_width": one.half_width, "wanted": one.wanted, "verdict": one.verdict, "part": one.part}


def _limits(planned: Plan) -> dict[str, Any]:
    goals, trial = planned.excitation.goals, planned.trial
    each = zip(planned.excitation.joints, goals.T, trial.torque.max(0), trial.speed.max(0), strict=True)
    return {
        name: {"low": goal.min(), "high": goal.max(), "torque_share": torque, "speed_share": speed}
        for name, goal, torque, speed in each
    }


def _show_parts(console: Console, excitation: Excitation) -> None:
    table = Table(title=f"{excitation.seconds:g} s, part by part", title_justify="left", title_style="bold")
    for heading in ("part", "from s", "to s", "what it is for"):
        table.add_column(heading, justify="right" if heading.endswith(" s") else "left")
    for part in excitation.parts:
        table.add_row(part.name, f"{part.start:.2f}", f"{part.end:.2f}", part.purpose)
    console.print(table)


def _show_plan(console: Console, planned: Plan) -> None:
    table = Table(title="Predicted 95 % intervals", title_justify="left", title_style="bold")
    for heading in ("parameter", "half width", "wanted", "verdict", "mostly from"):
        table.add_column(heading)
    for one in planned.predictions:
        colour = COLOURS[one.verdict]
        shown = "-" if one.verdict == "not excited" else _number(one, one.half_width)
        table.add_row(one.name, shown, _number(one, one.wanted), f"[{colour}]{one.verdict}[/]", one.part)
    console.print(table)
    if planned.grown_from is not None:
        console.print(f"Longer than the {planned.grown_from:g} s asked for, so that more parameters are told.")
    blind = [one.name for one in planned.predictions if one.verdict == "not excited"]
    if blind:
        console.print(f"Not told by a trunk held upright (gravity hardly turns them): {', '.join(blind)}")
    for name, why in NO_INFORMATION.items():
        console.print(f"Not told: {name}: {why}")
    trial = planned.trial
    console.print(
        f"On the nominal model: torques up to {100 * np.max(trial.torque):.0f} % of the limit, speeds up to "
        f"{100 * np.max(trial.speed):.0f} % of no load, no contact of the robot with itself."
    )


def _number(one: Prediction, value: float) -> str:
    scale, unit = UNITS[one.name.rpartition(".")[2]]
    return f"{scale * value:.2g} {unit}"

"""`frasa-sysid excite`: joint trajectories to record on a robot, how to hold it, and what each part is for."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from frasa_sysid.calibration import add_json_flag, input_hashes, say, sha256_of_file
from frasa_sysid.commands.bench import people_console
from frasa_sysid.commands.progress import shown_share
from frasa_sysid.errors import UsageError
from frasa_sysid.excitation import Excitation
from frasa_sysid.excitation_file import write_csv, write_excitation
from frasa_sysid.excitation_hung import SHORTEST
from frasa_sysid.excitation_plan import LONGEST, NO_INFORMATION, UNITS, Plan, Prediction, chosen, plan
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.excitation_trial import FloatArray, largest
from frasa_sysid.holds import HOLDS, RECOMMENDED, gain_of, holds_of
from frasa_sysid.robot_body import Joints, joints_of

SCHEMA = "frasa.excite/1"
MODEL = Path("robot_model/nominal.xml")
SOFT = (
    "Set P of all servos to {gain:g} while recording, and tell the fit: frasa-sysid fit ... --firmware-gain {gain:g}."
)
BETWEEN = "One log each: clamp the trunk, record, stop, turn the robot. All logs go to one frasa-sysid fit."
COLOURS = {"good": "green", "weak": "yellow", "not excited": "red"}


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `excite` to the command line."""
    parser = subparsers.add_parser(
        "excite",
        help="joint trajectories to record on a robot",
        description="Write goals to send to a robot whose trunk is held (or that stands), within its joint, speed and "
        "torque limits and clear of itself on the nominal model, a file for each way to hold it, and predict how well "
        "logs of them tell each parameter.",
    )
    parser.add_argument("--model", type=Path, default=MODEL, metavar="XML", help=f"nominal model [{MODEL}]")
    parser.add_argument("--base", choices=("fixed", "floating"), default="fixed", help="trunk held [fixed] or standing")
    parser.add_argument(
        "--holds",
        metavar="LIST",
        help=f"ways to hold the trunk, one log each, of {','.join(HOLDS)} [{','.join(RECOMMENDED)}]",
    )
    parser.add_argument(
        "--firmware-gain",
        type=float,
        metavar="P",
        help="of the servos meanwhile, in the firmware's unit [a third of the model's: soft, so that gravity shows]",
    )
    parser.add_argument("--joints", nargs="+", default=[], metavar="NAME", help="joints that move [all]")
    parser.add_argument("--parameters", nargs="+", default=[], metavar="NAME", help="what must be told [all]")
    parser.add_argument(
        "--seconds", type=float, default=30.0, metavar="S", help="of all holds together, to begin with [30]"
    )
    parser.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="TRAJ",
        help="MCAP file to write; of several holds each gets its own, TRAJ-HOLD",
    )
    parser.add_argument(
        "--csv", type=Path, nargs="?", const=True, metavar="FILE", help="and as text [TRAJ.csv]; named likewise"
    )
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Design, show and write.

    Raises:
        UsageError: joints, parameters or a duration that make no sense.
    """
    holds = _holds(args)
    joints = joints_of(args.model)
    planned = None if args.base == "floating" else _planned(args, joints, holds)
    excitations = (_standing(args, joints),) if planned is None else planned.excitations
    outputs = [_write(args, one, len(excitations)) for one in excitations]
    _show(excitations, planned)
    for one, output in zip(excitations, outputs, strict=True):
        how = f"held {one.hold}: {HOLDS[one.hold].words}" if planned else "on its feet"
        say(f"{output['trajectory']}: {one.seconds:g} s of goals for {len(one.joints)} joints of a robot {how}")
    if planned:
        say(SOFT.format(gain=excitations[0].firmware_gain))
    if len(excitations) > 1:
        say(BETWEEN)
    return {
        "schema": SCHEMA,
        "base": args.base,
        "seconds": sum(one.seconds for one in excitations),
        "holds": list(holds) if planned else [],
        "firmware_gain": excitations[0].firmware_gain,
        "parts": [{"hold": one.hold, **vars(part)} for one in excitations for part in one.parts],
        "parameters": {} if planned is None else {one.name: _described(one) for one in planned.predictions},
        "untold": NO_INFORMATION if args.base == "fixed" else {},
        "joints": {} if planned is None else _limits(planned),
        "outputs": outputs,
    }


def _holds(args: argparse.Namespace) -> tuple[str, ...]:
    holds = holds_of(args.holds)
    least = SHORTEST * (len(holds) if args.base == "fixed" else 1)
    if not least <= args.seconds <= LONGEST:
        each = f", {SHORTEST:g} s for each of --holds {','.join(holds)}" if least > SHORTEST else ""
        raise UsageError(f"--seconds {args.seconds:g}: expected {least:g} to {LONGEST:g}{each}")
    return holds


def _planned(args: argparse.Namespace, joints: Joints, holds: Sequence[str]) -> Plan:
    unknown = sorted(set(args.joints) - set(joints.names))
    if unknown:
        raise UsageError(f"--joints {' '.join(unknown)}: the model has {', '.join(joints.names)}")
    parameters = chosen(joints, args.parameters)
    with shown_share("excitation") as progress:
        return plan(
            args.model,
            joints,
            args.joints or joints.names,
            parameters,
            args.seconds,
            holds,
            gain_of(args.firmware_gain, joints.firmware_gain),
            progress,
        )


def _standing(args: argparse.Namespace, joints: Joints) -> Excitation:
    if args.joints or args.parameters or args.holds or args.firmware_gain:
        raise UsageError(
            "--joints, --parameters, --holds and --firmware-gain need --base fixed; a standing robot moves as a whole"
        )
    return standing(joints, args.seconds)


def _write(args: argparse.Namespace, excitation: Excitation, count: int) -> dict[str, Any]:
    def named(path: Path) -> Path:
        return path if count == 1 else path.with_name(f"{path.stem}-{excitation.hold}{path.suffix}")

    out = named(args.out)
    write_excitation(out, excitation, args.base, {"command": "excite", "inputs": input_hashes([args.model])})
    outputs = {"hold": excitation.hold, "trajectory": out, "sha256": sha256_of_file(out)}
    if args.csv:
        text = out.with_suffix(".csv") if args.csv is True else named(args.csv)
        write_csv(text, excitation)
        outputs["csv"] = text
    return outputs


def _described(one: Prediction) -> dict[str, Any]:
    return {"half_width": one.half_width, "wanted": one.wanted, "verdict": one.verdict, "part": one.part}


def _limits(planned: Plan) -> dict[str, Any]:
    goals = np.concatenate([one.goals for one in planned.excitations])
    torques, speeds = (_most(planned, name) for name in ("torque", "speed"))
    each = zip(planned.excitations[0].joints, goals.T, torques, speeds, strict=True)
    return {
        name: {"low": goal.min(), "high": goal.max(), "torque_share": torque, "speed_share": speed}
        for name, goal, torque, speed in each
    }


def _most(planned: Plan, name: str) -> FloatArray:
    """Largest share of a limit that each joint comes to in any hold, shape (n,)."""
    return np.asarray(np.max([largest(one)[name] for one in planned.trials], axis=0))


def _show(excitations: Sequence[Excitation], planned: Plan | None) -> None:
    console = people_console()
    for one in excitations:
        _show_parts(console, one, "on its feet" if planned is None else f"held {one.hold}")
    if planned is not None:
        _show_plan(console, planned)


def _show_parts(console: Console, excitation: Excitation, how: str) -> None:
    table = Table(title=f"{how}, {excitation.seconds:g} s, part by part", title_justify="left", title_style="bold")
    for heading in ("part", "from s", "to s", "what it is for"):
        table.add_column(heading, justify="right" if heading.endswith(" s") else "left", overflow="fold")
    for part in excitation.parts:
        table.add_row(part.name, f"{part.start:.2f}", f"{part.end:.2f}", part.purpose)
    console.print(table)


def _show_plan(console: Console, planned: Plan) -> None:
    table = Table(title="Predicted 95 % intervals", title_justify="left", title_style="bold")
    for heading in ("parameter", "half width", "wanted", "verdict", "mostly from"):
        table.add_column(heading, overflow="fold")
    for one in planned.predictions:
        colour = COLOURS[one.verdict]
        shown = "-" if one.verdict == "not excited" else _number(one, one.half_width)
        table.add_row(one.name, shown, _number(one, one.wanted), f"[{colour}]{one.verdict}[/]", one.part)
    console.print(table)
    if planned.grown_from is not None:
        console.print(f"Longer than the {planned.grown_from:g} s asked for, so that more parameters are told.")
    blind = [one.name for one in planned.predictions if one.verdict == "not excited"]
    if blind:
        console.print(f"Not told by these holds (gravity hardly turns them): {', '.join(blind)}")
    for name, why in NO_INFORMATION.items():
        console.print(f"Not told: {name}: {why}")
    console.print(
        f"On the nominal model: torques up to {100 * _most(planned, 'torque').max():.0f} % of the limit, speeds up to "
        f"{100 * _most(planned, 'speed').max():.0f} % of no load, no contact of the robot with itself."
    )


def _number(one: Prediction, value: float) -> str:
    scale, unit = UNITS[one.name.rpartition(".")[2]]
    return f"{scale * value:.2g} {unit}"

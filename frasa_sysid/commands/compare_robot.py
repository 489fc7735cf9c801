"""`frasa-sysid compare` on logs of the whole robot: simulated against measured, channel by channel."""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from frasa_sysid import stored_fit
from frasa_sysid.bench import inputs_of
from frasa_sysid.calibration import input_hashes, load_model, say, servo_classes, tell_report
from frasa_sysid.commands.bench import people_console
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.fit_json import ROBOT, read_json
from frasa_sysid.overlay import LAYOUT, robot_overlay
from frasa_sysid.recording import Recording
from frasa_sysid.report_robot import write_robot_comparison
from frasa_sysid.report_robot_tables import SHOWN
from frasa_sysid.robot_compare import Contender, compare_robot, last_share, of_bench_fits, of_model, of_robot_fit
from frasa_sysid.robot_errors import ChannelErrors, Compared, blown_up, errors_by_channel, pieces_in
from frasa_sysid.robot_rig import is_robot
from frasa_sysid.writer import write_mcap

REPORT = Path("compare.html")
SCHEMA = "frasa.compare/1"
NOMINAL = "nominal"


def compare_robot_logs(args: argparse.Namespace, recordings: Sequence[Recording]) -> dict[str, Any]:
    """Compare, show, and write a page when asked.

    Raises:
        LogError, ModelError, InputError, UsageError: bad input.
    """
    _check(args, recordings)
    choose = last_share(args.hold_out_share)
    with tempfile.TemporaryDirectory() as folder:
        found = {
            one.name: compare_robot(one, recordings, args.base, choose, args.threads)
            for one in _contenders(args, Path(folder))
        }
    errors = {name: errors_by_channel(compared) for name, compared in found.items()}
    _show(errors, args.hold_out_share)
    _warn(found)
    title = f"Whole robot: simulated over measured, {_part(args.hold_out_share)}"
    inputs = {**inputs_of(recordings), **input_hashes((args.model, *args.with_model, *args.fit))}
    report = None
    if not args.no_report:
        report = write_robot_comparison(args.report or REPORT, title, found, inputs_of(recordings))
        tell_report(report)
    if args.mcap is not None:
        write_overlay(args.mcap, robot_overlay(recordings, found), inputs)
    plain = {name: _plain(errors[name], compared) for name, compared in found.items()}
    return {
        "schema": SCHEMA,
        "kind": ROBOT,
        "servo": "",
        "hold_out_share": args.hold_out_share,
        "misfit": list(plain.values())[-1],
        "candidates": plain,
        "inputs": inputs,
        "outputs": {"report": report, "mcap": args.mcap},
    }


def write_overlay(path: Path, recordings: Sequence[Recording], inputs: Mapping[str, str]) -> None:
    """Write measured and simulated traces to one MCAP, and say how to look at them.

    Raises:
        UsageError: the file is one of the logs.
    """
    if path.exists() and any(path.samefile(one.source) for one in recordings if Path(one.source).exists()):
        raise UsageError(f"--mcap {path} is one of the logs that are compared; choose another file")
    write_mcap(path, recordings, made={"command": "compare", "inputs": dict(inputs)})
    say(f"measured and simulated traces: {path} (PlotJuggler opens it as it is; layout for Foxglove: {LAYOUT})")


def _check(args: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    single = [one.name for one in recordings if not is_robot(one)]
    if single:
        raise LogError(f"{single[0]} is of one joint and the others are of a whole robot; compare them apart")
    if not 0.0 <= args.hold_out_share <= 0.9:
        raise UsageError(f"--hold-out-share {args.hold_out_share:g}: expected 0 to 0.9")


def _contenders(args: argparse.Namespace, folder: Path) -> list[Contender]:
    """The nominal model, the models given, the bench fits given as one robot, and each fit of a robot."""
    found = [of_model(NOMINAL, args.model)]
    for path in args.with_model:
        found.append(of_model(_name(path, found), path))
    kinds = {path: read_json(path)[0].get("kind") for path in args.fit}
    benches = [path for path in args.fit if kinds[path] != ROBOT]
    if benches:
        fits = [stored_fit.load(path) for path in benches]
        known = servo_classes(load_model(args.model))
        other = [one.servo for one in fits if one.servo not in known]
        if other:
            raise UsageError(f"fit of {other[0]}: {args.model} has {', '.join(known)}")
        name = " + ".join(path.name for path in benches)
        found.append(of_bench_fits(name, fits, args.model, _inside(folder, len(found))))
    for path in (path for path in args.fit if kinds[path] == ROBOT):
        found.append(of_robot_fit(_name(path, found), path, args.model, _inside(folder, len(found))))
    return found


def _name(path: Path, taken: Sequence[Contender]) -> str:
    """The file's name, with its folder or all of its path where another contender has the same."""
    names = (path.name, f"{path.parent.name}/{path.name}", str(path))
    used = {one.name for one in taken}
    return next((name for name in names if name not in used), f"{path} ({len(taken)})")


def _inside(folder: Path, number: int) -> Path:
    path = folder / str(number)
    path.mkdir()
    return path


def _plain(errors: Mapping[str, ChannelErrors], compared: Sequence[Compared]) -> dict[str, Any]:
    position = errors["position"]
    return {
        "mae_rad": position.mae,
        "rmse_rad": position.rmse,
        "by_log": position.by_log,
        "by_joint": position.by_joint,
        "by_channel": {
            name: {
                "unit": one.unit,
                "mae": one.mae,
                "rmse": one.rmse,
                "by_log": one.by_log,
                "by_joint": one.by_joint,
            }
            for name, one in errors.items()
        },
        "pieces": pieces_in(compared),
        "blown_up": blown_up(compared),
    }


def _part(share: float) -> str:
    return f"last {share:.0%} of each log" if share else "whole logs"


def _show(errors: Mapping[str, Mapping[str, ChannelErrors]], share: float) -> None:
    console = people_console()
    channels = list(next(iter(errors.values())))
    table = Table(title=f"mean error, {_part(share)}", title_justify="left")
    table.add_column("", overflow="fold")
    for channel in channels:
        name, _, unit = SHOWN[channel]
        table.add_column(f"{name}, {unit}", justify="right", overflow="fold")
    table.add_column("position rms, mrad", justify="right", overflow="fold")
    table.add_column("worst joint", overflow="fold")
    for name, one in errors.items():
        cells = [f"{one[channel].mae * SHOWN[channel][1]:.3g}" for channel in channels]
        by_joint = one["position"].by_joint
        worst = max(by_joint, key=lambda joint: by_joint[joint])
        rms = f"{one['position'].rmse * 1e3:.3g}"
        table.add_row(name, *cells, rms, worst)
    console.print(table)
    positions = {name: one["position"] for name, one in errors.items()}
    if len(next(iter(positions.values())).by_log) > 1:
        console.print(_by("log", {name: one.by_log for name, one in positions.items()}))
    console.print(_by("joint", {name: one.by_joint for name, one in positions.items()}))


def _by(what: str, errors: Mapping[str, Mapping[str, float]]) -> Table:
    """Position errors [mrad] by log or joint, the worst of the last contender first."""
    table = Table(title=f"position by {what}, mrad", title_justify="left")
    table.add_column(what, overflow="fold")
    for name in errors:
        table.add_column(name, justify="right", overflow="fold")
    last = list(errors.values())[-1]
    for key in sorted(last, key=lambda one: -last[one]):
        table.add_row(key, *(f"{one[key] * 1e3:.3g}" for one in errors.values()))
    return table


def _warn(found: Mapping[str, Sequence[Compared]]) -> None:
    for name, compared in found.items():
        if count := blown_up(compared):
            say(f"{name}: the simulation blew up in {count} of {pieces_in(compared)} pieces, which count as 10 rad off")

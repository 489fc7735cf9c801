"""What the commands on bench logs share: reading with facts from the command line, and the simulator."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from frasa_sysid.bench import BENCH_MODEL, NOMINAL_MODEL, Bench, bench_of
from frasa_sysid.calibration import say
from frasa_sysid.commands.faults import show_faults
from frasa_sysid.commands.given_facts import OF_ANY, with_facts
from frasa_sysid.commands.import_facts import NUMBERS
from frasa_sysid.commands.log_kinds import KindGroup
from frasa_sysid.commands.reading import add_reading_arguments, read_within
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.logged_servo import stands_in
from frasa_sysid.recording import Recording

SERVO_HELP = "servo type where the logs do not say, or a table of your own (.toml) for it: see frasa-sysid servos"


def people_console() -> Console:
    """Where text for people goes: standard error, wide enough for the tables also when it is a file."""
    console = Console(stderr=True, highlight=False)
    return console if console.is_terminal else Console(stderr=True, highlight=False, width=120)


def add_bench_arguments(parser: argparse.ArgumentParser) -> KindGroup:
    """Logs, servo, and facts of the rig that the logs do not carry.

    Returns:
        The options that are for a bench only, for more of them.
    """
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="MCAP files, or folders of them")
    parser.add_argument("--model", type=Path, default=NOMINAL_MODEL, help="nominal robot model [%(default)s]")
    parser.add_argument("--clock", choices=("auto", "header", "publish", "log"), default="auto", help="which stamps")
    add_reading_arguments(parser)
    parser.add_argument("--threads", type=int, help="simulation threads [one per core]")
    bench = KindGroup(parser, "bench")
    bench.add("--servo", metavar="NAME_OR_TABLE", help=SERVO_HELP, instead="has the servos of its --model")
    bench.add(
        "--bench-model",
        type=Path,
        help="pendulum model [bench_pendulum.xml beside --model]",
        instead="is simulated by --model",
    )
    for name, unit in NUMBERS.items():
        option = f"--{name.replace('_', '-')}"
        help_text = f"[{unit}] for logs that do not carry it"
        if name in OF_ANY:
            parser.add_argument(option, type=float, metavar=unit.upper(), help=help_text)
        else:
            bench.add(option, type=float, metavar=unit.upper(), help=help_text, instead="has the bodies of its --model")
    return bench


def read_logs(args: argparse.Namespace) -> list[Recording]:
    """Recordings of all logs of a command, with what the command line says about them; their faults are shown.

    Raises:
        LogError: an unreadable log, or two of one name.
        UsageError: no log in a folder, no threads, or facts that contradict the logs.
    """
    if args.threads is not None and args.threads < 1:
        raise UsageError(f"--threads {args.threads}: expected 1 or more")
    facts = {name: getattr(args, name) for name in NUMBERS if getattr(args, name) is not None}
    recordings = with_facts(read_within(_files(args.logs), args), facts)
    _check_names(recordings)
    if any(recording.faults for recording in recordings):
        show_faults(people_console(), recordings)
    return recordings


def load_bench(
    args: argparse.Namespace, hold_out: str = "none", recordings: Sequence[Recording] | None = None
) -> Bench:
    """The bench of a command's logs.

    Args:
        args: of the command.
        hold_out: rule.
        recordings: of the logs, where they have been read already.

    Raises:
        LogError: an unreadable log, one that lacks a signal or fact, or two of one name.
        UsageError: no log in a folder, no threads, or a bad hold-out rule.
    """
    logs = read_logs(args) if recordings is None else recordings
    bench = bench_of(logs, args.model, hold_out, args.servo)
    if told := stands_in(logs, bench.servo.name, args.servo):
        say(told)
    return bench


def bench_model(args: argparse.Namespace) -> Path:
    """The pendulum model of a command."""
    given: Path | None = args.bench_model
    return given or args.model.with_name(BENCH_MODEL.name)


def _files(paths: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
        if not inside:
            raise LogError(f"{path} is a folder without any .mcap file; name logs, or import foreign ones first")
        found += [one for one in inside if one not in found]
    return found


def _check_names(recordings: Sequence[Recording]) -> None:
    """Results are told apart by these names; and one log given twice would count as two."""
    names = [one.name for one in recordings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LogError(f"{len(twice)} recordings come twice, such as {twice[0]}: give each log once, by its own name")

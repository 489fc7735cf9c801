"""`frasa-sysid import`: foreign logs -> MCAP, one file a source, the originals attached.

A source that cannot be read is named and costs no other; the exit status says at the
end that there was one.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration.command_line import add_json_flag, say
from frasa_sysid.commands.import_facts import add_fact_arguments, declared_facts
from frasa_sysid.commands.import_formats import (
    BESIDE,
    COMPANIONS,
    FIXED_UNITS,
    MAPPED,
    READERS,
    find_sources,
    name_of,
)
from frasa_sysid.commands.import_over import check_replaced
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.readers.effort import EFFORT_UNITS, UNDECLARED, declare_effort, undeclared
from frasa_sysid.readers.rig_facts import with_facts
from frasa_sysid.readers.signal_map import SignalMap, builtin_maps, load_map
from frasa_sysid.readers.sources import ANGLE_UNIT
from frasa_sysid.recording import Recording
from frasa_sysid.rig_table import RigRow, read_rig_table, with_rig
from frasa_sysid.servo import find_table, is_table
from frasa_sysid.writer import write_mcap

SCHEMA = "frasa.import/1"
ATTACHED = 2**26  # bytes; what is larger stays where it is, known by its sha256


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `import` to the command line."""
    parser = subparsers.add_parser(
        "import",
        help="bring foreign logs to MCAP, nothing lost",
        description="Bring foreign logs to MCAP: one file a source, with the originals attached. "
        "Known faults of such logs are handled and reported.",
    )
    parser.add_argument("sources", nargs="+", metavar="SRC", help="files, directories or quoted globs")
    parser.add_argument("--format", required=True, choices=sorted(READERS), help="what the sources are")
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the MCAP files")
    parser.add_argument(
        "--rig-table",
        type=Path,
        metavar="CSV",
        help="inertia and gravity by rig: columns mass, length, total_inertia, total_g_bias",
    )
    parser.add_argument(
        "--servo", metavar="NAME_OR_TABLE", help="servo type, where the log does not say or says it wrong"
    )
    add_fact_arguments(parser)
    parser.add_argument("--unit", choices=("rad", "deg"), help="unit of joint angles (default: rad, checked)")
    parser.add_argument(
        "--map",
        metavar="FILE_OR_NAME",
        help="which topics or columns are which signals, in which unit: a TOML file, or one of "
        f"{', '.join(builtin_maps())} ({', '.join(MAPPED)})",
    )
    parser.add_argument(
        "--effort-unit",
        choices=EFFORT_UNITS,
        help="what an effort is in: N m makes it the signal torque, A current; none drops it (default: not known)",
    )
    add_json_flag(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Import all sources.

    Raises:
        UsageError: arguments that do not go together.
        LogError: at least one source could not be imported; the others were.
    """
    if args.unit == "deg" and args.format in FIXED_UNITS:
        raise UsageError(f"--unit deg: {FIXED_UNITS[args.format]}, not degrees")
    facts = declared_facts(args)  # before anything is read
    mapping = _map(args)
    table = read_rig_table(args.rig_table) if args.rig_table else None
    sources, failed = _find_all(args.sources, args.format)
    outputs = _outputs(sources, args.out, args.format)
    done: list[dict[str, Any]] = []
    efforts = 0
    for source, out in zip(sources, outputs, strict=True):
        try:
            recordings = _import(source, args, facts, table, mapping)
            check_replaced(out, recordings)
            made = {"command": "import", "inputs": {one.source: one.sha256 for one in recordings}, **_said(args, facts)}
            write_mcap(out, recordings, {**_originals(source, args.format), **_map_file(mapping)}, made=made)
        except (LogError, PermissionError) as error:
            say(f"not imported: {error}")
            failed += 1
        else:
            done.append(_describe(source, out, recordings))
            efforts += 0 if args.effort_unit else undeclared(recordings)
    if done:
        _tell(done, args.out)
    if efforts:
        say(f"  {UNDECLARED.format(count=efforts)}")
    if failed:
        raise LogError(f"{failed} of {len(done) + failed} sources could not be imported")
    return {"schema": SCHEMA, "imported": done}


def _map(args: argparse.Namespace) -> SignalMap | None:
    """The map of the command line.

    Raises:
        UsageError: the format needs none, or units are declared twice.
        InputError: a map that cannot be used.
    """
    if args.map is None:
        return None
    if args.format not in MAPPED:
        raise UsageError(f"--map: {args.format} logs need none; maps are for {', '.join(MAPPED)}")
    mapping = load_map(args.map)
    if args.unit is not None and not mapping.builtin:
        raise UsageError(f"--unit {args.unit}: the map {mapping.name} declares the units already")
    return mapping


def _said(args: argparse.Namespace, facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the command line declared about the sources, for the record of how a file was made."""
    said = {**facts, "servo": args.servo, "unit": args.unit, "effort_unit": args.effort_unit}
    given = {name: value for name, value in said.items() if value is not None}
    return {"declared": given} if given else {}


def _map_file(mapping: SignalMap | None) -> dict[str, bytes]:
    """A user's own map, to go with what it made."""
    if mapping is None or mapping.builtin:
        return {}
    path = Path(mapping.name)
    return {path.name: path.read_bytes()}


def _find_all(arguments: Sequence[str], form: str) -> tuple[list[Path], int]:
    """The files of all arguments, and how many arguments stand for none; those are named."""
    found: dict[Path, None] = {}
    failed = 0
    for argument in arguments:
        try:
            found |= dict.fromkeys(find_sources(argument, form))
        except LogError as error:
            say(f"not imported: {error}")
            failed += 1
    return list(found), failed


def _originals(source: Path, form: str) -> dict[str, bytes]:
    files = [source, *(COMPANIONS[form](source) if form in COMPANIONS else [])]
    files += [source.parent / name for name in BESIDE.get(form, ()) if (source.parent / name).is_file()]
    size = sum(file.stat().st_size for file in files)
    if size > ATTACHED:
        say(f"  {source}: {size / 2**20:.0f} MiB are not attached; keep the original, its sha256 is noted")
        return {}
    return {file.name: file.read_bytes() for file in files}


def _outputs(sources: Sequence[Path], folder: Path, form: str) -> list[Path]:
    outputs = [folder / f"{name_of(source, form)}.mcap" for source in sources]
    for out, count in Counter(outputs).items():
        if count > 1:
            raise UsageError(f"{count} sources would become {out}; import them into different folders")
    for source, out in zip(sources, outputs, strict=True):
        if out.exists() and out.samefile(source):
            raise UsageError(f"{source} would be replaced by its own import; choose another --out")
    return outputs


def _import(
    source: Path,
    args: argparse.Namespace,
    facts: Mapping[str, Any],
    table: list[RigRow] | None,
    mapping: SignalMap | None,
) -> list[Recording]:
    # What a user's own map declares is not doubted; a built-in one knows the robot's kind, not the robot.
    declared = mapping is not None and not mapping.builtin
    recordings = READERS[args.format](source, args.unit or ("rad" if declared else "auto"), mapping)
    if args.effort_unit:
        recordings = [declare_effort(recording, args.effort_unit) for recording in recordings]
    of_map = {} if mapping is None else dict(mapping.rig)
    if args.servo:
        of_map.pop("servo", None)  # the option goes before both, the map and the log
    name = "" if mapping is None else f"map {mapping.name}"
    recordings = [with_facts(recording, facts, of_map, name) for recording in recordings]
    if table is not None:
        recordings = [with_rig(recording, table, args.rig_table) for recording in recordings]
    servo = find_table(args.servo).servo.name if args.servo and is_table(args.servo) else args.servo
    unit = args.unit or ("map" if declared else "format" if args.format in FIXED_UNITS else None)
    return [_finish(recording, source, servo, mapping, unit) for recording in recordings]


def _finish(
    recording: Recording, source: Path, servo: str | None, mapping: SignalMap | None, unit: str | None
) -> Recording:
    rig = replace(recording.rig, servo=servo.lower()) if servo else recording.rig
    origin = {"imported_from": source.name, "imported_sha256": recording.sha256}
    if mapping is not None:
        origin["map"] = Path(mapping.name).name
    if unit is not None:
        origin[ANGLE_UNIT] = unit
    return replace(recording, rig=rig, extra={**recording.extra, **origin})


def _describe(source: Path, out: Path, recordings: Sequence[Recording]) -> dict[str, Any]:
    faults: Counter[str] = Counter()
    for fault in (fault for recording in recordings for fault in recording.faults):
        faults[fault.code] += fault.count
    return {"source": str(source), "out": str(out), "recordings": len(recordings), "faults": dict(faults)}


def _tell(done: Sequence[Mapping[str, Any]], folder: Path) -> None:
    runs = sum(one["recordings"] for one in done)
    say(f"imported {len(done)} logs with {runs} recordings into {folder}")
    counts: Counter[str] = Counter()
    logs: Counter[str] = Counter()
    for one in done:
        counts.update(one["faults"])
        logs.update(one["faults"].keys())
    for code, count in sorted(counts.items()):
        say(f"  {code}: {count} in {logs[code]} of {len(done)} logs, handled")

"""`frasa-sysid import`: foreign logs -> MCAP, one file a source, the originals attached.

A source that cannot be read is named and costs no other; the exit status says at the
end that there was one.
"""

import argparse
import glob
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_sysid.calibration.command_line import add_json_flag, say
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.readers.bam import read_bam
from frasa_sysid.readers.dynaban import read_dynaban
from frasa_sysid.readers.emps import read_emps
from frasa_sysid.readers.harold import read_harold
from frasa_sysid.readers.imu_on_axis import read_imu_on_axis
from frasa_sysid.readers.jandi import TELEMETRY, companions, read_jandi
from frasa_sysid.readers.kbot import read_kbot
from frasa_sysid.readers.mcap import read_mcap
from frasa_sysid.readers.miuzei import read_miuzei
from frasa_sysid.readers.robstride import METADATA, read_robstride
from frasa_sysid.readers.rostopic_csv import read_rostopic_csv
from frasa_sysid.readers.sources import Unit
from frasa_sysid.readers.upkie import read_upkie
from frasa_sysid.recording import Recording
from frasa_sysid.rig_table import RigRow, read_rig_table, with_rig
from frasa_sysid.writer import write_mcap

SCHEMA = "frasa.import/1"
Read = Callable[[Path, Unit], list[Recording]]
READERS: Mapping[str, Read] = {
    "bam": read_bam,
    "dynaban": lambda path, unit: read_dynaban(path),
    "emps": lambda path, unit: read_emps(path),
    "harold": lambda path, unit: read_harold(path),
    "imu_on_axis": lambda path, unit: read_imu_on_axis(path),
    "jandi": lambda path, unit: read_jandi(path),
    "kbot": lambda path, unit: read_kbot(path),
    "mcap": lambda path, unit: read_mcap(path, unit=unit),
    "miuzei": lambda path, unit: read_miuzei(path),
    "robstride": lambda path, unit: read_robstride(path),
    "rostopic_csv": lambda path, unit: read_rostopic_csv(path),
    "upkie": lambda path, unit: read_upkie(path),
}
# Formats whose angles are in a unit that nobody has to declare.
FIXED_UNITS = {
    "dynaban": "Dynaban positions are encoder steps",
    "emps": "the EMPS axis moves in metres",
    "harold": "Harold angles are in radians",
    "imu_on_axis": "its angles are in radians",
    "jandi": "Jandi positions are encoder ticks",
    "kbot": "K-Bot angles are in degrees already, and are converted",
    "miuzei": "Miuzei angles are shares of half a turn",
    "robstride": "Robstride angles are in degrees already, and are converted",
    "rostopic_csv": "its messages are in radians by definition",
    "upkie": "Upkie angles are in radians",
}
# What is taken from a directory; files named one by one may be called anything.
PATTERNS = {
    "bam": ("*.json", "*.json.gz"),
    "dynaban": ("*.txt", "*.gz", "*.log"),
    "emps": ("*.mat",),
    "harold": ("*.csv", "*.csv.gz"),
    "imu_on_axis": ("*.dat", "*.dat.gz"),
    "jandi": tuple(f"**/{name}" for name in TELEMETRY),
    "kbot": ("kbot*.json", "kbot*.json.gz"),
    "mcap": ("*.mcap",),
    "miuzei": ("*.json", "*.json.gz"),
    "robstride": ("real*.json", "real*.json.gz"),
    "rostopic_csv": ("*.csv", "*.csv.gz"),
    "upkie": ("*.json", "*.jsonl", "*.json.gz", "*.jsonl.gz"),
}
# Formats in which a log is a folder: it gives the name, and more files belong to it.
FOLDERS: Mapping[str, Callable[[Path], list[Path]]] = {"jandi": companions}
# Formats in which a file beside the log names its joints: it is attached too.
BESIDE: Mapping[str, tuple[str, ...]] = {"kbot": METADATA, "robstride": METADATA}
SUFFIXES = (".gz", ".json", ".jsonl", ".txt", ".log", ".mcap", ".mat", ".csv", ".dat")


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
    parser.add_argument("--servo", metavar="NAME", help="servo type, where the log does not say or says it wrong")
    parser.add_argument("--unit", choices=("rad", "deg"), help="unit of joint angles (default: rad, checked)")
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
    table = read_rig_table(args.rig_table) if args.rig_table else None
    sources, failed = _find_all(args.sources, args.format)
    outputs = _outputs(sources, args.out, args.format)
    done: list[dict[str, Any]] = []
    for source, out in zip(sources, outputs, strict=True):
        try:
            recordings = _import(source, args, table)
            write_mcap(out, recordings, _originals(source, args.format))
        except (LogError, PermissionError) as error:
            say(f"not imported: {error}")
            failed += 1
        else:
            done.append(_describe(source, out, recordings))
    if done:
        _tell(done, args.out)
    if failed:
        raise LogError(f"{failed} of {len(done) + failed} sources could not be imported")
    return {"schema": SCHEMA, "imported": done}


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


def find_sources(argument: str, form: str) -> list[Path]:
    """The files that one argument stands for: a file, those of a directory, or of a glob.

    Raises:
        LogError: it stands for no file.
    """
    path = Path(argument)
    if path.is_dir():
        files = sorted({file for pattern in PATTERNS[form] for file in path.glob(pattern) if file.is_file()})
        if not files:
            raise LogError(f"{path} holds no {' or '.join(PATTERNS[form])} file")
        return files
    if path.exists():
        return [path]
    matches = glob.glob(argument, recursive=True)  # noqa: PTH207 - Path.glob refuses absolute patterns
    files = sorted(Path(one) for one in matches if Path(one).is_file())
    if not files:
        raise LogError(f"{argument} does not exist" + (" and matches no file" if "*" in argument else ""))
    return files


def _originals(source: Path, form: str) -> dict[str, bytes]:
    files = [source, *(FOLDERS[form](source) if form in FOLDERS else [])]
    files += [source.parent / name for name in BESIDE.get(form, ()) if (source.parent / name).is_file()]
    return {file.name: file.read_bytes() for file in files}


def _outputs(sources: Sequence[Path], folder: Path, form: str) -> list[Path]:
    names = [source.resolve().parent.name if form in FOLDERS else stem(source) for source in sources]
    outputs = [folder / f"{name}.mcap" for name in names]
    for out, count in Counter(outputs).items():
        if count > 1:
            raise UsageError(f"{count} sources would become {out}; import them into different folders")
    for source, out in zip(sources, outputs, strict=True):
        if out.exists() and out.samefile(source):
            raise UsageError(f"{source} would be replaced by its own import; choose another --out")
    return outputs


def stem(source: Path) -> str:
    """A log's name without the endings of its format: `a.json.gz` -> `a`."""
    name = source.name
    while Path(name).suffix.lower() in SUFFIXES and Path(name).stem:
        name = Path(name).stem
    return name


def _import(source: Path, args: argparse.Namespace, table: list[RigRow] | None) -> list[Recording]:
    recordings = READERS[args.format](source, args.unit or "auto")
    if table is not None:
        recordings = [with_rig(recording, table, args.rig_table) for recording in recordings]
    return [_finish(recording, source, args.servo) for recording in recordings]


def _finish(recording: Recording, source: Path, servo: str | None) -> Recording:
    rig = replace(recording.rig, servo=servo.lower()) if servo else recording.rig
    origin = {"imported_from": source.name, "imported_sha256": recording.sha256}
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

"""The formats of `frasa-sysid import`: who reads them, which files they are, what belongs to a log."""

import glob
from collections.abc import Callable, Mapping
from pathlib import Path

from frasa_sysid.errors import LogError
from frasa_sysid.readers.bag import bag_of, bags_in, read_bag
from frasa_sysid.readers.bag import companions as bag_companions
from frasa_sysid.readers.bam import read_bam
from frasa_sysid.readers.columns import read_columns
from frasa_sysid.readers.csv_columns import CsvFile
from frasa_sysid.readers.dynaban import read_dynaban
from frasa_sysid.readers.emps import read_emps
from frasa_sysid.readers.harold import read_harold
from frasa_sysid.readers.imu_on_axis import read_imu_on_axis
from frasa_sysid.readers.jandi import TELEMETRY, companions, read_jandi
from frasa_sysid.readers.kbot import read_kbot
from frasa_sysid.readers.kept_windows import Limit
from frasa_sysid.readers.mcap import read_mcap
from frasa_sysid.readers.miuzei import read_miuzei
from frasa_sysid.readers.npz_columns import NpzFile
from frasa_sysid.readers.parquet_columns import ParquetFile
from frasa_sysid.readers.robstride import METADATA, read_robstride
from frasa_sysid.readers.rostopic_csv import read_rostopic_csv
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.readers.sources import Unit
from frasa_sysid.readers.upkie import read_upkie
from frasa_sysid.recording import Recording

Read = Callable[[Path, Unit, SignalMap | None], list[Recording]]
READERS: Mapping[str, Read] = {
    "bam": lambda path, unit, _map: read_bam(path, unit),
    "csv": lambda path, _unit, mapping: read_columns(CsvFile(path), mapping),
    "dynaban": lambda path, _unit, _map: read_dynaban(path),
    "emps": lambda path, _unit, _map: read_emps(path),
    "harold": lambda path, _unit, _map: read_harold(path),
    "imu_on_axis": lambda path, _unit, _map: read_imu_on_axis(path),
    "jandi": lambda path, _unit, _map: read_jandi(path),
    "kbot": lambda path, _unit, _map: read_kbot(path),
    "mcap": lambda path, unit, mapping: read_mcap(path, unit=unit, mapping=mapping, limit=Limit(None)),
    "miuzei": lambda path, _unit, _map: read_miuzei(path),
    "npz": lambda path, _unit, mapping: read_columns(NpzFile(path), mapping),
    "parquet": lambda path, _unit, mapping: read_columns(ParquetFile(path), mapping),
    "robstride": lambda path, _unit, _map: read_robstride(path),
    "rosbag": read_bag,
    "rostopic_csv": lambda path, _unit, _map: read_rostopic_csv(path),
    "upkie": lambda path, _unit, _map: read_upkie(path),
}
# Formats that a map may describe; the first three need one.
TABLES = ("csv", "npz", "parquet")
MAPPED = (*TABLES, "mcap", "rosbag")
# Formats whose angles are in a unit that nobody has to declare.
FIXED_UNITS = {
    **dict.fromkeys(TABLES, "the map declares the unit of every column"),
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
    "csv": ("*.csv", "*.csv.gz", "*.tsv"),
    "dynaban": ("*.txt", "*.gz", "*.log"),
    "emps": ("*.mat",),
    "harold": ("*.csv", "*.csv.gz"),
    "imu_on_axis": ("*.dat", "*.dat.gz"),
    "jandi": tuple(f"**/{name}" for name in TELEMETRY),
    "kbot": ("kbot*.json", "kbot*.json.gz"),
    "mcap": ("*.mcap",),
    "miuzei": ("*.json", "*.json.gz"),
    "npz": ("*.npz",),
    "parquet": ("*.parquet", "*.pq"),
    "robstride": ("real*.json", "real*.json.gz"),
    "rosbag": ("*.bag", "*.db3", "metadata.yaml"),
    "rostopic_csv": ("*.csv", "*.csv.gz"),
    "upkie": ("*.json", "*.jsonl", "*.json.gz", "*.jsonl.gz"),
}
# Formats in which a log may be a folder: more files belong to it, and it gives the name.
COMPANIONS: Mapping[str, Callable[[Path], list[Path]]] = {"jandi": companions, "rosbag": bag_companions}
NAMED: Mapping[str, Callable[[Path], Path]] = {"jandi": lambda path: path.resolve().parent, "rosbag": bag_of}
# Formats in which a file beside the log names its joints: it is attached too.
BESIDE: Mapping[str, tuple[str, ...]] = {"kbot": METADATA, "robstride": METADATA}
_TEXTS = (".gz", ".json", ".jsonl", ".txt", ".log", ".csv", ".tsv", ".dat")
SUFFIXES = (*_TEXTS, ".mcap", ".mat", ".npz", ".parquet", ".pq", ".bag", ".db3")


def find_sources(argument: str, form: str) -> list[Path]:
    """The files that one argument stands for: a file, those of a directory, or of a glob.

    Raises:
        LogError: it stands for no file.
    """
    path = Path(argument)
    if path.is_dir():
        every = {file for pattern in PATTERNS[form] for file in path.glob(pattern) if file.is_file()}
        files = bags_in(path) if form == "rosbag" else sorted(every)
        if not files:
            raise LogError(f"{path} holds no {' or '.join(PATTERNS[form])} file")
        return files
    if path.exists():
        return [path]
    matches = glob.glob(argument, recursive=True)  # noqa: PTH207 - Path.glob refuses absolute patterns
    files = sorted(Path(one) for one in matches if Path(one).is_file())
    if not files:
        expected = (
            "expected a glob that matches files" if "*" in argument else "expected a log, a folder of logs or a glob"
        )
        raise LogError(f"{argument} does not exist, {expected}: check its name, and the folder the command runs in")
    return files


def name_of(source: Path, form: str) -> str:
    """What a log is called."""
    return NAMED[form](source).name if form in NAMED and NAMED[form](source) != source else stem(source)


def stem(source: Path) -> str:
    """A log's name without the endings of its format: `a.json.gz` -> `a`."""
    name = source.name
    while Path(name).suffix.lower() in SUFFIXES and Path(name).stem:
        name = Path(name).stem
    return name

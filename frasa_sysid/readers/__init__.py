"""One file a format: log -> list of `Recording`.

`read_log` reads MCAP, the one format that frasa works with; all others are brought
in once, with `frasa-sysid import`, so that nothing has to be guessed twice.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from frasa_sysid.errors import LogError
from frasa_sysid.readers.kept_windows import Limit
from frasa_sysid.readers.mcap import read_mcap
from frasa_sysid.readers.mcap_stream import MAGIC
from frasa_sysid.readers.sources import GZIP_MAGIC, check_source
from frasa_sysid.recording import Clock, Recording

__all__ = ["Limit", "read_log", "read_logs", "read_mcap"]


def read_log(path: Path, clock: Clock | Literal["auto"] = "auto", limit: Limit | None = None) -> list[Recording]:
    """The recordings of a log.

    Args:
        path: an MCAP file.
        clock: which stamps to use; `auto` takes the best that all signals have.
        limit: how much of it is kept in memory; by default as much as usual.

    Raises:
        LogError: no MCAP file (the message says how to make it one), or see `read_mcap`.
    """
    check_source(path)
    with path.open("rb") as file:
        head = file.read(64)
    if head.startswith(MAGIC):
        return read_mcap(path, clock, limit=limit)
    raise LogError(f"{path} is not an MCAP file{_advice(path, head)}")


def read_logs(paths: Sequence[Path]) -> list[Recording]:
    """The recordings of several logs, in the order given."""
    return [recording for path in paths for recording in read_log(Path(path))]


def _advice(path: Path, head: bytes) -> str:
    name = path.name.lower()
    if head.startswith(b"StartOfNewTest"):
        return f"; it looks like Dynaban: 'frasa-sysid import {path} --format dynaban --out DIR'"
    if head.lstrip().startswith((b"{", b"[")) or name.endswith((".json", ".json.gz")):
        others = "kbot, miuzei, robstride or upkie"
        return f"; it looks like JSON: 'frasa-sysid import {path} --format bam --out DIR' (or {others})"
    if head.startswith(b"MATLAB 5.0"):
        return f"; it is a MATLAB file: 'frasa-sysid import {path} --format emps --out DIR', if it is EMPS"
    if name in ("telemetry.csv", "telemetry.csv.gz"):
        return f"; it looks like a Jandi run: 'frasa-sysid import {path.parent} --format jandi --out DIR'"
    if head.startswith(b"%time,"):
        return f"; it looks like rostopic echo -p: 'frasa-sysid import {path} --format rostopic_csv --out DIR'"
    if head.startswith((b"#ROSBAG", b"SQLite format 3")):
        return f"; it is a ROS bag: 'frasa-sysid import {path} --format rosbag --out DIR'"
    if head.startswith(b"PAR1") or name.endswith((".csv", ".csv.gz", ".tsv", ".npz")):
        form = "parquet" if head.startswith(b"PAR1") else "npz" if name.endswith(".npz") else "csv"
        return f"; it is a table: 'frasa-sysid import {path} --format {form} --map MAP.toml --out DIR'"
    if head.startswith(GZIP_MAGIC):
        return "; it is gzipped: 'frasa-sysid import' reads other logs packed, MCAP must be unpacked"
    return " (unknown format); 'frasa-sysid import' reads the formats that its --help names"

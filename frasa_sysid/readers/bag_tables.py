"""A look at a rosbag2 `.db3` file before it is queried.

SQL of a stranger must not run; a view or a computed column is such SQL, which need not end.
"""

import sqlite3
from pathlib import Path
from urllib.parse import quote

from frasa_sysid.errors import LogError

COMPUTED = ("GENERATED", " AS (", " AS(", "VIRTUAL")


def check_tables(path: Path) -> None:
    """See that a database holds nothing but tables of plain columns.

    Raises:
        LogError: something else, or it cannot be read.
    """
    try:
        base = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error as error:
        raise LogError(f"{path} cannot be read as a bag: {error}") from error
    try:
        found = base.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000").fetchall()
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        raise LogError(f"{path} cannot be read as a bag: {error}") from error
    finally:
        base.close()
    for kind, name, sql in found:
        words = " ".join(str(sql or "").upper().split())
        if kind not in ("table", "index") or (kind == "table" and any(one in words for one in COMPUTED)):
            raise LogError(f"{path} is no plain bag: '{str(name)[:40]}' is a {str(kind)[:20]}, computed by SQL")

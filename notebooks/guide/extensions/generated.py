"""Pictures and tables that are made anew at every build, by the project's own code from its own logs.

They lie in `generated/`, which is not kept. As long as nothing that they are made of has changed they stay as they
are, so that a build after a change of words takes no longer than that.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sphinx.application import Sphinx
from sphinx.util import logging

from extensions import bench_pictures, bench_table, run_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger(__name__)
ROOT = Path(__file__).resolve().parents[3]
STAMP = "made_of.txt"
TABLES: dict[str, Callable[[Path], str]] = {
    "information.md": bench_table.information,
    "load_friction.md": bench_table.load_friction,
    "quality.md": run_table.quality,
}
PICTURES: "dict[str, Callable[[Path], Figure]]" = {
    "torque_off.svg": bench_pictures.torque_off,
    "friction_laws.svg": bench_pictures.friction_laws,
    "simulated_over_measured.svg": bench_pictures.simulated_over_measured,
}


def make(app: Sphinx) -> None:
    """Write everything, unless it is there already."""
    folder = Path(app.srcdir) / "generated"
    stamp, made_of = folder / STAMP, _made_of()
    wanted = {*TABLES, *PICTURES}
    if stamp.is_file() and stamp.read_text() == made_of and all((folder / name).is_file() for name in wanted):
        return
    folder.mkdir(exist_ok=True)
    for name, table in TABLES.items():
        log.info("making %s", name)
        (folder / name).write_text(table(ROOT), encoding="utf-8")
    for name, picture in PICTURES.items():
        log.info("making %s", name)
        (folder / name).write_bytes(bench_pictures.svg(picture, ROOT))
    stamp.write_text(made_of)


def _made_of() -> str:
    """A hash of the code and data that pictures and tables come from."""
    sources = [
        *(ROOT / "frasa_sysid").rglob("*.py"),
        *Path(__file__).parent.glob("*.py"),
        *(ROOT / "bench_logs").glob("*.mcap"),
        *(ROOT / "robot_model").glob("*.xml"),
        *(ROOT / "robot_model" / "fits").glob("*.json"),
        *(ROOT / "robot_model" / "policies").rglob("*.csv"),
    ]
    total = hashlib.sha256()
    for path in sorted(sources):
        total.update(path.read_bytes())
    return total.hexdigest()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", make)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""What an import may replace: its own file of before, and not that of another log of the same name."""

import json
from collections.abc import Sequence
from pathlib import Path

from mcap.reader import make_reader

from frasa_sysid.errors import LogError
from frasa_sysid.recording import Recording
from frasa_sysid.writer import MADE


def check_replaced(out: Path, recordings: Sequence[Recording]) -> None:
    """Refuse to replace what was imported from another log; the same one may have changed, or have moved.

    Raises:
        LogError: such a file lies there.
    """
    before = _inputs(out) if out.is_file() else {}
    if not before or any(one.source in before or one.sha256 in before.values() for one in recordings):
        return
    raise LogError(
        f"{recordings[0].source} would replace {out}, which was imported from {next(iter(before))}: "
        "choose another --out or name, or delete it first"
    )


def _inputs(path: Path) -> dict[str, str]:
    """The sources of an import with their sha256; none of a file that is no import, or cannot be read."""
    try:
        with path.open("rb") as file:
            found = [one.metadata for one in make_reader(file).iter_metadata() if one.name == MADE]
        made = {name: json.loads(value) for name, value in found[0].items()} if found else {}
    except Exception:  # whatever lies there: what the parser raises on bytes that are no MCAP has no bounds
        return {}
    inputs = made.get("inputs")
    if made.get("command") != "import" or not isinstance(inputs, dict):
        return {}
    return {str(name): str(value) for name, value in inputs.items()}

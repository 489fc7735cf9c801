"""The one way that TOML is read: by Python's own parser, within bounds.

Keys of thousands of parts take it minutes and gigabytes. Whole numbers of more than 64 bits are none of the format, and
Python does not write them out where an error quotes them.
"""

import re
import tomllib
from typing import Any

MOST_PARTS = 20  # of a dotted key
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MOST_PARTS}}}")


def parse_toml(content: bytes) -> dict[str, Any]:
    """The table of a TOML file.

    Args:
        content: of the file; whoever reads it bounds its size.

    Raises:
        ValueError: not TOML, or not such as a person writes; in one line.
    """
    try:
        text = content.decode("utf-8-sig")
        if _LONG_KEY.search(text):
            raise ValueError(f"a key of more than {MOST_PARTS} parts")
        table = tomllib.loads(text)
        _check(table)
        return table
    except (ValueError, RecursionError) as error:  # of syntax, of characters, of numbers and dates that cannot be
        raise ValueError(" ".join(str(error).split())[:300]) from error


def _check(value: object) -> None:
    if isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            _check(one)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError("a whole number of more than 64 bits")

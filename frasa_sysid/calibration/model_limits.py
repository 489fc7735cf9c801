"""How large a number in a MuJoCo XML file may be, where MuJoCo makes as much as it says.

Far above what robots have, far below what fills a computer.
"""

import math
import re
from collections.abc import Mapping

_SIZE = re.compile(r"(\d+)([kKMGTPE]?)")
_BYTES = {"": 0, "k": 10, "K": 10, "M": 20, "G": 30, "T": 40, "P": 50, "E": 60}
MOST_MEMORY = 2**30  # [bytes]
# Attribute -> largest of its numbers, in any element.
NUMBERS = {
    "nsample": 10_000, "history": 10_000, "nrow": 4096, "ncol": 4096, "width": 4096, "height": 4096, "dim": 10_000,
    "actdim": 1000, "resolution": 8192, "offwidth": 8192, "offheight": 8192, "offsamples": 64, "shadowsize": 16_384,
    "numslices": 1000, "numstacks": 1000, "numquads": 1000, "num": 10_000, "gridsize": 4096, "nearest": 100_000,
    "iterations": 100_000, "ls_iterations": 100_000, "noslip_iterations": 100_000, "ccd_iterations": 100_000,
    "sdf_iterations": 100_000, "sdf_initpoints": 100_000, "maxhullvert": 1_000_000, "octree_maxdepth": 12,
    "cellcount": 1000, "params": 1000, "elastic2d": 10,
}  # fmt: skip
# Of <size>: numbers are multiplied by how many bodies, joints, ... there are.
SIZES = {"nkey": 10_000, "nuserdata": 1_000_000, "njmax": 1_000_000, "nconmax": 1_000_000, "nstack": 2**27}
MOST_USER = 1000  # nuser_*
MOST_NUMERIC = 100_000
LONGEST = 2**21  # characters of an attribute; vertices of a mesh may stand in one


def check_sizes(tag: str, attributes: Mapping[str, str]) -> None:
    """See that no attribute of an element asks for too much.

    Raises:
        ValueError: one does.
    """
    for name, text in attributes.items():
        if len(text) > LONGEST:
            raise ValueError(f"{name[:40]} has {len(text)} characters, expected at most {LONGEST}")
        most = _most(tag, name)
        if most is not None:
            _check(name, text, most)
    if tag == "size" and "memory" in attributes:
        _check_memory(attributes["memory"])


def copies_of(tag: str, attributes: Mapping[str, str]) -> int:
    """How often an element makes what stands in it.

    Raises:
        ValueError: a count that is none.
    """
    if tag not in ("replicate", "composite", "flexcomp"):
        return 1
    counts = _numbers("count", attributes.get("count", "1"))
    return math.prod(max(1, math.ceil(one)) for one in counts)


def _most(tag: str, name: str) -> float | None:
    if tag == "size":
        return MOST_USER if name.startswith("nuser_") else SIZES.get(name)
    if tag == "numeric" and name == "size":
        return MOST_NUMERIC
    return NUMBERS.get(name)


def _check(name: str, text: str, most: float) -> None:
    # A word is MuJoCo's to refuse, or means something else there.
    for number in _numbers(name, text) if text[:1].isdigit() or text[:1] in "+-. \t\n" else ():
        if number > most:
            raise ValueError(f"{name} = {text[:40]}, expected at most {most:g}")


def _check_memory(text: str) -> None:
    found = _SIZE.fullmatch(text.strip())
    if found and (len(found[1]) > 20 or int(found[1]) << _BYTES[found[2]] > MOST_MEMORY):
        raise ValueError(f"memory = {text[:40]}, expected at most {MOST_MEMORY >> 20}M")


def _numbers(name: str, text: str) -> list[float]:
    try:
        numbers = [float(one) for one in text.split()]
    except ValueError:
        raise ValueError(f"{name} = {text[:40]!r}, expected numbers") from None
    if not all(math.isfinite(one) for one in numbers):
        raise ValueError(f"{name} = {text[:40]}, expected finite numbers")
    return numbers

"""What a page says that a command prints, held loosely against what it prints; and a command with other options."""

import re
from collections.abc import Sequence

TOLERANCE = 0.03  # of a number: seeds are fixed, but not the last digits of another processor
_BORDER = re.compile(r"[│┃|┏┓┗┛┡┩├┤┬┴┼┳╇└┘┌┐━─]+")
_NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")


def missing(shown: Sequence[str], printed: str) -> str | None:
    """The first shown line that is not among those printed, in this order; None where all are.

    A line `...` stands for any lines, `...` at the end of a line for its rest. Numbers may differ by 3 %,
    borders of tables are left out.
    """
    lines = [_words(one) for one in printed.splitlines()]
    place = 0
    for line in shown:
        wanted = _words(line)
        if not wanted or wanted == ["..."]:
            continue
        fitting = (i for i in range(place, len(lines)) if _alike(wanted, lines[i]))
        found = next(fitting, None)
        if found is None:
            return line
        place = found + 1
    return None


def _words(line: str) -> list[str]:
    return _BORDER.sub(" ", line).split()


def _alike(wanted: list[str], words: list[str]) -> bool:
    if wanted[-1] == "...":
        wanted = wanted[:-1]
        words = words[: len(wanted)]
    return len(wanted) == len(words) and all(_same(a, b) for a, b in zip(wanted, words, strict=True))


def _same(one: str, other: str) -> bool:
    """Whether two words are the same but for small differences of the numbers in them."""
    if _NUMBER.sub("0", one) != _NUMBER.sub("0", other):
        return one == "..."
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(_close(float(a.replace(",", "")), float(b.replace(",", ""))) for a, b in pairs)


def _close(one: float, other: float) -> bool:
    return abs(one - other) <= TOLERANCE * max(abs(one), abs(other))


def changed(words: Sequence[str], options: Sequence[str]) -> list[str]:
    """A command with options replaced, or added where it has them not.

    Args:
        words: of the command.
        options: each followed by its values.
    """
    result, place = list(words), 0
    while place < len(options):
        name, end = options[place], place + 1
        while end < len(options) and not options[end].startswith("--"):
            end += 1
        values = list(options[place + 1 : end])
        if name in result:
            first = result.index(name)
            result[first + 1 : first + 1 + len(values)] = values
        else:
            result += [name, *values]
        place = end
    return result
